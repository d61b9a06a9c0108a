"""Recordings of addresses: AEDAT 2.0 and 3.1, and N-MNIST.

AEDAT 2.0, as jAER and v2e write it, has header lines that begin with ``#``; then each record is an address and a time
stamp, of 32 bits each, big-endian. Of a DAVIS's address bit 31 marks frames and inertial samples, bit 10 external
triggers (both are skipped); bits 30–22 are the row counted from the bottom, 21–12 the column counted from the right, 11
the polarity. Of a DVS128's bit 15 marks what is no event; bits 14–8 are the row, 7–1 the column, counted likewise, 0 is
1 for darker. Time stamps are µs and wrap at 2^32. The header names the chip. Where it does not, or another one,
addresses of 16 bits are a DVS128's, and others those of a DAVIS of the size that the caller gives.

AEDAT 3.1, as cAER and libcaer write it, has header lines up to ``#!END-HEADER``. Then come packets: eight numbers,
little-endian, and as many events as the sixth of them says. Packets of other types than polarity, and of other cameras
than the first, are skipped, and so are events that are marked as not valid. Times are µs; those of a packet count from
a multiple of 2^31. x = 0 is the left column, y = 0 the top row.

N-MNIST and N-Caltech101, ``.bin``, have records of five bytes, without a header: x, y, and 24 bits, big-endian. The
first of these is the polarity, the others are the time in µs; x and y as of AEDAT 3.1. A file is known by its extension
and by times that do not fall at its begin.

Sources: https://docs.inivation.com/software/software-advanced-usage/file-formats/aedat-2.0.html and aedat-3.1.html (the
sense of rows and columns of 2.0 was checked against a recording of a DAVIS 240C);
https://www.garrickorchard.com/datasets/n-mnist.
"""

import re
import struct

import numpy as np

from ..errors import RecordingError
from .recording import Format
from .streamed import RecordsRecording, StreamedRecording, Truncated

_MAGIC = b"#!AER-DAT2.0"
_SAMPLE_BYTES = 1 << 16
# Sensors by the chip that the header names: eu.seebetter.ini.chips.davis.DAVIS240C, …
_DVS128 = (128, 128)
_CHIPS = {"DAVIS240": (240, 180), "DAVIS346": (346, 260), "DVS128": _DVS128, "TMPDIFF128": _DVS128}


def chip_size(name):
    """``(width, height)`` of the sensor of a chip; None if its name is not known."""
    return next((size for begin, size in _CHIPS.items() if name.upper().startswith(begin)), None)


class Aedat2Recording(RecordsRecording):
    """Events of an AEDAT 2.0 file."""

    record_bytes, time_bits = 8, 32

    def __init__(self, path, *, time_unit=None, sensor=None):
        chip, begin = None, 0
        with path.open("rb") as file:
            # The first record may begin with a #, too; control characters tell it from a line.
            while (line := file.readline(_SAMPLE_BYTES)).startswith(b"#") and not re.search(
                rb"[\0-\x08\x0e-\x1f]", line
            ):
                if match := re.match(rb"# *AEChip: *(\S+)", line):
                    chip = match[1].decode("latin-1").rpartition(".")[2]
                begin = file.tell()
            file.seek(begin)
            first = self._words(file.read(_SAMPLE_BYTES))[:, 0]
        size = chip_size(chip or "")
        self._small = size == _DVS128 or (size is None and len(first) > 0 and not (first >> 16).any())
        self._chip_size = size = size or (_DVS128 if self._small else sensor)
        if size is None:
            named = f"chip {chip[:40]!r}" if chip else "no line '# AEChip:' in the header"
            needed = "a DAVIS240, DAVIS346 or DVS128 is needed, or --sensor W,H (sensor=) of another DAVIS"
            raise RecordingError(f"{path}: AEDAT 2.0, {named}; {needed}")
        super().__init__(path, "AEDAT 2.0", begin=begin, sensor=sensor or size, time_unit=time_unit)

    @staticmethod
    def _words(content):
        return np.frombuffer(content[: len(content) // 8 * 8], ">u4").reshape(-1, 2).astype(np.int64)

    def _decode(self, content):
        words = self._words(content)
        address, t = words[(words[:, 0] & (1 << 15 if self._small else 1 << 31 | 1 << 10)) == 0].T
        x, y, p = (
            (address >> 1 & 0x7F, address >> 8 & 0x7F, 1 - (address & 1))
            if self._small
            else (address >> 12 & 0x3FF, address >> 22 & 0x1FF, address >> 11 & 1)
        )
        width, height = self._chip_size
        return t, width - 1 - x, height - 1 - y, p


_MAGIC_3, _END = b"#!AER-DAT3.1", b"#!END-HEADER"
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

    def _stored(self):
        camera, end = None, self.path.stat().st_size
        with self.path.open("rb") as file:
            file.seek(self._begin)
            while head := file.read(_PACKET.size):
                kind, source, size, _, turns, capacity, number, _ = _PACKET.unpack(head.ljust(_PACKET.size, b"\0"))
                missing = file.tell() - len(head) + _PACKET.size + size * capacity - end
                if kind == _POLARITY and size == _EVENT_BYTES and camera in (None, source):
                    camera, content = source, file.read(size * capacity - max(missing, 0))
                    words = np.frombuffer(content[: len(content) // size * size], "<u4").reshape(-1, 2)[:number]
                    data, t = words[words[:, 0] & 1 == 1].T.astype(np.int64)
                    yield t + (turns << 31), data >> 17, data >> 2 & 0x7FFF, data >> 1 & 1
                else:
                    file.seek(min(file.tell() + size * capacity, end))
                if missing > 0:
                    raise Truncated(f"{missing} bytes of the last packet are missing")


def _refuse(path, *, time_unit=None, sensor=None):
    with path.open("rb") as file:
        version = file.readline(40)[9:].strip().decode("latin-1")
    raise RecordingError(f"{path}: AEDAT {version!r}; version 2.0, 3.1 or 4.0 is needed")


class NmnistRecording(RecordsRecording):
    """Events of a file of N-MNIST's form."""

    record_bytes, time_bits = 5, 23

    def __init__(self, path, *, time_unit=None, sensor=None, form=None):
        super().__init__(path, "N-MNIST", sensor=sensor, time_unit=time_unit)

    @staticmethod
    def _decode(content):
        x, y, high, middle, low = np.frombuffer(content, np.uint8).reshape(-1, 5).T.astype(np.int64)
        return (high & 0x7F) << 16 | middle << 8 | low, x, y, high >> 7


def _is_nmnist(head, path):
    whole = len(head) // NmnistRecording.record_bytes * NmnistRecording.record_bytes
    t, *_ = NmnistRecording._decode(head[:whole])
    return path.suffix.lower() == ".bin" and len(t) > 0 and not (np.diff(t) < 0).any()


FORMATS = (
    # Asked last: any other version.
    Format("AEDAT", (".aedat",), lambda head, path: head.startswith(b"#!AER-DAT"), _refuse),
    Format("AEDAT 2.0", (".aedat",), lambda head, path: head.startswith(_MAGIC), Aedat2Recording),
    Format("AEDAT 3.1", (".aedat",), lambda head, path: head.startswith(_MAGIC_3), Aedat3Recording),
)
NMNIST = Format("N-MNIST", (".bin",), _is_nmnist, NmnistRecording, forms=("nmnist",))
