"""Text recordings: one event ``t x y p`` per line, as in the DAVIS 240C data set, or CSV; also gzipped or zipped.

Fields are separated by blanks, commas or semicolons. Empty lines and what follows ``#`` are skipped. One line with two
integers, width and height of the sensor, may stand before the first event, or lines that begin with ``%``, such as
``%geometry:W,H``. An archive holds one ``.txt`` or ``.csv`` file, or several of which one is ``events.txt``.

A line of names before the first event, also as a comment, says which column is which (names: see ``columns.NAMES``,
and ``on`` for the polarity); other columns are skipped. Behind a name may stand the unit of t (``t [us]``, ``t_us``),
or the sensor's size (``x@240,y@180``, as ``faery`` writes it). Without names the columns are as the caller says, or as
:func:`~.columns.guess_order` does.

Times are converted from their decimal digits, so they are exact to half a microsecond. The text is read in blocks,
never as a whole; how many events there are is only known at its end.
"""

import codecs
import contextlib
import gzip
import re
import zipfile
import zlib
from itertools import islice

import numpy as np

from ..errors import RecordingError
from .arrays import highest_off
from .columns import guess_order, match_names, order_notes, readable, why
from .recording import HEAD_BYTES, Format, check_sensor
from .streamed import StreamedRecording
from .textlines import PLAIN, Layout, LineError, parse_fast, parse_line, split_line
from .units import POWER, SAMPLE_EVENTS, find_unit, guess_unit

_BLOCK_BYTES = 1 << 20
_MAX_LINE_BYTES = 4096
_READ_ERRORS = (OSError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error)
# Lines of which the unit of time is told apart: see units.py.
_FRACTION_LINES = 1000


class TextRecording(StreamedRecording):
    """Events of a text file, of a gzipped one, or of the text member ``member`` of a zip archive.

    ``columns`` are the names of a line's fields, such as ``("x", "y", "t", "p")``; others than those four are skipped.
    """

    fast = False

    def __init__(self, path, *, time_unit=None, sensor=None, columns=None, member=None, kind="text"):
        self._member, self._gzipped = member, kind == "gzipped text"
        name = str(path) if member is None else f"{path}/{member}"
        super().__init__(path, kind, sensor=sensor, time_unit=time_unit, name=name)
        self._skip_lines, named, header_sensor, header_unit = self._read_header(columns)
        self._fields = named or PLAIN
        self._cure = "" if named else "; --columns (columns=) says which is which"
        table = self._first_fields(_FRACTION_LINES)
        if not named and len(table):
            order = guess_order(table)
            self._fields = Layout(*map(order.index, "txyp"))
            self._layout, self._order_notes = order_notes(order, True)
        self._highest_off = highest_off(table[:, self._fields.p]) if len(table) else 0
        if sensor is None and header_sensor is not None:
            self.width, self.height = header_sensor
        if time_unit is None and header_unit is not None:
            self.time_unit, self.time_unit_source = header_unit, "file"
        elif time_unit is None:
            self.time_unit, self.time_unit_source = self._guess_unit(), "assumed"
        self._require_events()

    def _read_header(self, columns):
        """Number of lines before the first event, the layout of a line, and the sensor and unit that they give."""
        layout, sensor, unit, skip = None, None, None, 0
        told = columns and Layout(**{name: columns.index(name) for name in "txyp"}, fields=len(columns))
        with contextlib.closing(self._lines()) as lines:
            for number, line in lines:
                fields = [] if line.startswith(b"%") else split_line(line)
                where = f"{self.name}, line {number}"
                if size := _GEOMETRY.match(line):
                    sensor = check_sensor(map(int, size.groups()), where)
                names = None if layout else _column_names(line, comment=not fields)
                if names:
                    layout, unit, size = names
                    sensor = check_sensor(size, where) if size else sensor
                elif len(fields) == 2 and sensor is None and all(field.isdecimal() for field in fields):
                    sensor = check_sensor(map(int, fields), where)
                elif fields and not (told and layout is None and not any(map(_is_number, fields))):
                    break
                elif fields:  # names of any kind
                    layout = told
                skip = number
        return skip, told or layout, sensor, unit

    def _guess_unit(self):
        with contextlib.closing(self._lines()) as lines:
            for number, line in islice(lines, self._skip_lines, self._skip_lines + _FRACTION_LINES):
                self._parse_line(number, line)  # the first odd line is reported whatever the unit is
                fields = split_line(line)
                if fields and float(fields[self._fields.t]) % 1:
                    return guess_unit(self._first_fields(SAMPLE_EVENTS)[:, self._fields.t])
        parts = []
        with contextlib.closing(self._pieces()) as pieces:  # as they stand there, for the unit is µs until now
            while sum(map(len, parts)) < SAMPLE_EVENTS and (columns := next(pieces, None)):
                parts.append(columns[0])
        return guess_unit(np.concatenate(parts)) if parts else "us"

    def _first_fields(self, count):
        """Fields of the first ``count`` lines as they stand there, float64; NaN for what is no number."""
        with contextlib.closing(self._lines()) as lines:
            rows = (split_line(line) for _, line in islice(lines, self._skip_lines, self._skip_lines + count))
            fields = (field for row in rows if len(row) == self._fields.fields for field in row)
            values = np.fromiter((float(field) if _is_number(field) else np.nan for field in fields), float)
        return values.reshape(-1, self._fields.fields)

    def _blocks(self):
        """Yields ``(number of the first line, bytes of whole lines)``."""
        number = 1
        try:
            with contextlib.ExitStack() as stack:
                if self._member is None:
                    file = stack.enter_context((gzip.open if self._gzipped else open)(self.path, "rb"))
                else:
                    file = stack.enter_context(zipfile.ZipFile(self.path)).open(self._member)
                    stack.enter_context(file)
                rest = file.read(len(codecs.BOM_UTF8)).removeprefix(codecs.BOM_UTF8)
                while content := file.read(_BLOCK_BYTES):
                    before, end, after = content.rpartition(b"\n")
                    if end:
                        block = rest + before + end
                        yield number, block
                        number, rest = number + block.count(b"\n"), b""
                    rest += after
                    if len(rest) > _MAX_LINE_BYTES:
                        what = f"more than {_MAX_LINE_BYTES} bytes; '{PLAIN.text}' is needed"
                        raise RecordingError(f"{self.name}, line {number}: {what}")
        except _READ_ERRORS as error:
            raise RecordingError(f"{self.name}, line {number} or later: cannot be read {why(error)}") from None
        if rest:
            yield number, rest

    def _lines(self):
        for first, block in self._blocks():
            yield from enumerate(block.split(b"\n")[: block.count(b"\n") + (not block.endswith(b"\n"))], first)

    def _parse_line(self, number, line):
        try:
            return parse_line(line, POWER[self.time_unit], self._fields)
        except LineError as error:
            raise RecordingError(f"{self.name}, line {number}: {error}{self._cure}") from None

    def _pieces(self):
        """Yields columns (t, x, y, p), int64, of one block each; t in µs."""
        for first, block in self._blocks():
            if first <= self._skip_lines:  # in the first block, unless there are very many comments
                lines = block.split(b"\n")
                skip = min(self._skip_lines + 1 - first, len(lines))
                first, block = first + skip, b"\n".join(lines[skip:])
            columns = parse_fast(block, POWER[self.time_unit], self._fields)
            if columns is None:
                rows = (self._parse_line(number, line) for number, line in enumerate(block.split(b"\n"), first))
                rows = np.array([row for row in rows if row is not None], np.int64).reshape(-1, 4)
                columns = list(rows.T)
            if len(columns[0]):
                yield columns


