"""The one in-memory form of events, what they are checked for, and what gives them."""

from collections.abc import Iterator
from dataclasses import InitVar, dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from ..errors import RecordingError
from .units import TIME_UNITS, parse_unit, refuse, to_us

# Columns and rows are uint16 in memory.
_LARGEST_COORDINATE = (1 << 16) - 1
# Polarities: contrast does not use them, so odd ones are taken. What goes beyond is another column. The last is -1 of
# an unsigned byte.
_CODES = (*range(-1, 16), 255)


class EventChecker:
    """Turns the chunks of one recording, in order, into columns of :class:`Events`; refuses what cannot be used.

    ``where`` begins every message: the file, and what the columns are if that needs to be said. Without the sensor's
    size, px, coordinates are only held to 0 … 65535. Polarities up to ``highest_off`` mean darker.
    """

    def __init__(self, where, width=None, height=None, first_event=0, highest_off=0):
        self.where, self.width, self.height = where, width, height
        self.next_event, self._last_t, self._off = first_event, None, highest_off

    def __call__(self, t, x, y, p):
        """``(t, x, y, p)`` of the next chunk, t int64, µs; :exc:`RecordingError` where the time falls."""
        before = np.concatenate([t[:1] if self._last_t is None else [self._last_t], t[:-1]])
        never = "of the event before; it must never decrease"
        self._refuse("time stamp", t < before, lambda k: f"{t[k]} µs, after {before[k]} µs {never}")
        x, y, p = self.coordinate("x", x, self.width), self.coordinate("y", y, self.height), self.polarity(p)
        self.next_event += len(t)
        self._last_t = int(t[-1]) if len(t) else self._last_t
        return t, x, y, p

    def _refuse(self, name, bad, say):
        refuse(bad, lambda k: f"{self.where}: {name} of event {self.next_event + k} is {say(k)}")

    def coordinate(self, name, values, size=None):
        """Column ``name``, x or y, as uint16; ``size`` is that of the sensor, px."""
        if values.dtype.kind == "f":
            odd = ~(values == np.floor(values))  # NaN too
            self._refuse(name, odd, lambda k: f"{values[k]}; a whole number of pixels is needed")
        largest = _LARGEST_COORDINATE if size is None else size - 1
        if len(values) and (values.min() < 0 or values.max() > largest):  # faster than a mask of each chunk
            sensor = "" if size is None else f" on a sensor of {self.width}×{self.height} px"
            outside = (values < 0) | (values > largest)
            self._refuse(name, outside, lambda k: f"{values[k]:.0f}; 0 to {largest} is allowed{sensor}")
        return values.astype(np.uint16)

    def polarity(self, values):
        """Polarities as uint8, 0 and 1."""
        if values.dtype.kind == "b":
            return values.astype(np.uint8)
        bad, usual = ~np.isin(values, _CODES), "0 and 1, or -1 and 1, are usual; 2 to 15 and 255 go"
        self._refuse("polarity", bad, lambda k: f"{values[k]}; {usual}")
        return ((values > self._off) & (values < _CODES[-1])).astype(np.uint8)


def highest_off(p):
    """The highest code of polarity that means darker, of the first codes: 1 of MATLAB's 1 and 2; otherwise 0."""
    return int(set(np.unique(p).tolist()) == {1, 2})


def polarity_notes(p):
    """Notes of unusual codes among the first polarities, as they stand in a file."""
    codes, counts = np.unique(p, return_counts=True)
    told = set(codes.tolist())
    if told <= {0, 1} or told <= {-1, 1} or not told <= {*_CODES}:  # the checks report others
        return []
    found = ", ".join(f"{code:g} ({count:,})" for code, count in zip(codes, counts, strict=True))
    beyond = f", but for {_CODES[-1]}," if codes[-1] == _CODES[-1] else ""
    return [
        f"polarities of the first {len(p):,} events: {found}; those above {highest_off(p)}{beyond} are taken as "
        "brighter (contrast needs none)"
    ]


