"""The true motion of a recording's object, where it is known; and values over time, with their means over windows.

The motion stands in one of two places; the first that exists is taken:

- ``RECORDING.truth.csv`` beside the recording (``rec.h5.truth.csv`` beside ``rec.h5``), with the columns ``t_us``,
  ``vx_px_per_s`` and ``vy_px_per_s``: from this time on, on the recording's clock, the object moves so fast;
- the group ``/ground_truth/motion`` of an HDF5 recording, with ``t`` (µs), ``velocity`` (N×2, px/s) and, optionally,
  ``start``, the place of the object's centre (px) at the first of the times. Synthetic recordings have it.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from ..errors import RecordingError
from ..events import Motion
from ..forms import Array, FormError


class Signal:
    """Values [n, k] over times [n], µs, ascending: straight lines between samples.

    Or, with ``end``, each value holds until the next time, the last one until ``end``, µs. ``first`` and ``last`` are
    the range of time that is covered, µs.
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
        """Means from ``t0`` to a later ``t1``, µs, float64 [N, k]. Outside of its range the last piece goes on."""
        span = np.asarray(t1 - t0, np.float64)
        whole = self._integral(t1) - self._integral(t0)
        return whole / np.maximum(span, 1e-9)[:, None]

    def _integral(self, t):
        piece = np.clip(np.searchsorted(self._times, t, side="right") - 1, 0, None)
        since = np.asarray(t - self._times[piece])[:, None]
        return self._sums[piece] + (self._values[piece] + self._slopes[piece] * since / 2) * since


COLUMNS = ("t_us", "vx_px_per_s", "vy_px_per_s")
GROUP = "ground_truth/motion"

#: A recording's motion has no more.
MOST_PIECES = 1_000_000

_FORMS = {"t": Array("iuf", ("N",)), "velocity": Array("iuf", ("N", 2)), "start": Array("iuf", (2,))}


@dataclass(frozen=True)
class Truth:
    """A known motion, constant piece by piece."""

    source: str  # "sidecar" or "recording"
    times: tuple  # begin of each piece, µs, ascending
    velocities: tuple  # (vx, vy) of each piece, px/s
    start: tuple | None = None  # place of the object's centre at the first of the times, px

    @property
    def motion(self):
        """As :class:`~cmfpga.events.Motion`."""
        return Motion(self.times, self.velocities, self.start or (0.0, 0.0))


def sidecar(path):
    """Where the truth of the recording at ``path`` is looked for."""
    return Path(f"{path}.truth.csv")


def read_truth(path):
    """The :class:`Truth` of the recording at ``path``, or None. Raises :exc:`RecordingError` for a malformed one."""
    beside = sidecar(path)
    if beside.is_file():
        return read_truth_csv(beside)
    if not h5py.is_hdf5(path):
        return None
    where = f"{path}: {GROUP}"
    try:
        with h5py.File(path, "r") as file:
            group = file.get(GROUP)
            if not isinstance(group, h5py.Group):
                return None
            lengths = {}
            for name, form in _FORMS.items():
                if name in group or name != "start":
                    form.head(group[name], name, lengths)
            if lengths["N"] > MOST_PIECES:
                raise FormError(f"more than {MOST_PIECES} pieces")
            times, velocities = group["t"][()], group["velocity"][()]
            start = group["start"][()] if "start" in group else None
    except (OSError, LookupError, RuntimeError, TypeError, AttributeError, FormError) as error:
        raise RecordingError(f"{where}: not readable: {str(error).splitlines()[0]}") from None
    return _checked(where, "recording", times, velocities, start)


def read_truth_csv(path):
    """The :class:`Truth` of a sidecar, wherever it stands. Raises :exc:`RecordingError` for a malformed one."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = csv.DictReader(file)
            if not set(COLUMNS) <= set(rows.fieldnames or ()):
                raise RecordingError(f"{path}: the columns {', '.join(COLUMNS)} are needed")
            values = [[row[name] for name in COLUMNS] for row in rows]
    except (OSError, UnicodeError, csv.Error) as error:
        raise RecordingError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    table = np.empty((len(values), 3))
    for k, row in enumerate(values):
        try:
            table[k] = [float(text) for text in row]
        except (TypeError, ValueError):
            raise RecordingError(f"{path}, line {k + 2}: three numbers are needed") from None
    return _checked(path, "sidecar", table[:, 0], table[:, 1:])


def _checked(where, source, times, velocities, start=None):
    times, velocities = np.asarray(times, float), np.asarray(velocities, float)
    if not len(times):
        raise RecordingError(f"{where}: one time, and vx and vy, are needed for each piece")
    if not (np.isfinite(times).all() and np.isfinite(velocities).all()) or (np.diff(times) <= 0).any():
        raise RecordingError(f"{where}: finite numbers, and times that ascend, are needed")
    if start is not None and not np.isfinite(start).all():
        raise RecordingError(f"{where}: start: x and y are needed")
    pieces = tuple(int(t) for t in times.round()), tuple(map(tuple, velocities.tolist()))
    return Truth(source, *pieces, None if start is None else tuple(map(float, start)))
