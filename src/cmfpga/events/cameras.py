"""The cameras' own formats: AEDAT 4, Prophesee DAT, Event Stream. Decoded by ``faery``, an optional package.

``pip install 'cmfpga[formats]'`` brings it. It streams: of a file only some thousand events are in memory at a time.
Its times, columns and rows are taken as they are; x = 0 is the left column and y = 0 the top row in all three. Each
names the size of its sensor.

Formats: https://gitlab.com/inivation/inivation-docs (AEDAT 4), https://docs.prophesee.ai/stable/data (DAT),
https://github.com/neuromorphic-paris/event_stream (Event Stream).
"""

import functools
import importlib
import struct

from ..errors import RecordingError
from .columns import readable, why
from .raw import is_dat, prophesee_header
from .recording import HEAD_BYTES, Format
from .streamed import StreamedRecording, Truncated

EXTRA = "pip install 'cmfpga[formats]'"

_DAT_EVENT_BYTES = 8
_AEDAT4 = b"#!AER-DAT4"
_AEDAT4_BEGIN = 18  # the magic line, and four bytes of the header's length


class CameraRecording(StreamedRecording):
    """Events of a file that ``faery`` decodes, which calls the format ``kind``; ``file_sensor``: what the file says."""

    def __init__(self, path, *, kind, format, time_unit=None, sensor=None, file_sensor=None):
        self._kind = kind
        self._faery = import_optional("faery", path, format)
        super().__init__(path, format, sensor=sensor or file_sensor, time_unit=time_unit)
        if self.width is None and kind != "dat":
            try:
                self.width, self.height = map(int, self._stream().dimensions())
            except BaseException as error:
                raise self._error(error, 0) from None
        self._require_events()

    def _stream(self):
        # Of a DAT that does not name the sensor, all that its coordinates can be.
        sensor = (1 << 14, 1 << 14) if self._kind == "dat" else (1, 1)
        return self._faery.events_stream_from_file(self.path, file_type=self._kind, dimensions_fallback=sensor)

    def _stored(self):
        count, stream = 0, None
        try:
            stream = iter(self._stream())
            while (events := next(stream, None)) is not None:
                count += len(events)
                yield [events[name] for name in ("t", "x", "y", "on")]
        except GeneratorExit:
            raise
        except BaseException as error:
            raise self._error(error, count) from None
        finally:
            if stream is not None:
                stream.close()
        if rest := self._truncated_bytes():
            raise Truncated(rest)

    def _error(self, error, count):
        # A defect in faery's compiled part shows as pyo3's PanicException, which is no Exception.
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise error
        after = f"after {count} events" if count else "from its begin"
        return RecordingError(f"{self.name}: {self.format} cannot be read {after} {why(error)}")

    def _truncated_bytes(self):
        """What tells that the file ends too early, though all of it was decoded; or None."""
        size = self.path.stat().st_size
        with self.path.open("rb") as file:
            head = file.read(HEAD_BYTES)
        if self._kind == "aedat" and (table := _data_table_position(head)) > size:
            return f"{size:,} bytes of more than {table:,}"
        if self._kind == "dat" and (rest := (size - prophesee_header(head)[1] - 2) % _DAT_EVENT_BYTES):
            return f"{rest} of {_DAT_EVENT_BYTES} bytes of the last word are there"
        return None


def import_optional(name, path, format):
    """The package ``name``; a :exc:`RecordingError` that says how to install it."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
        raise RecordingError(f"{path}: reading {format} needs the package {name}: {EXTRA}") from None


def open_dat(path, *, time_unit=None, sensor=None):
    """The :class:`Recording` of a Prophesee DAT file."""
    with path.open("rb") as file:
        fields, _ = prophesee_header(file.read(HEAD_BYTES))
    size = (fields.get("width", ""), fields.get("height", ""))
    return CameraRecording(
        path, kind="dat", format="Prophesee DAT", time_unit=time_unit, sensor=sensor,
        file_sensor=tuple(map(int, size)) if all(side.isdecimal() and int(side) for side in size) else None,
    )  # fmt: skip


def _data_table_position(head):
    """Where the table at the end of an AEDAT 4 file begins, bytes; -1 if it was never written.

    The header is a flat buffer (a table with an offset to each of its fields), of which this is the second field.
    """
    try:
        (root,) = struct.unpack_from("<I", head, _AEDAT4_BEGIN)
        table = _AEDAT4_BEGIN + root
        (back,) = struct.unpack_from("<i", head, table)
        size, _, _, offset = struct.unpack_from("<HHHH", head, table - back)
        return struct.unpack_from("<q", head, table + offset)[0] if size >= 8 and offset else -1
    except struct.error:
        return -1


def open_aedat4(path, *, time_unit=None, sensor=None):
    """The :class:`Recording` of an AEDAT 4 file; of several event streams in it, the first."""
    with path.open("rb") as file:
        begin = file.read(_AEDAT4_BEGIN)
        size = struct.unpack_from("<I", begin, 14)[0] if len(begin) == _AEDAT4_BEGIN else 0
        # The description: faery ends the whole process where it is no text.
        header = file.read(min(size, 1 << 24))
    text = header[max(header.find(b"<"), 0) :]
    with readable(f"{path}: not a readable AEDAT 4 file", ValueError):
        if len(header) < size or not size:
            raise ValueError("the header is not complete")
        text.decode("utf-8")
    return CameraRecording(path, kind="aedat", format="AEDAT 4", time_unit=time_unit, sensor=sensor)


_open_es = functools.partial(CameraRecording, kind="es", format="Event Stream")  # of DVS or ATIS events

FORMATS = (
    Format("Event Stream", (".es",), lambda head, path: head.startswith(b"Event Stream"), _open_es),
    Format("Prophesee DAT", (".dat",), is_dat, open_dat),
    Format("AEDAT 4", (".aedat4",), lambda head, path: head.startswith(_AEDAT4), open_aedat4),
)
