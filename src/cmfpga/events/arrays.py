"""The one in-memory form of events."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Events:
    """Events as four arrays of one length, in order of time.

    Parameters
    ----------
    t : int64 array
        Time stamps in µs, never decreasing.
    x, y : uint16 arrays
        Column (0 = left) and row (0 = top).
    p : uint8 array
        Polarity, 1 = brighter, 0 = darker.
    """

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    p: np.ndarray

    def __post_init__(self):
        for name, dtype in (("t", np.int64), ("x", np.uint16), ("y", np.uint16), ("p", np.uint8)):
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), dtype))
        if not len(self.t) == len(self.x) == len(self.y) == len(self.p):
            raise ValueError("t, x, y and p must have one length")

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
