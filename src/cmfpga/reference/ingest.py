"""Batches before their first iteration, the same in the integer model and the float reference."""

import functools
import operator
from typing import NamedTuple

import torch

from ..imaging.camera import undistort
from ..protocol.flags import Flag
from ..protocol.results import thins
from .integer.filters import next_thinning, thinner
from .integer.roi_filter import roi_filter


class TakenIn(NamedTuple):
    """A batch's stored events, and where the others went."""

    t: torch.Tensor  # µs since t_1, [n]
    x: torch.Tensor  # column in the ROI, raw with event_frac fraction bits, [n]
    y: torch.Tensor  # row in the ROI, the same, [n]
    counts: dict  # what is known of the batch, by the names of the fields of BatchResult
    flags: Flag = Flag(0)
    next_thinning: int | None = None  # what would have brought this batch down to its target
    phase: int = 0  # of the first event in the dither

    def enough(self, settings):
        """Whether there is something to iterate over."""
        return self.counts["roi_events"] >= max(1, settings.min_roi_events) and self.counts["span"] > 0


def to_buffer(config, events, factor):
    """One in ``factor`` of the ``events``, doubled until they fit if the buffer thins out; and what is counted."""
    found = len(events[0])
    while thins(config) and -(-found // factor) > config.buffer_events:
        factor *= 2
    kept = thinner(events, factor)
    n = min(len(kept[0]), config.buffer_events)
    counts = {"roi_events": n, "overflow": len(kept[0]) - n, "thinned": found - len(kept[0])}
    return [axis[:n] for axis in kept], counts | ({"thinning_used": factor} if thins(config) else {})


def flags_of(counts, *flags):
    """Those of ``flags`` whose count, of the same name, is not 0."""
    return functools.reduce(operator.or_, (flag for flag in flags if counts[flag.name.lower()]), Flag(0))


def take_in(config, t, x, y, settings, *, roi, last_thinning, dropped=(False, False)):
    """Undistort, crop, thin out and store a batch, all of its events in integer arrays: :class:`TakenIn`.

    ``roi`` is the ROI's corner, ``last_thinning`` the ``next_thinning`` of the batch before, or None; ``dropped`` is
    what :class:`~.integer.filters.NoiseFilter` judges.
    """
    x, y = undistort(config, settings.camera, x, y)
    inside = roi_filter(config, t, x, y, roi=roi, hot=dropped[0], noise=dropped[1])
    factor = last_thinning if settings.thin_target and last_thinning else settings.thinning
    kept, counts = to_buffer(config, inside[:3], factor)
    counts |= inside.counts
    if not len(t) and thins(config):
        counts["thinning_used"] = None
    flags = flags_of(counts, Flag.OVERFLOW, Flag.THINNED, Flag.TIME_BACK, Flag.TIME_SPAN)
    return TakenIn(*kept, counts, flags, next_thinning(len(inside.t), settings.thin_target))
