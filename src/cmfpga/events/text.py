"""Text recordings, plain or in a zip archive: one event ``t x y p`` per line, as in the DAVIS 240C data set.

Fields are separated by blanks or commas. Empty lines and what follows ``#`` are skipped. One line with two integers,
width and height of the sensor, may stand before the first event. An archive holds one ``.txt`` or ``.csv`` file, or
several of which one is ``events.txt``.

Times are converted from their decimal digits, so they are exact to half a microsecond. The text is read in blocks,
never as a whole; how many events there are is only known at its end.
"""

import contextlib
import zipfile
import zlib
from itertools import islice

import numpy as np

from ..errors import RecordingError
from .columns import one_line
from .recording import Format, Recording, check_sensor
from .textlines import LineError, parse_fast, parse_line, split_line
from .units import POWER, SAMPLE_EVENTS, guess_unit

_BLOCK_BYTES = 1 << 20
_MAX_LINE_BYTES = 4096
_READ_ERRORS = (OSError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error)
# Lines of which the unit of time is told apart: see units.py.
_FRACTION_LINES = 1000


class TextRecording(Recording):
    """Events of a text file, or of the text member ``member`` of a zip archive."""

    def __init__(self, path, *, time_unit=None, sensor=None, member=None):
        self._member = member
        super().__init__(
            path=path,
            name=str(path) if member is None else f"{path}/{member}",
            format="text" if member is None else "zipped text",
            sensor=sensor,
            num_events=None,
            time_unit=time_unit,
            time_unit_source="given" if time_unit else "assumed",
        )
        self._skip_lines, header_sensor = self._read_header()
        if sensor is None and header_sensor is not None:
            self.width, self.height = header_sensor
        if time_unit is None:
            self.time_unit = self._guess_unit()
        with contextlib.closing(self._parsed()) as blocks:
            if next(blocks, None) is None:
                raise RecordingError(f"{self.name}: no events")

    def _read_header(self):
        """Number of lines before the first event, and the sensor's size if one of them gives it."""
        sensor, skip = None, 0
        with contextlib.closing(self._lines()) as lines:
            for number, line in lines:
                fields = split_line(line)
                if len(fields) == 2 and sensor is None and all(field.isdecimal() for field in fields):
                    sensor = check_sensor(map(int, fields), f"{self.name}, line {number}")
                elif fields:
                    break
                skip = number
        return skip, sensor

    def _guess_unit(self):
        with contextlib.closing(self._lines()) as lines:
            for number, line in islice(lines, self._skip_lines, self._skip_lines + _FRACTION_LINES):
                self._parse_line(number, line, 0)  # the first odd line is reported whatever the unit is
                fields = split_line(line)
                if fields and float(fields[0]) % 1:
                    return "s"
        with contextlib.closing(self._parsed(power=0)) as blocks:
            parts = []
            for columns in blocks:
                parts.append(columns[0])
                if sum(map(len, parts)) >= SAMPLE_EVENTS:
                    break
        return guess_unit(np.concatenate(parts)) if parts else "us"

    # ---------------------------------------------------------------- blocks, lines, columns

    def _blocks(self):
        """Yields ``(number of the first line, bytes of whole lines)``."""
        number, rest = 1, b""
        try:
            with contextlib.ExitStack() as stack:
                if self._member is None:
                    file = stack.enter_context(open(self.path, "rb"))
                else:
                    file = stack.enter_context(zipfile.ZipFile(self.path)).open(self._member)
                    stack.enter_context(file)
                while content := file.read(_BLOCK_BYTES):
                    end = content.rfind(b"\n") + 1
                    if end:
                        block = rest + content[:end]
                        yield number, block
                        number += block.count(b"\n")
                        rest = content[end:]
                    else:
                        rest += content
                    if len(rest) > _MAX_LINE_BYTES:
                        raise RecordingError(
                            f"{self.name}, line {number}: more than {_MAX_LINE_BYTES} bytes; 't x y p' is needed"
                        )
        except _READ_ERRORS as error:
            raise RecordingError(
                f"{self.name}, line {number} or later: cannot be read (truncated or damaged): {one_line(error)}"
            ) from None
        if rest:
            yield number, rest

    def _lines(self):
        for first, block in self._blocks():
            yield from enumerate(block.split(b"\n")[: block.count(b"\n") + (not block.endswith(b"\n"))], first)

    def _parse_line(self, number, line, power):
        try:
            return parse_line(line, power)
        except LineError as error:
            raise RecordingError(f"{self.name}, line {number}: {error}") from None

    def _parsed(self, power=None):
        """Yields columns (t, x, y, p), int64, of one block each; t in µs, or times ``10**power``."""
        power = POWER[self.time_unit] if power is None else power
        for first, block in self._blocks():
            if first <= self._skip_lines:  # in the first block, unless there are very many comments
                lines = block.split(b"\n")
                skip = min(self._skip_lines + 1 - first, len(lines))
                first, block = first + skip, b"\n".join(lines[skip:])
            columns = parse_fast(block, power)
            if columns is None:
                rows = (self._parse_line(number, line, power) for number, line in enumerate(block.split(b"\n"), first))
                rows = np.array([row for row in rows if row is not None], np.int64).reshape(-1, 4)
                columns = list(rows.T)
            if len(columns[0]):
                yield columns

    def _columns(self, start, size):
        kept, count, total = [], 0, 0
        for columns in self._parsed():
            length = len(columns[0])
            skip = min(max(start - total, 0), length)
            total += length
            if skip == length:
                continue
            kept.append([column[skip:] for column in columns])
            count += length - skip
            while count >= size:
                joined = _join(kept)
                # As many chunks as there are, then keep the rest: each event is copied once.
                for at in range(0, count - size + 1, size):
                    yield [column[at : at + size] for column in joined]
                rest = count % size
                kept = [[column[count - rest :] for column in joined]] if rest else []
                count = rest
        if total <= start:
            raise self._start_error(start, total)
        if count:
            yield _join(kept)


def _join(parts):
    return [np.concatenate(columns) for columns in zip(*parts, strict=True)]


def _is_text(head, path):
    # Event cameras' binary formats also begin with lines of text: AEDAT with "#!AER-DAT", Prophesee RAW with "% ".
    if head.startswith((b"#!AER-DAT", b"% ")):
        return False
    return not any(byte < 32 and byte not in b"\t\n\r\f" for byte in head)


def _is_zip(head, path):
    # An archive without its directory, at the end of the file, is truncated: the extension has to tell what it was.
    return head.startswith((b"PK\x03\x04", b"PK\x05\x06")) and (zipfile.is_zipfile(path) or path.suffix == ".zip")


def _open_zip(path, *, time_unit=None, sensor=None):
    try:
        with zipfile.ZipFile(path) as archive:
            names = [name for name in archive.namelist() if name.lower().endswith((".txt", ".csv"))]
    except (*_READ_ERRORS, ValueError) as error:  # ValueError: undecodable names
        raise RecordingError(f"{path}: not a readable zip archive (truncated or damaged): {one_line(error)}") from None
    events = [name for name in names if name.rsplit("/")[-1] == "events.txt"]
    if len(names) != 1:
        names = events
    if len(names) != 1:
        raise RecordingError(f"{path}: archive without one .txt or .csv file, or one events.txt among several")
    return TextRecording(path, time_unit=time_unit, sensor=sensor, member=names[0])


FORMATS = (
    Format("text", (".txt", ".csv"), _is_text, TextRecording),
    Format("zipped text", (".zip",), _is_zip, _open_zip),
)