def _is_number(field):
    with contextlib.suppress(ValueError):
        return float(field) is not None
    return False


# A column's name, and what may follow it: its unit in brackets or after an underscore, or @ and the sensor's size.
_NAME = re.compile(r"([a-z]+)(?:(?:\s*[\[(]|_|\s+)([a-zµμ]+)[\])]?|@(\d+))?")
# The head that Metavision writes.
_GEOMETRY = re.compile(rb"% *geometry *: *(\d+)[,x](\d+)")


def _column_names(line, comment):
    """``(layout, unit or None, size of the sensor or None)`` if a line names t, x, y and p; otherwise None."""
    text = line.decode("utf-8", "replace").strip()
    if comment:
        text = text.lstrip("#%").strip()
    fields = re.split(r"\s*[,;\t]\s*" if re.search(r"[,;\t]", text) else r"\s+", text.lower())
    matches = [_NAME.fullmatch(field.strip("\"' ")) for field in fields]
    names = [match[1] if match else "" for match in matches]
    found = match_names(names)
    if len(found) < 4 or len(names) != len(fields):
        return None
    at = {column: names.index(name) for column, name in found.items()}
    sizes = [matches[at[axis]][3] for axis in "xy"]
    unit = matches[at["t"]][2]
    return Layout(**at, fields=len(fields)), find_unit(unit), tuple(map(int, sizes)) if all(sizes) else None


def _is_text(head, path):
    # Event cameras' binary formats also begin with lines of text: AEDAT with "#!AER-DAT", Prophesee RAW with "% ".
    if head.startswith((b"#!AER-DAT", b"% ")):
        return False
    return bool(head) and not any(byte < 32 and byte not in b"\t\n\r\f" for byte in head)


def _is_zip(head, path):
    # An archive without its directory, at the end of the file, is truncated: the extension has to tell what it was.
    return head.startswith((b"PK\x03\x04", b"PK\x05\x06")) and (zipfile.is_zipfile(path) or path.suffix == ".zip")


def _open_gzip(path, **options):
    with readable(f"{path}: not a readable gzip file", _READ_ERRORS), gzip.open(path, "rb") as file:
        head = file.read(HEAD_BYTES)
    if not head or not _is_text(head, path):
        raise RecordingError(f"{path}: {'gzip of something else than' if head else 'an empty'} text; text is needed")
    return TextRecording(path, kind="gzipped text", **options)


def _open_zip(path, **options):
    errors = (*_READ_ERRORS, ValueError)  # ValueError: undecodable names
    with readable(f"{path}: not a readable zip archive", errors), zipfile.ZipFile(path) as archive:
        names = [name for name in archive.namelist() if name.lower().endswith((".txt", ".csv"))]
    if len(names) != 1:
        names = [name for name in names if name.rsplit("/")[-1] == "events.txt"]
    if len(names) != 1:
        raise RecordingError(f"{path}: archive without one .txt or .csv file, or one events.txt among several")
    return TextRecording(path, member=names[0], kind="zipped text", **options)


FORMATS = (
    Format("text", (".txt", ".csv"), _is_text, TextRecording, ("columns",)),
    Format("zipped text", (".zip",), _is_zip, _open_zip, ("columns",)),
    Format("gzipped text", (".gz",), lambda head, path: head.startswith(b"\x1f\x8b"), _open_gzip, ("columns",)),
)
