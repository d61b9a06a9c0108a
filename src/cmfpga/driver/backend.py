"""What the driver needs of whatever leads to registers and streams of the AXI top; and what has AMD's AXI DMA there.

The DMA is in simple (register) mode. Its registers and bits: AMD PG021, "AXI DMA Register Address Map". Tried on a
model of them, never on the real one.
"""

import time
from abc import ABC, abstractmethod

import numpy as np

from ..boards import DEFAULT
from ..errors import DeviceError, DeviceTimeout


class Backend(ABC):
    """Registers, words in, packets out, and the interrupt of one AXI top.

    Nothing waits without an end: what may wait takes a time-out in seconds (0: look once).
    """

    name = ""  #: for messages
    config = None  #: what hardware this is, a Config, where the back end knows
    has_interrupt = True  #: whether :meth:`wait_interrupt` can be used; otherwise the driver polls
    form = "PACKED"  #: words that events are best encoded into, a key of :data:`cmfpga.protocol.registers.FORMATS`
    max_words = 1 << 62  #: most 64-bit words of one :meth:`send`

    @abstractmethod
    def read32(self, offset):
        """The register at a byte offset from the map's begin; :exc:`DeviceError` where there is no answer."""

    @abstractmethod
    def write32(self, offset, value):
        """Write all 32 bits of a register."""

    @abstractmethod
    def send(self, words):
        """Begin to send words, 1 to :attr:`max_words` uint64, to ``s_axis``, with TLAST at the end; returns at once.

        Raises :exc:`DeviceError`: the transfer before it is still under way.
        """

    @abstractmethod
    def wait_sent(self, timeout):
        """Wait until all words were taken. Raises :exc:`DeviceTimeout`."""

    @abstractmethod
    def receive(self, timeout):
        """The next packet from ``m_axis``: uint64 array, up to and with the word that has TLAST.

        Raises :exc:`DeviceTimeout`; the packet can be received later then.
        """

    @abstractmethod
    def wait_interrupt(self, timeout):
        """Whether ``irq`` was, or became, high. It may have fallen again: the register ISR says what for."""

    @abstractmethod
    def stop(self):
        """Give up transfers that are under way, and forget packets that came. The registers stay."""

    def hint(self):
        """What to look at where the hardware is silent; empty or one sentence."""
        return ""

    def close(self):  # noqa: B027 - a back end may hold nothing
        """Release what is held. Safe to call twice."""


# Of each channel: control, status, address, and its upper half, length.
CONTROL, STATUS, ADDRESS, ADDRESS_HIGH, LENGTH = 0x00, 0x04, 0x18, 0x1C, 0x28
TO_STREAM, FROM_STREAM = 0x00, 0x30  # MM2S and S2MM

RUN, RESET = 1 << 0, 1 << 2  # of the control
HALTED, IDLE = 1 << 0, 1 << 1  # of the status
ERRORS = {
    4: "internal error: a length of 0, or a packet longer than the buffer",
    5: "slave error: the memory refused an access",
    6: "decode error: there is no memory at the address",
}

#: Seconds between two looks at a transfer.
POLL_SECONDS = 0.0001


class Channel:
    """One direction of the DMA, :data:`TO_STREAM` or :data:`FROM_STREAM`; one transfer at a time.

    ``length_bits`` are those of the register that has a transfer's length.
    """

    def __init__(self, registers, base, length_bits):
        self._registers = registers
        self._base = base
        self.longest = (1 << length_bits) - 1
        self.busy = False

    def _read(self, register):
        return self._registers.read32(self._base + register)

    def _write(self, register, value):
        self._registers.write32(self._base + register, value)

    def begin(self, address, length):
        """Begin a transfer of ``length`` bytes; from the stream: of as many at most."""
        if self.busy:
            raise DeviceError("a DMA transfer is still under way")
        self._write(CONTROL, RUN)
        self._write(ADDRESS, address & 0xFFFFFFFF)
        self._write(ADDRESS_HIGH, address >> 32)
        self._write(LENGTH, length)  # begins it
        self.busy = True

    def done(self):
        """Whether no transfer is under way; :exc:`DeviceError` if it failed."""
        if not self.busy:
            return True
        status = self._read(STATUS)
        wrong = [text for bit, text in ERRORS.items() if status >> bit & 1]
        if wrong:
            direction = "to" if self._base == TO_STREAM else "from"
            raise DeviceError(f"DMA {direction} the stream: {', '.join(wrong)} (status {status:#010x})")
        if status & HALTED:
            raise DeviceError(f"the DMA stopped in the middle of a transfer (status {status:#010x})")
        self.busy = not status & IDLE
        return not self.busy

    def wait(self, timeout):
        """Bytes of the transfer; None where it did not end in time."""
        deadline = time.monotonic() + timeout
        while not self.done():
            if time.monotonic() >= deadline:
                return None
            time.sleep(POLL_SECONDS)
        return self._read(LENGTH) & self.longest


class DmaBackend(Backend):
    """Registers by memory-mapped accesses, streams by an AXI DMA.

    ``registers`` and ``dma`` have ``read32(offset)`` and ``write32(offset, value)``. ``events`` and ``results`` are
    memory that hardware and software see, for words to, and packets from, the accelerator: ``address`` for the
    hardware, ``size`` in bytes, ``write(words)`` puts uint64 words at its begin, ``read(count)`` gives the first ones
    as the hardware wrote them, ``close()`` gives it back. ``board`` is an :class:`~cmfpga.boards.AxiBoard`.
    """

    #: Seconds that the DMA may take for its reset.
    RESET_SECONDS = 1.0

    def __init__(self, registers, dma, events, results, *, board=DEFAULT):
        self._registers, self._dma, self._events, self._results = registers, dma, events, results
        self._sending, self._receiving = (
            Channel(dma, base, board.dma_length_bits) for base in (TO_STREAM, FROM_STREAM)
        )
        self.max_words = min(events.size, self._sending.longest) // 8

    def read32(self, offset):
        return self._registers.read32(offset)

    def write32(self, offset, value):
        self._registers.write32(offset, value)

    def send(self, words):
        if not self._sending.done():
            raise DeviceError(f"{self.name}: the transfer before it is still under way")
        words = np.ascontiguousarray(words, "<u8")
        self._events.write(words)
        self._sending.begin(self._events.address, words.nbytes)

    def wait_sent(self, timeout):
        if self._sending.wait(timeout) is None:
            raise DeviceTimeout(f"{self.name}: the DMA did not send all words within {timeout:g} s")

    def receive(self, timeout):
        if not self._receiving.busy:
            length = min(self._results.size, self._receiving.longest // 8 * 8)
            self._receiving.begin(self._results.address, length)
        if (size := self._receiving.wait(timeout)) is None:
            raise DeviceTimeout(f"{self.name}: no packet within {timeout:g} s")
        return self._results.read(size // 8)

    def stop(self):
        """Reset the DMA: of both channels, whichever is asked."""
        self._dma.write32(TO_STREAM + CONTROL, RESET)
        deadline = time.monotonic() + self.RESET_SECONDS
        while self._dma.read32(TO_STREAM + CONTROL) & RESET:
            if time.monotonic() >= deadline:
                raise DeviceTimeout(f"{self.name}: the DMA's reset did not end within {self.RESET_SECONDS:g} s")
            time.sleep(POLL_SECONDS)
        self._sending.busy = self._receiving.busy = False

    def close(self):
        for buffer in (self._events, self._results):
            buffer.close()
