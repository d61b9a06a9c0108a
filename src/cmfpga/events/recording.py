"""Recordings of events: the interface, the registry of formats, and :func:`open_recording`."""

import abc
import contextlib
import operator
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import RecordingError, one_of
from .arrays import EventChecker, Events, polarity_notes
from .units import SAMPLE_EVENTS, parse_unit

CHUNK_EVENTS = 1 << 16

# Of the first events, so many at least, this share at one time is odd.
_MIN_SAMPLE, _ONE_TIME = 100, 0.9

# Bytes of a file that a format is recognised by.
HEAD_BYTES = 4096


class Recording(abc.ABC):
    """Events of one recording, read in chunks; a context manager.

    Members
    -------
    path : Path or None
        The file; None for events in memory.
    name, format : str
        For people: the path, or the name that was given; and such as ``"HDF5"``.
    width, height : int or None
        Size of the sensor, px; None where neither the file nor the caller says it.
    num_events : int or None
        None where only reading all of them would tell (text).
    time_unit, time_unit_source : str
        Unit of the stored time stamps, ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``; events always come in µs. It is
        ``"given"``, of the ``"file"`` (an attribute, or a format that defines it), or ``"assumed"`` (``events.units``).
    """

    #: A recording is an :class:`~cmfpga.events.arrays.EventSource` that can be read again.
    seekable = True

    def __init__(self, *, path, name, format, sensor, num_events, time_unit, time_unit_source):
        self.path, self.name, self.format = path, name, format
        self.width, self.height = sensor or (None, None)
        self.num_events, self.time_unit, self.time_unit_source = num_events, time_unit, time_unit_source
        self._closed, self._layout, self._order_notes, self._highest_off = False, "", [], 0

    def chunks(self, start=0, size=CHUNK_EVENTS):
        """Iterator of :class:`Events` from event ``start`` (from 0) to the end, each of ``size``, the last of the rest.

        Memory is bounded by ``size``. Several iterators may be in use at once. Raises :exc:`RecordingError`, at once or
        while iterating, where ``start`` is not an event of the recording, or an event cannot be used (see
        :class:`EventChecker`). Events before ``start`` are not checked, apart from the syntax of text.
        """
        self._require_open()
        start, size = operator.index(start), operator.index(size)
        if size < 1:
            raise RecordingError(f"{self.name}: chunks of {size} events; 1 or more is needed")
        if start < 0 or (self.num_events is not None and start >= self.num_events):
            raise self._start_error(start, self.num_events)
        return self._checked(start, size)

    def _checked(self, start, size):
        check = EventChecker(self.where, self.width, self.height, start, self._highest_off)
        for columns in self._columns(start, size):
            yield Events(*check(*columns))

    def _start_error(self, start, num_events):
        allowed = "0 or more" if num_events is None else f"0 to {num_events - 1}"
        return RecordingError(f"{self.name}: first event {start}; {allowed} is allowed")

    def _require_open(self):
        if self._closed:
            raise RecordingError(f"{self.name}: the recording is closed")

    def extent(self):
        """``(number of events, time of the last one in µs)`` where that is known soon; otherwise None."""
        if not self.num_events:
            return None
        (last,) = self.chunks(self.num_events - 1)
        return self.num_events, int(last.t[0])

    def notes(self):
        """What is odd about the first events, for people; empty for most recordings."""
        return [f"{self.name}: {note}" for note in (*self._order_notes, *self._odd_polarities_and_times())]

    def _odd_polarities_and_times(self):
        with contextlib.suppress(RecordingError):  # told where the events are used
            yield from polarity_notes(next(self._columns(0, SAMPLE_EVENTS))[3])
            t = next(self.chunks(0, SAMPLE_EVENTS)).t
            times, counts = np.unique(t, return_counts=True)
            most = int(counts.argmax())
            if len(t) >= _MIN_SAMPLE and counts[most] > _ONE_TIME * len(t):
                yield (
                    f"{counts[most] / len(t):.0%} of the first {len(t):,} events share the time "
                    f"{times[most]} µs, so no motion can be seen in them: is the unit of time too coarse?"
                )

    @property
    def where(self):
        """Start of messages about events: the name, and what the columns are if that needs to be said."""
        return self.name + self._layout

    @abc.abstractmethod
    def _columns(self, start, size):
        """Yields ``(t, x, y, p)`` from event ``start`` on, ``size`` events each: t int64 in µs, others as stored."""

    def close(self):
        """Releases the file. May be called more than once."""
        self._closed = True

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


@dataclass(frozen=True)
class Format:
    """A format of recordings.

    ``extensions`` are those of files, lower case, with the dot; they only count where the content does not decide.
    ``matches(head, path)`` says whether a file is of this format, by its first ``HEAD_BYTES`` bytes, none of a folder.
    ``open(path, time_unit=, sensor=)`` gives the :class:`Recording`; both arguments are checked, or None. ``options``
    are those of ``columns=`` and ``dataset=`` that it takes, too; each comes checked, and only where it is given.
    ``forms`` are what ``form=`` (``--format``) calls it where neither content nor extension need to tell; ``open`` then
    takes it.
    """

    name: str
    extensions: tuple[str, ...]
    matches: Callable[[bytes, Path], bool]
    open: Callable[..., Recording]
    options: tuple[str, ...] = ()
    forms: tuple[str, ...] = ()