@dataclass(frozen=True)
class Events:
    """Events as four arrays of one length, in order of time; :exc:`RecordingError` says what cannot be used.

    Parameters
    ----------
    t : array
        Time stamps, never decreasing: whole numbers of µs, or ``timedelta64`` or ``datetime64``, or any real numbers
        with ``time_unit``. Kept as int64 in µs, rounded to the nearest.
    x, y : arrays of whole numbers
        Column (0 = left) and row (0 = top), 0 to 65535. Kept as uint16.
    p : array
        Polarity: True and False, 1 and 0, or 1 and -1; 1 = brighter. Of 1 and 2, as MATLAB has them, 2 is. 3 to 15
        are brighter, too, and 255, an unsigned -1, is darker. Kept as uint8, 1 = brighter, 0 = darker.
    time_unit : {"s", "ms", "us", "ns"}, optional
        Of ``t``.
    """

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    p: np.ndarray
    time_unit: InitVar[str | None] = field(default=None, kw_only=True)

    def __post_init__(self, time_unit):
        arrays = {name: self._array(name) for name in "txyp"}
        if len({len(array) for array in arrays.values()}) > 1:
            raise RecordingError("Events: t, x, y and p must have one length")
        arrays["t"] = _microseconds(arrays["t"], time_unit)
        check = EventChecker("Events", highest_off=highest_off(arrays["p"]))
        for name in "xy":
            if arrays[name].dtype != np.uint16:
                arrays[name] = check.coordinate(name, arrays[name])
        if arrays["p"].dtype != np.uint8 or arrays["p"].max(initial=0) > 1:
            arrays["p"] = check.polarity(arrays["p"])
        for name, array in arrays.items():
            object.__setattr__(self, name, np.ascontiguousarray(array))

    def _array(self, name):
        array = np.asarray(getattr(self, name))
        if array.ndim != 1:
            raise RecordingError(f"Events: {name} has {array.ndim} dimensions; 1 is needed")
        if array.dtype.kind not in ("iufmM" if name == "t" else "biuf"):
            raise RecordingError(f"Events: {name} holds {array.dtype}; real numbers are needed")
        return array

    def __len__(self):
        return len(self.t)

    def __getitem__(self, index):
        """The events of a slice (or of a boolean or integer index array)."""
        return Events(self.t[index], self.x[index], self.y[index], self.p[index])

    @classmethod
    def empty(cls):
        """No events."""
        return cls(*(np.zeros(0),) * 4)

    @classmethod
    def concatenate(cls, parts):
        """All events of ``parts``, an iterable of :class:`Events`, one after the other."""
        parts = list(parts) or [cls.empty()]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in "txyp"))

    @classmethod
    def merge(cls, parts):
        """All events of ``parts`` in order of time; of one time, those of an earlier part come first."""
        together = cls.concatenate(parts)
        return together[np.argsort(together.t, kind="stable")]


def _microseconds(t, unit):
    """``t`` as int64 µs; ``unit`` as named by the caller, or None."""
    if unit is not None:
        unit = parse_unit(unit, "Events")
    if t.dtype.kind in "mM":
        own, steps = np.datetime_data(t.dtype)
        if own not in TIME_UNITS or steps != 1 or unit not in (None, own):
            raise RecordingError(f"Events: t holds {t.dtype}; the unit {unit or ', '.join(TIME_UNITS)} is needed")
        refuse(np.isnat(t), lambda k: f"Events: time stamp of event {k} is NaT; a time is needed")
        return to_us(t.astype(np.int64), own, "Events")
    if t.dtype == np.int64 and unit is None:
        return t
    if t.dtype.kind == "f" and unit is None and len(t):
        cure = f"time_unit = {', '.join(TIME_UNITS)} says which"
        raise RecordingError(f"Events: t holds {t.dtype}, of no known unit; {cure}")
    return to_us(t, unit or "us", "Events")


@runtime_checkable
class EventSource(Protocol):
    """Events in order of time. A :class:`~cmfpga.events.Recording` is one; another needs no base class.

    ``name`` is for people; ``width`` and ``height`` are those of the sensor, px, None where they are not known. Of a
    ``seekable`` one :meth:`chunks` may be called more than once, and gives the same events again. What comes live is
    not seekable: it can be tracked, but no batch of it can be traced afterwards.
    """

    name: str
    width: int | None
    height: int | None
    seekable: bool

    def chunks(self, start: int, size: int) -> Iterator[Events]:
        """Iterator of :class:`Events` from event ``start`` (from 0) to the end, at most ``size`` at a time.

        None in their place says that no more are there yet: a track then yields None, and goes on when it is asked
        again.
        """
