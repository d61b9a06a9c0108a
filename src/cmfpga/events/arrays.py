"""The one in-memory form of events."""

from dataclasses import InitVar, dataclass, field

import numpy as np

from ..errors import RecordingError
from .checks import EventChecker, highest_off
from .units import TIME_UNITS, parse_unit, to_us


@dataclass(frozen=True)
class Events:
    """Events as four arrays of one length, in order of time.

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

    Raises
    ------
    RecordingError
        An array cannot be used, or the lengths differ; one line.
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
        parts = list(parts)
        if not parts:
            return cls.empty()
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
        bad = np.isnat(t)
        if bad.any():
            raise RecordingError(f"Events: time stamp of event {bad.argmax()} is NaT; a time is needed")
        return to_us(t.astype(np.int64), own, "Events")
    if t.dtype == np.int64 and unit is None:
        return t
    if t.dtype.kind == "f" and unit is None and len(t):
        raise RecordingError(
            f"Events: t holds {t.dtype}, of no known unit; time_unit = {', '.join(TIME_UNITS)} says which"
        )
    return to_us(t, unit or "us", "Events")