_FORMATS: list[Format] = []


def register_format(fmt):
    """Adds a :class:`Format`. The newest is asked first, so text, which matches loosely, is registered first."""
    _FORMATS.insert(0, fmt)


def formats():
    """All registered formats, in the order in which they are asked."""
    return tuple(_FORMATS)


def forms():
    """All that ``form=`` may be, in the order in which the formats were registered."""
    return tuple(form for fmt in reversed(_FORMATS) for form in fmt.forms)


def open_recording(path, *, time_unit=None, sensor=None, columns=None, dataset=None, form=None):
    """Opens a recording of any registered format. The content decides which, then the extension.

    Parameters
    ----------
    path : str or Path
        The file; or a folder, where a format is one.
    time_unit : {"s", "ms", "us", "ns"}, optional
        Unit of the time stamps; by default found as ``cmfpga.events.units`` says.
    sensor : (int, int), optional
        Width and height of the sensor, px; goes before what the file says.
    columns : str or sequence of str, optional
        Names of the columns in their order, ``"x,y,t,p"``, for text without names and for N×4; others are skipped.
    dataset : str, optional
        Path inside of HDF5: a data set, or a group of them. Or a topic of a ROS bag.
    form : str, optional
        The format of a file that does not say it, one of :func:`forms`: ``"evt2"`` of words without a header, …

    Returns
    -------
    Recording

    Raises
    ------
    RecordingError
        The file is missing, unreadable, empty, of no known format, truncated, without events, or without one of
        t, x, y and p; or an argument is not allowed. One line.
    """
    path = Path(path)
    time_unit = None if time_unit is None else parse_unit(time_unit, path)
    sensor = None if sensor is None else check_sensor(sensor, path)
    given = {"dataset": dataset, "columns": None if columns is None else check_columns(columns, path)}
    given = {name: value for name, value in given.items() if value is not None}
    head = _read_head(path)
    if form is not None:
        if form not in forms():
            raise RecordingError(f"{path}: format {form!r}; {one_of(form, forms())}")
        given["form"] = form
    for fmt in _FORMATS:
        if form in fmt.forms or (form is None and fmt.matches(head, path)):
            for name in given.keys() - {*fmt.options, "form"}:
                able = ", ".join(other.name for other in _FORMATS if name in other.options)
                raise RecordingError(f"{path}: {fmt.name}; {name} can be told of {able} only")
            return fmt.open(path, time_unit=time_unit, sensor=sensor, **given)
    known = "; ".join(f"{fmt.name} ({', '.join(fmt.extensions)})" for fmt in _FORMATS)
    why = f"format not known; one of {known} is needed, or --format {', '.join(forms())} for what has no header"
    if path.is_dir():
        why = "a directory; a file is needed, a bag of ROS 2, or a folder of t.npy, xy.npy and p.npy"
    elif named := next((fmt for fmt in _FORMATS if path.suffix.lower() in fmt.extensions), None):
        cure = f"--format {', '.join(named.forms)} reads it without a header; " if named.forms else ""
        why = f"named like {named.name}, but does not begin like it: {cure}or it is damaged, or of another format than"
        why += f" {known}"
    raise RecordingError(f"{path}: {why}")


def check_sensor(sensor, where):
    """``(width, height)`` as two integers from 1 to 65536. Raises :exc:`RecordingError`, starting with ``where``."""
    try:
        width, height = (operator.index(size) for size in sensor)
    except (TypeError, ValueError):
        raise RecordingError(f"{where}: sensor {sensor!r}; (width, height) in whole pixels is needed") from None
    if not (1 <= width <= 1 << 16 and 1 <= height <= 1 << 16):
        raise RecordingError(f"{where}: sensor of {width}×{height} px; 1 to 65536 each is allowed")
    return width, height


def check_columns(columns, where):
    """The names of columns as a tuple. Raises :exc:`RecordingError`, starting with ``where``."""
    names = columns.split(",") if isinstance(columns, str) else columns
    try:
        names = tuple(name.strip().lower() for name in names)
    except (AttributeError, TypeError):
        names = ()
    if any(names.count(name) != 1 for name in "txyp"):
        raise RecordingError(f"{where}: columns {columns!r}; t, x, y and p, each once, in their order are needed")
    return names


def _read_head(path):
    try:
        if path.is_dir():
            return b""
        if path.exists() and not path.is_file():
            raise RecordingError(f"{path}: not a regular file; pipes and devices cannot be read")
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except FileNotFoundError:
        raise RecordingError(f"{path}: no such file") from None
    except RecordingError:  # which is a ValueError
        raise
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise RecordingError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if not head:
        raise RecordingError(f"{path}: the file is empty")
    return head
