"""AEDAT 2.0 recordings, as jAER and v2e write them. No package that is kept reads their addresses right.

Header lines begin with ``#``; then each record is an address and a time stamp, of 32 bits each, big-endian. Of a
DAVIS's address bit 31 marks frames and inertial samples, bit 10 external triggers (both are skipped); bits 30–22 are
the row counted from the bottom, 21–12 the column counted from the right, 11 the polarity. Of a DVS128's bit 15 marks
what is no event; bits 14–8 are the row, 7–1 the column, counted likewise, 0 is 1 for darker. Time stamps are µs and
wrap at 2^32.

The header names the chip. Where it does not, or another one, addresses of 16 bits are a DVS128's, and others those of
a DAVIS of the size that the caller gives.

Source: https://docs.inivation.com/software/software-advanced-usage/file-formats/aedat-2.0.html; the sense of rows and
columns was checked against a recording of a DAVIS 240C.
"""

import re

import numpy as np

from ..errors import RecordingError
from .recording import Format
from .streamed import RecordsRecording

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
        size = size or (_DVS128 if self._small else sensor)
        if size is None:
            named = f"chip {chip[:40]!r}" if chip else "no line '# AEChip:' in the header"
            raise RecordingError(
                f"{path}: AEDAT 2.0, {named}; a DAVIS240, DAVIS346 or DVS128 is needed, or --sensor W,H (sensor=) of "
                "another DAVIS"
            )
        self._chip_size = size
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


def _refuse(path, *, time_unit=None, sensor=None):
    with path.open("rb") as file:
        version = file.readline(40)[9:].strip().decode("latin-1")
    raise RecordingError(f"{path}: AEDAT {version!r}; version 2.0, 3.1 or 4.0 is needed")


FORMATS = (
    # Asked last: any other version.
    Format("AEDAT", (".aedat",), lambda head, path: head.startswith(b"#!AER-DAT"), _refuse),
    Format("AEDAT 2.0", (".aedat",), lambda head, path: head.startswith(_MAGIC), Aedat2Recording),
)
