"""Back end: a board without a processor at the end of a serial line (:mod:`cmfpga.protocol.link`).

Never run on a board; its tests talk to the emitted Verilog of the board's top.
"""

import time

import numpy as np

from ..boards import ULX3S
from ..errors import DeviceError, DeviceTimeout, needs
from ..protocol import link
from .accelerator import Accelerator
from .backend import Backend

#: How often a request is sent that no reply comes to.
TRIES = 4
#: Bits on the wire of a byte, and how many bytes escapes may make of one.
_BITS, _ESCAPED = 10, 2


class SerialLine:
    """A serial port by pyserial, as :class:`UartBackend` wants one; no other process opens it meanwhile.

    ``port`` is such as ``/dev/ttyUSB0``, or a URL of pyserial's.
    """

    #: A reply that is later than this, beyond what bytes take, does not come, s. USB keeps them back for 16 ms.
    reply_seconds = 0.25
    #: The clock of :attr:`reply_seconds` and of :meth:`read`, s.
    time = staticmethod(time.monotonic)

    def __init__(self, port, baud=ULX3S.baud):
        with needs("serial", "serial", f"serial port {port}"):
            import serial
        self.name, self.baud = port, baud
        self._errors = (serial.SerialException, OSError, ValueError)
        self._port = self._try(lambda: serial.serial_for_url(port, baudrate=baud, timeout=0, exclusive=True))

    def _try(self, do):
        try:
            return do()
        except self._errors as error:
            reason = " ".join(str(getattr(error, "strerror", None) or error).split())
            raise DeviceError(f"serial port {self.name}: {reason}") from None

    def write(self, content):
        """Send bytes."""
        self._try(lambda: self._port.write(content))

    def read(self, timeout):
        """Bytes that came, at least one unless the time is over."""

        def read():
            self._port.timeout = timeout
            return self._port.read(1) + self._port.read(self._port.in_waiting)

        return self._try(read)

    def close(self):
        """Safe to call twice."""
        self._port.close()


