"""Recordings whose t, x, y and p can be sliced: data sets, NumPy arrays, events in memory."""

import contextlib
import re

import numpy as np

from ..errors import RecordingError
from .arrays import Events, highest_off
from .recording import Recording, check_sensor
from .units import SAMPLE_EVENTS, guess_unit, refuse, to_us

_MIN_EVENTS = 10  # by which an order of columns is told

# Names under which the four columns are found, in data sets, archives and structured arrays.
NAMES = {
    "t": ("t", "ts", "timestamp", "timestamps", "time", "times"),
    "x": ("x", "xs", "col", "column"),
    "y": ("y", "ys", "row"),
    "p": ("p", "ps", "polarity", "polarities", "pol", "on"),
}


def match_names(names):
    """``{"t": …, "x": …, "y": …, "p": …}``: which of ``names`` is which column; columns not found are left out."""
    names = set(names)
    there = ((column, [alias for alias in aliases if alias in names]) for column, aliases in NAMES.items())
    return {column: aliases[0] for column, aliases in there if aliases}


def require_names(names, where):
    """As :func:`match_names`, but all four are needed. Raises :exc:`RecordingError`, starting with ``where``."""
    found = match_names(names)
    if missing := [column for column in NAMES if column not in found]:
        cure = "; ".join(f"{column} may be named {', '.join(NAMES[column])}" for column in missing)
        raise RecordingError(f"{where}: {' and '.join(missing)} missing; {cure}")
    return found


def guess_order(table):
    """Names of the four columns of the first events, numbers without names: t, x, y, p unless that cannot be.

    t is a column that never falls, p one of at most two codes; x stands before y. Another order than t, x, y, p is
    taken where it is x, y, p, t, as Metavision writes it, or x, y, t, p, or the only one. Then t also has to rise: a
    column of one value is no time. A few events tell nothing.
    """
    rising = [k for k in range(4) if (table[1:, k] >= table[:-1, k]).all() and (k == 0 or table[-1, k] > table[0, k])]
    found = [set(np.unique(table[:, k]).tolist()) for k in range(4)]
    codes = [k for k in range(4) if len(found[k]) <= 2 and found[k] <= {-1, 0, 1, 2, 255}]
    fits = [(t, p) for t in rising for p in codes if t != p] * (len(table) >= _MIN_EVENTS)
    usual = [fit for fit in ((0, 3), (3, 2), (2, 3)) if fit in fits]
    t, p = usual[0] if usual else fits[0] if len(fits) == 1 else (0, 3)
    rest = iter("xy")
    return tuple("t" if k == t else "p" if k == p else next(rest) for k in range(4))


def order_notes(order, guessed):
    """Texts about columns without names: for messages about events, and notes where another order is taken."""
    layout = f" (columns {', '.join(order)}{'; --columns (columns=) gives another order' * guessed})"
    odd = guessed and order != (*NAMES,)
    return layout, [f"columns taken as {','.join(order)}, as their values are; --columns gives another order"] * odd


def as_events(data, time_unit=None):
    """:class:`Events` of whatever holds them in memory.

    Raises :exc:`RecordingError`, in one line, where it is nothing of that kind, or holds what :class:`Events` refuse.

    Parameters
    ----------
    data : Events, tuple, mapping or array
        A tuple (t, x, y, p) of arrays; a structured array, a dictionary or a pandas ``DataFrame`` with columns named as
        in :data:`NAMES` (so those of tonic, Metavision, expelliarmus, faery and dv-processing); or N×4 with columns
        t, x, y, p, of which whole numbers of t are µs even where they are floats.
    time_unit : {"s", "ms", "us", "ns"}, optional
        Of t; whole numbers are µs by default.
    """
    if isinstance(data, Events):
        return data if time_unit is None else Events(data.t, data.x, data.y, data.p, time_unit=time_unit)
    if isinstance(data, tuple) and len(data) == len(NAMES):
        return Events(*data, time_unit=time_unit)
    table = None
    names = getattr(getattr(data, "dtype", None), "names", None) or (hasattr(data, "keys") and list(data.keys()))
    if names:
        found = require_names(names, "events")
        return Events(*(data[found[column]] for column in NAMES), time_unit=time_unit)
    with contextlib.suppress(ValueError, TypeError):  # lists of other lengths
        table = np.asarray(data)
    if table is not None and table.ndim == 2 and table.shape[1] == len(NAMES):
        t = table[:, 0]
        if table.dtype.kind == "f" and time_unit is None and not np.any(t[np.isfinite(t)] % 1):
            time_unit = "us"  # whole numbers, which are floats for another column's sake
        events = Events(*table.T, time_unit=time_unit)
        needed = "0 and 1, -1 and 1, or 1 and 2 are needed in the last column of N×4"
        odd = np.isin(table[:, 3], range(3, 16))  # codes that files have; here another column is more likely
        refuse(odd, lambda k: f"events: polarity of event {k} is {table[k, 3]}; {needed}")
        return events
    shape = getattr(data, "shape", ())
    found = f"{type(data).__name__}{' of ' * bool(shape)}{'×'.join(map(str, shape))}"
    raise RecordingError(f"events: {found}; (t, x, y, p), a structured array, or N×4 with columns t, x, y, p is needed")


