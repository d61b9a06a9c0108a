"""Models of :mod:`cmfpga.rtl.ingest.noise_filter` and :mod:`cmfpga.rtl.ingest.thinner`, in NumPy alone.

So tools can see what is dropped.
"""

import numpy as np

from ...config.widths import Widths


class NoiseFilter:
    """Which events are of hot pixels, and which are background activity; remembers each cell's youngest events."""

    def __init__(self, config):
        self.config = config
        cells = config.geometry.cell_depth if config.background else 0
        # Of each cell: the youngest event's time and pixel, the time of the youngest of another pixel; −1: none.
        self._latest, self._pixel, self._other = (np.full(cells, -1, np.int64) for _ in range(3))

    def judge(self, t, x, y, settings):
        """``(hot, noise)`` of events at sensor columns ``x`` and rows ``y``: two bool [n]; no event is both."""
        t, x, y = (np.asarray(axis).astype(np.int64) for axis in (t, x, y))
        hot, noise = np.zeros((2, len(t)), bool)
        config = self.config
        if config.hot_pixels and settings.hot_mask:
            mask = np.zeros((config.sensor_height, config.sensor_width), bool)
            columns, rows = zip(*settings.hot_mask, strict=True)
            mask[list(rows), list(columns)] = True
            hot = mask[y, x]
        if config.background and not hot.all():
            kept = ~hot
            age = self._ages(t[kept], x[kept], y[kept])
            if settings.background_us:
                noise[kept] = (age < 0) | (age > settings.background_us)
        return hot, noise

    def _ages(self, t, x, y):
        """How long ago another pixel of each event's cell had its youngest, modulo the stamps' width; −1: never."""
        config = self.config
        wrap, bits = (1 << config.span_bits) - 1, config.background_cell
        t = t & wrap
        cell = (y >> bits) << config.geometry.cell_column_bits | x >> bits
        inside = (1 << bits) - 1
        pixel = (y & inside) << bits | x & inside
        # What each cell remembers goes before its events: one of "another" pixel, then the youngest.
        touched = np.unique(cell)
        cells = np.concatenate([touched, touched, cell])
        order = np.argsort(cells, kind="stable")
        cells = cells[order]
        times = np.concatenate([self._other[touched], self._latest[touched], t])[order]
        pixels = np.concatenate([np.full(len(touched), -2), self._pixel[touched], pixel])[order]
        # Runs of one pixel in a cell: the youngest of another pixel is the last event of the run before.
        starts = np.ones(len(cells), bool)
        starts[1:] = (np.diff(cells) != 0) | (np.diff(pixels) != 0)
        before = np.maximum.accumulate(np.where(starts, np.arange(len(cells)), 0)) - 1
        other = np.where((before >= 0) & (cells[before] == cells), times[before], -1)
        last = np.flatnonzero(np.append(np.diff(cells) != 0, True))
        self._latest[touched], self._pixel[touched], self._other[touched] = times[last], pixels[last], other[last]
        ages = np.empty(len(cells), np.int64)
        ages[order] = np.where(other < 0, -1, (times - other) & wrap)
        return ages[2 * len(touched) :]


def next_thinning(count, target):
    """The factor that would have brought ``count`` events down to ``target``, at least 1; None without a target."""
    return min(Widths.thinning_max, max(1, -(-count // target))) if target else None


def thinner(events, factor):
    """The first of every ``factor`` events: a slice of each of ``events``, tensors of one length."""
    return tuple(axis[::factor] for axis in events)
