"""The serial link of a board without a processor: frames, requests, replies, and the link's own registers.

A frame is bytes between two :data:`END` bytes, with the escapes of SLIP (RFC 1055) and, before them, a CRC-16 (CRC-16/
IBM-3740) at its end, high byte first. So whatever garbage came, the next :data:`END` begins anew.

Requests, from the host: sequence number, command, arguments. Each one that arrives whole is answered by one reply:
:data:`REPLY`, the sequence number, a status, and for :data:`READ` four bytes. The host sends the next request when it
has the reply, and the same one again, with the same number, when none came: a number that was just carried out is
answered, and not carried out again. Results come unasked: :data:`PACKET`, 64-bit words, and a byte that says whether
the packet ends here. Numbers of several bytes are little-endian.

Arguments: of :data:`HELLO` none, it makes the board forget the last number; of :data:`READ` a byte address (2); of
:data:`WRITE` a byte address (2) and a word (4); of :data:`EVENTS` 32-bit words of events (4 each), of which two make a
beat of 64 bits, the lower one first; :data:`EVENTS_LAST` is the same with TLAST behind them.
"""

import binascii

from .registers.layout import RegisterMap, command, constants, in_order, status, stored

END, ESCAPE, ESCAPED_END, ESCAPED_ESCAPE = 0xC0, 0xDB, 0xDC, 0xDD

HELLO, READ, WRITE, EVENTS, EVENTS_LAST = range(5)
REPLY, PACKET = 1, 2

#: Statuses of a reply: done; the words did not fit, and none was kept: send them again; no such request.
DONE, BUSY, REFUSED = range(3)

#: Address of the link's own registers, beyond those of the shell.
BASE = 0xF000
ID = 0x4C494E4B  # "LINK"

#: 32-bit words that the board keeps for the shell, the most in a frame, and 64-bit words of a packet in one frame.
BUFFER_WORDS = 1024
FRAME_WORDS = 256
FRAME_BEATS = 64

#: Bytes of the longest frame as it stands on the wire, each of them escaped.
LONGEST = 2 * (4 * FRAME_WORDS + 8)

#: ``{name: what is counted}``, of the sensor's port; each becomes a register COUNT_CPI_….
CPI_COUNTERS = {
    "words": "words taken from the sensor",
    "overflow": "words lost because the FIFO was full",
    "skipped": "words left out: paused, or no time word since a pause or a loss, or no frame since a broken word",
    "padding": "words of padding, which are no loss",
    "broken": "words that a frame's start cut, or that cannot be: bytes were lost or doubled before them",
}
COUNTERS = {
    "bad_frames": "frames dropped: CRC, escape, stop bit, command or length",
    "byte_errors": "bytes without a stop bit",
    "busy": "frames of events refused because the buffer was full; the host sends them again",
    "repeats": "requests that came again, and were not carried out again",
    "overruns": "requests dropped because the one before was not answered yet",
    **{f"cpi_{name}": doc for name, doc in CPI_COUNTERS.items()},
}


#: Offsets are from :data:`BASE`.
REGISTERS = RegisterMap(tuple(in_order("Link", [
    ("LINK_ID", "what this is", constants(("MAGIC", 32, ID, "the letters LINK"))),
    ("LINK_SOURCE", "where events come from; change it while nothing waits", [
        stored("CPI", 0, 1, "0: this link, 1: the sensor's port, which is paused otherwise"),
        stored("BIG_ENDIAN", 1, 1, "of the sensor's port: a word's first byte is its highest"),
        stored("HSYNC_LOW", 2, 1, "its HSYNC is active low"),
        stored("VSYNC_LOW", 3, 1, "its VSYNC is active low")]),
    ("LINK_WAITING", "words on their way to the shell", [
        status("WORDS", 0, 16, "in the buffer", link="words"),
        status("BEAT", 16, 1, "one is offered to the shell", link="beat")]),
    ("LINK_FLUSH", "forget the words in the buffer", [command("NOW", 0, 1, "do it")]),
    *((f"COUNT_{name.upper()}", doc, [status("VALUE", 0, 32, doc, link=name)]) for name, doc in COUNTERS.items()),
])))  # fmt: skip


def frame(payload):
    """Bytes on the wire: the payload with its CRC, escaped, between two :data:`END`."""
    whole = payload + binascii.crc_hqx(payload, 0xFFFF).to_bytes(2, "big")
    escaped = whole.replace(bytes([ESCAPE]), bytes([ESCAPE, ESCAPED_ESCAPE]))
    return bytes([END]) + escaped.replace(bytes([END]), bytes([ESCAPE, ESCAPED_END])) + bytes([END])


class FrameReader:
    """Bytes from the wire to payloads; ``bad`` counts the frames that were dropped."""

    def __init__(self):
        self._waiting = bytearray()
        self.bad = 0

    def read(self, received):
        """The payloads of the frames that these bytes complete: list of bytes."""
        *frames, rest = (self._waiting + received).split(bytes([END]))
        self._waiting = bytearray(rest[: LONGEST + 1])  # of a line without an end no more is kept than tells it
        payloads = [_payload(found) for found in frames if found]
        self.bad += payloads.count(None)
        return [payload for payload in payloads if payload is not None]


def _payload(escaped):
    """Of one frame; None if it is damaged."""
    if len(escaped) > LONGEST:
        return None
    head, *parts = escaped.split(bytes([ESCAPE]))
    known = {ESCAPED_END: END, ESCAPED_ESCAPE: ESCAPE}
    if not all(part and part[0] in known for part in parts):
        return None
    plain = head + b"".join(bytes([known[part[0]]]) + part[1:] for part in parts)
    return bytes(plain[:-2]) if len(plain) > 2 and binascii.crc_hqx(plain, 0xFFFF) == 0 else None