class Columns:
    """The four columns of events, read by slices.

    ``source`` is ``{"t": array, "x": …, "y": …, "p": …}`` of one-dimensional arrays; or one structured array; or one
    array of N×4. An array is anything with ``shape``, ``dtype`` and slicing. ``order`` names the columns of N×4, by
    default t, x, y, p; other names are not read. ``close`` releases what reading has opened.

    Raises :exc:`RecordingError`, starting with ``where``, for other shapes, lengths that differ, no numbers, no events;
    and where an order is given though the columns have names.
    """

    def __init__(self, source, where, order=None, close=lambda: None):
        self.close, self._source = close, source
        by_name = isinstance(source, dict)
        fields = not by_name and source.dtype.names
        named = bool(by_name or fields)
        if order and named:
            raise RecordingError(f"{where}: columns {','.join(order)}: they have names of their own")
        #: Whether the order is neither told nor in names; what messages add to the name.
        self.assumed = not (order or named)
        order = order or (*NAMES,)
        self.layout = "" if named else order_notes(order, False)[0]
        wrong = None
        if by_name:
            shapes = {name: source[name].shape for name in NAMES}
            shape, dtypes = shapes["t"], {name: array.dtype for name, array in source.items()}
            if len(shape) != 1 or set(shapes.values()) != {shape}:
                sizes = ", ".join(f"{name}: {'×'.join(map(str, size)) or 'scalar'}" for name, size in shapes.items())
                wrong = f"sizes ({sizes}) differ or are not one-dimensional; one length is needed"
        elif fields:
            self._keys, shape = require_names(fields, where), source.shape
            dtypes = {name: source.dtype[field] for name, field in self._keys.items()}
            if len(shape) != 1:
                wrong = f"structured array of {len(shape)} dimensions; 1 is needed"
        else:
            self._keys = {name: (slice(None), order.index(name)) for name in NAMES}
            shape, dtypes = source.shape, dict.fromkeys(NAMES, source.dtype)
            if len(shape) != 2 or shape[1] != len(order):
                size = "×".join(map(str, shape)) or "a single value"
                wrong = f"array of {size}; N×{len(order)} with columns {', '.join(order)} is needed"
        if wrong:
            raise RecordingError(f"{where}: {wrong}")
        for name, dtype in dtypes.items():
            if dtype.kind not in ("iuf" if name == "t" else "biuf"):
                raise RecordingError(f"{where}: {name} holds {dtype}; real numbers are needed")
        if not shape[0]:
            raise RecordingError(f"{where}: no events")
        self._length = shape[0]

    def __len__(self):
        return self._length

    def read(self, start, stop):
        """Columns t, x, y, p of events ``start`` to ``stop`` as NumPy arrays, as stored."""
        if isinstance(self._source, dict):
            return [self._source[name][start:stop] for name in NAMES]
        table = self._source[start:stop]
        return [table[self._keys[name]] for name in NAMES]


