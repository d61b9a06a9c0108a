"""Values over time, and their means over windows."""

import numpy as np


class Signal:
    """Values over time: straight lines between samples; or, with ``end``, each holds until the next time.

    Parameters
    ----------
    times : float64 [n]
        µs, ascending.
    values : float64 [n, k]
    end : float, optional
        Until when the last value holds, µs.

    Attributes
    ----------
    first, last : float
        The range of time that it covers, µs.
    """

    def __init__(self, times, values, end=None):
        times, values = np.asarray(times, np.float64), np.asarray(values, np.float64)
        self.first, self.last = float(times[0]), float(times[-1] if end is None else end)
        lengths = np.diff(times)[:, None]
        if end is None:
            self._slopes, means = np.diff(values, axis=0) / lengths, (values[1:] + values[:-1]) / 2
            times, values = times[:-1], values[:-1]
        else:
            self._slopes, means = np.zeros_like(values), values[:-1]
        sums = np.cumsum(means * lengths, axis=0)[: len(values) - 1]
        self._times, self._values = times, values
        self._sums = np.concatenate([np.zeros_like(values[:1]), sums])

    def covers(self, t0, t1):
        """Whether it is known from ``t0`` to ``t1``, µs: bool [N]."""
        return (t0 >= self.first) & (t1 <= self.last)

    def mean(self, t0, t1):
        """Means from ``t0`` to a later ``t1``, µs, float64 [N, k].

        Outside of its range the last piece goes on.
        """
        span = np.asarray(t1 - t0, np.float64)
        whole = self._integral(t1) - self._integral(t0)
        return whole / np.maximum(span, 1e-9)[:, None]

    def _integral(self, t):
        piece = np.clip(np.searchsorted(self._times, t, side="right") - 1, 0, None)
        since = np.asarray(t - self._times[piece])[:, None]
        return self._sums[piece] + (self._values[piece] + self._slopes[piece] * since / 2) * since
