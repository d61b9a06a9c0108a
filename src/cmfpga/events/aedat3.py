"""AEDAT 3.1 recordings, as cAER and libcaer write them, such as DVS128 Gesture.

Header lines begin with ``#``, up to ``#!END-HEADER``. Then come packets: eight numbers, little-endian, and as many
events as the sixth of them says. Packets of other types than polarity, and of other cameras than the first, are
skipped, and so are events that are marked as not valid. Times are µs; those of a packet count from a multiple of 2^31.
x = 0 is the left column, y = 0 the top row.

Source: https://docs.inivation.com/software/software-advanced-usage/file-formats/aedat-3.1.html.
"""

import re
import struct

import numpy as np

from ..errors import RecordingError
from .aedat2 import chip_size
from .recording import Format
from .streamed import StreamedRecording
from .units import to_us

_MAGIC, _END = b"#!AER-DAT3.1", b"#!END-HEADER"
_MAX_HEADER_LINES = 1000
# Type, camera, bytes of an event, where its time stands, multiple of 2^31 µs, events there, events used, valid ones.
_PACKET = struct.Struct("<HHIIIIII")
_POLARITY, _EVENT_BYTES = 1, 8


class Aedat3Recording(StreamedRecording):
    """Events of an AEDAT 3.1 file."""

    def __init__(self, path, *, time_unit=None, sensor=None):
        lines = []
        with path.open("rb") as file:
            while not lines or not lines[-1].startswith(_END):
                lines.append(file.readline(4096))
                if not lines[-1].startswith(b"#") or len(lines) > _MAX_HEADER_LINES:
                    raise RecordingError(f"{path}: AEDAT 3.1 without a line '{_END.decode()}' (truncated or damaged)")
            self._begin = file.tell()
        header = b"".join(lines).decode("latin-1")
        form = re.search(r"^# *Format: *(\S+)", header, re.MULTILINE)
        if form and form[1].upper() != "RAW":
            raise RecordingError(f"{path}: AEDAT 3.1 of format {form[1][:40]!r}; RAW is needed")
        chips = re.findall(r"^# *Source \d+: *(\S+)", header, re.MULTILINE)
        size = next(filter(None, map(chip_size, chips)), None)
        super().__init__(path, "AEDAT 3.1", sensor=sensor or size, time_unit=time_unit)
        self._require_events()

    def _pieces(self):
        camera, count, end = None, 0, self.path.stat().st_size
        with self.path.open("rb") as file:
            file.seek(self._begin)
            while head := file.read(_PACKET.size):
                kind, source, size, _, turns, capacity, number, _ = _PACKET.unpack(head.ljust(_PACKET.size, b"\0"))
                missing = file.tell() - len(head) + _PACKET.size + size * capacity - end
                if kind == _POLARITY and size == _EVENT_BYTES and camera in (None, source):
                    camera, content = source, file.read(size * capacity - max(missing, 0))
                    words = np.frombuffer(content[: len(content) // size * size], "<u4").reshape(-1, 2)[:number]
                    data, t = words[words[:, 0] & 1 == 1].T.astype(np.int64)
                    if len(t):
                        t = to_us(t + (turns << 31), self.time_unit, self.name, count)
                        yield t, data >> 17, data >> 2 & 0x7FFF, data >> 1 & 1
                        count += len(t)
                else:
                    file.seek(min(file.tell() + size * capacity, end))
                if missing > 0:
                    raise RecordingError(
                        f"{self.name}: truncated: {missing} bytes of the last packet are missing; the {count} events "
                        "before were read"
                    )


FORMAT = Format("AEDAT 3.1", (".aedat",), lambda head, path: head.startswith(_MAGIC), Aedat3Recording)