class ColumnsRecording(Recording):
    """A recording over :class:`Columns`.

    ``columns()`` gives fresh ones: each iteration has its own, so that streams can be read side by side. ``time_unit``
    is as the caller gives it, ``file_unit`` as the file says; ``t_offset``, in that unit, is added to all time stamps.
    ``read_errors`` are what reading damaged content raises.
    """

    _file = None  # what close() closes

    def __init__(
        self, columns, *, path, format, sensor, name=None, time_unit=None, file_unit=None, t_offset=None,
        read_errors=(),
    ):  # fmt: skip
        self._open_columns, self._read_errors = columns, read_errors
        first, name, unit = columns(), name or str(path), time_unit or file_unit
        self._at = range(4)
        super().__init__(
            path=path, name=name, format=format, sensor=sensor, num_events=len(first), time_unit=unit,
            time_unit_source="given" if time_unit else "file" if file_unit else "assumed",
        )  # fmt: skip
        self._layout = first.layout
        with contextlib.closing(first):
            sample = self._read(first, 0, min(len(first), SAMPLE_EVENTS))
        if first.assumed:
            order = guess_order(np.stack(sample, axis=1))
            self._layout, self._order_notes = order_notes(order, True)
            self._at = [order.index(name) for name in NAMES]
        self._highest_off = highest_off(sample[self._at[3]])
        if unit is None:
            self.time_unit = guess_unit(sample[self._at[0]])
        self._offset_us = 0 if t_offset is None else int(to_us(t_offset, self.time_unit, f"{name}: t_offset")[0])

    def close(self):
        super().close()
        self._open_columns = None  # a mapped file stays open for as long as there is an array of it
        if self._file is not None:
            self._file.close()

    def _read(self, columns, start, stop):
        self._require_open()
        try:
            found = columns.read(start, stop)
            return [found[k] for k in self._at]
        except self._read_errors as error:
            events = f"events {start} to {stop - 1}"
            raise RecordingError(f"{self.name}: {events} cannot be read {why(error)}") from None

    def _columns(self, start, size):
        with contextlib.closing(self._open_columns()) as columns:
            for first in range(start, len(columns), size):
                t, x, y, p = self._read(columns, first, min(first + size, len(columns)))
                yield to_us(t, self.time_unit, self.where, first) + self._offset_us, x, y, p


class MemoryRecording(ColumnsRecording):
    """Events in memory, at least one, as a recording; ``width`` and ``height`` of the sensor are px."""

    def __init__(self, events, width, height, name="events in memory"):
        columns = Columns({key: getattr(events, key) for key in NAMES}, name)
        sensor = check_sensor((width, height), name)
        super().__init__(lambda: columns, path=None, name=name, format="memory", sensor=sensor, file_unit="us")


def one_line(error):
    """The text of a library's exception on one line."""
    return " ".join(str(error).split()) or type(error).__name__


# What a library says of a file that is not damaged: a part of its text, what that means, and what helps.
_WHOLE = (
    ("encrypted", "encrypted", "a copy without a password is needed"),
    ("compression method", "compressed by an unknown method", "numpy.savez_compressed, or zip by deflate, is needed"),
    ("Python objects|No NumPy equivalent|unsupported type", "of an unsupported type", "numbers t, x, y, p are needed"),
    (r"superblock version|unknown version|has version|expected 2\.x", "of an unknown version",
     "a newer release of the package that reads it, or a copy in another format, is needed"),
    ("storage format", "of another extension", ".mcap or .db3 is needed"),
    ("Profile is not ros2|Bag version", "of another kind", "a copy by 'ros2 bag convert' is needed"),
    ("not indexed", "closed without its index", "'rosbag reindex' makes it"),
    ("lock file", "in use", "close the program that writes it, or take a copy"),
    ("external raw data|can't open file", "incomplete", "it refers to another file, which is needed beside it"),
)  # fmt: skip


def why(error):
    """Meaning of a library's exception for a file, for people: ``(truncated or damaged): …``, or another reason."""
    text = one_line(error)
    found = ((meaning, f"; {cure}") for part, meaning, cure in _WHOLE if re.search(part, text))
    meaning, cure = next(found, ("truncated or damaged", ""))
    return f"({meaning}): {text}{cure}"


@contextlib.contextmanager
def readable(what, errors):
    """Turns a library's ``errors`` into a :exc:`RecordingError` that begins with ``what``, and says :func:`why`."""
    try:
        yield
    except RecordingError:  # which is a ValueError
        raise
    except errors as error:
        raise RecordingError(f"{what} {why(error)}") from None