class UartBackend(Backend):
    """Registers and words by requests on a serial line, one at a time; packets as they come.

    ``line`` is an open :class:`SerialLine`, or the name of a serial port. Raises :exc:`DeviceError` where that cannot
    be opened, :exc:`DeviceTimeout` where nobody answers.
    """

    has_interrupt = False
    form = "EVT20"  # a word of 32 bits an event: half of what the line would carry otherwise

    def __init__(self, line):
        self._line = SerialLine(line) if isinstance(line, str) else line
        self.name = self._line.name
        self._reader = link.FrameReader()
        self._number = 0
        self._frames, self._packet, self._packets, self._replies = [], b"", [], {}
        try:
            self._request(link.HELLO)
            if self._link("LINK_ID")["MAGIC"] != link.ID:
                raise DeviceError(f"{self.name}: what answers is not a cmfpga link")
        except BaseException:
            self.close()
            raise

    # ---------------------------------------------------------------- requests

    def _request(self, command, arguments=b""):
        """The reply's status and word; sends the request again where none comes."""
        self._number = (self._number + 1) % 256
        message = link.frame(bytes([self._number, command]) + arguments)
        self._replies.clear()
        line, longest = self._line, len(message) + _ESCAPED * 8 * link.FRAME_BEATS
        for _ in range(TRIES):
            line.write(message)
            deadline = line.time() + line.reply_seconds + _BITS * longest / line.baud
            while (left := deadline - line.time()) > 0:
                self._listen(left)
                if self._number in self._replies:
                    status, word = self._replies.pop(self._number)
                    if status == link.REFUSED:
                        raise DeviceError(f"{self.name}: a request was refused: is the bitstream of this version?")
                    return status, word
        asked = f"{self.name}: no reply to {TRIES} requests at {self._line.baud} baud: is the bitstream loaded?"
        raise DeviceTimeout(f"{asked} {self.hint()}".rstrip())

    def _listen(self, timeout):
        """Take what comes within the time; returns when anything came."""
        for payload in self._reader.read(self._line.read(timeout)):
            kind, content = payload[0], payload[1:]
            if kind == link.REPLY and len(content) in (2, 6):
                self._replies[content[0]] = content[1], int.from_bytes(content[2:], "little")
            elif kind == link.PACKET and len(content) % 8 == 1:
                self._packet += content[:-1]
                if content[-1]:
                    self._packets.append(np.frombuffer(self._packet, "<u8").astype(np.uint64))
                    self._packet = b""
            else:
                self._reader.bad += 1

    def read32(self, offset):
        self._pump()
        return self._request(link.READ, offset.to_bytes(2, "little"))[1]

    def write32(self, offset, value):
        self._pump()
        self._request(link.WRITE, offset.to_bytes(2, "little") + int(value).to_bytes(4, "little"))

    # ---------------------------------------------------------------- words and packets

    def _pump(self):
        """Send frames of events as long as the board has room for them."""
        while self._frames and self._request(*self._frames[0])[0] != link.BUSY:
            del self._frames[0]

    def send(self, words):
        if self._frames:
            raise DeviceError("words were not sent yet, and more are to be")
        content, size = np.ascontiguousarray(words, "<u8").tobytes(), 4 * link.FRAME_WORDS
        self._frames = [(link.EVENTS, content[k : k + size]) for k in range(0, len(content), size)]
        self._frames[-1] = link.EVENTS_LAST, self._frames[-1][1]
        self._pump()

    def wait_sent(self, timeout):
        deadline = time.monotonic() + timeout
        while self._frames or any((waiting := self._link("LINK_WAITING")).values()):
            if time.monotonic() >= deadline:
                rest = f"{len(self._frames)} frames" if self._frames else f"{waiting['WORDS']} words"
                raise DeviceTimeout(f"{self.name}: {rest} were not taken within {timeout:g} s")
            self._pump()

    def receive(self, timeout):
        deadline = time.monotonic() + timeout
        while not self._packets:
            self._pump()
            left = max(deadline - time.monotonic(), 0)
            self._listen(min(left, self._line.reply_seconds))
            if not self._packets and time.monotonic() >= deadline:
                raise DeviceTimeout(f"{self.name}: no packet within {timeout:g} s")
        return self._packets.pop(0)

    def wait_interrupt(self, timeout):
        raise DeviceError(f"{self.name}: a serial line has no interrupt")

    def stop(self):
        self._frames.clear()
        self._write_link("LINK_FLUSH", NOW=1)  # the packets that were on their way come before its reply
        self._packets.clear()
        self._packet = b""

    # ---------------------------------------------------------------- the link itself

    def _link(self, name):
        """``{field: value}`` of one of the link's own registers."""
        register = link.REGISTERS[name]
        return register.unpack(self.read32(link.BASE + register.offset))

    def _write_link(self, name, **fields):
        register = link.REGISTERS[name]
        self.write32(link.BASE + register.offset, register.pack(**fields))

    def select(self, source, *, big_endian=False, hsync_low=False, vsync_low=False):
        """Where the hardware takes events from: ``uart``, or ``cpi``, the sensor's port; the rest says how that is set.

        :meth:`Accelerator.start` with ``form="EVT20"`` then processes what comes.
        """
        self._write_link(
            "LINK_SOURCE",
            CPI={"uart": 0, "cpi": 1}[source],
            BIG_ENDIAN=int(big_endian), HSYNC_LOW=int(hsync_low), VSYNC_LOW=int(vsync_low),
        )  # fmt: skip

    def counters(self):
        """``{name: count}`` of what the link lost, refused or repeated, and of the sensor's port."""
        return {name: self._link(f"COUNT_{name.upper()}")["VALUE"] for name in link.COUNTERS}

    def hint(self):
        return f"{self._reader.bad} damaged frames came from it" if self._reader.bad else ""

    def close(self):
        self._line.close()


def serial_engine(config, port):
    """The board at a serial port as an engine."""
    return Accelerator(UartBackend(port), config).engine
