"""AEDAT 2.0 recordings of DAVIS cameras, as jAER writes them. No package that is kept reads their addresses right.

Header lines begin with ``#``; then each record is an address and a time stamp, of 32 bits each, big-endian. Of a
DAVIS's address bit 31 marks frames and inertial samples, bit 10 external triggers (both are skipped); bits 30–22 are
the row counted from the bottom, 21–12 the column counted from the right, 11 the polarity. Time stamps are µs and wrap
at 2^32.

Source: https://docs.inivation.com/software/software-advanced-usage/file-formats/aedat-2.0.html; the sense of rows and
columns was checked against a recording of a DAVIS 240C.
"""

import re

import numpy as np

from ..errors import RecordingError
from .recording import Format
from .streamed import StreamedRecording
from .units import to_us

_MAGIC = b"#!AER-DAT2.0"
_RECORDS = 1 << 16
_RECORD_BYTES = 8
_WRAP = 1 << 32
# Sensors by the chip that the header names: eu.seebetter.ini.chips.davis.DAVIS240C, …
_CHIPS = {"DAVIS240": (240, 180), "DAVIS346": (346, 260)}


class Aedat2Recording(StreamedRecording):
    """Events of an AEDAT 2.0 file."""

    def __init__(self, path, *, time_unit=None, sensor=None):
        with path.open("rb") as file:
            chip = None
            begin = 0
            while file.read(1) == b"#":
                line = file.readline()
                if match := re.match(rb" *AEChip: *(\S+)", line):
                    chip = match[1].decode("latin-1").rpartition(".")[2]
                begin = file.tell()
        self._begin = begin
        size = next((size for name, size in _CHIPS.items() if (chip or "").upper().startswith(name)), None)
        if size is None:
            named = f"chip {chip[:40]!r}" if chip else "no line '# AEChip:' in the header"
            raise RecordingError(f"{path}: AEDAT 2.0, {named}; a DAVIS240 or DAVIS346 is needed")
        self._chip_size = size
        super().__init__(path, "AEDAT 2.0", sensor=sensor or size, time_unit=time_unit)
        self._require_events()

    def _pieces(self):
        width, height = self._chip_size
        wraps, last, count = 0, 0, 0
        with self.path.open("rb") as file:
            file.seek(self._begin)
            while content := file.read(_RECORDS * _RECORD_BYTES):
                whole = len(content) // _RECORD_BYTES * _RECORD_BYTES
                address, t = np.frombuffer(content[:whole], ">u4").reshape(-1, 2).T.astype(np.int64)
                events = (address & (1 << 31 | 1 << 10)) == 0
                address, t = address[events], t[events]
                if len(t):
                    # Half the range back is a wrap; less is a step back, which the checks report.
                    back = np.diff(t, prepend=last) < -_WRAP // 2
                    last = int(t[-1])
                    t += (wraps + np.cumsum(back)) * _WRAP
                    wraps += int(back.sum())
                    yield (
                        to_us(t, self.time_unit, self.name, count),
                        width - 1 - (address >> 12 & 0x3FF),
                        height - 1 - (address >> 22 & 0x1FF),
                        address >> 11 & 1,
                    )
                    count += len(t)
                if whole < len(content):
                    raise RecordingError(
                        f"{self.name}: truncated: {len(content) - whole} of {_RECORD_BYTES} bytes of the last record "
                        f"are there; the {count} events before were read"
                    )


def _refuse(path, *, time_unit=None, sensor=None):
    with path.open("rb") as file:
        version = file.readline(40)[9:].strip().decode("latin-1")
    raise RecordingError(f"{path}: AEDAT {version!r}; version 2.0 or 4.0 is needed")


FORMATS = (
    # Asked last of the three: any other version.
    Format("AEDAT", (".aedat",), lambda head, path: head.startswith(b"#!AER-DAT"), _refuse),
    Format("AEDAT 2.0", (".aedat",), lambda head, path: head.startswith(_MAGIC), Aedat2Recording),
)
