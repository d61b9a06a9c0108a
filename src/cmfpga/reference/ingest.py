"""What happens to a batch before its first iteration, the same in the integer model and the float reference."""

from dataclasses import dataclass

import torch

from ..imaging.camera import undistort
from ..protocol.flags import Flag
from ..protocol.results import thins
from .integer.filters import next_thinning, thinner
from .integer.roi_filter import roi_filter


@dataclass(frozen=True)
class TakenIn:
    """A batch's stored events, and where the others went."""

    t: torch.Tensor  # µs since t_1, [n]
    x: torch.Tensor  # column in the ROI, raw with event_frac fraction bits, [n]
    y: torch.Tensor  # row in the ROI, the same, [n]
    counts: dict  # what is known of the batch, by the names of the fields of BatchResult
    flags: Flag
    next_thinning: int | None  # what would have brought this batch down to its target
    phase: int = 0  # of the first event in the dither

    def enough(self, settings):
        """Whether there is something to iterate over."""
        return self.counts["roi_events"] >= max(1, settings.min_roi_events) and self.counts["span"] > 0


def thinned_to_room(config, found, factor):
    """``factor``, or a larger one by which ``found`` events fit into a buffer that thins out."""
    while thins(config) and -(-found // factor) > config.buffer_events:
        factor *= 2
    return factor


def take_in(config, t, x, y, settings, *, roi, last_thinning, dropped=(False, False)):
    """Undistort, crop, thin out and store a batch: :class:`TakenIn`.

    Parameters
    ----------
    t, x, y : integer arrays
        All events of the batch.
    settings : BatchSettings
    roi : pair of int
        The ROI's corner.
    last_thinning : int or None
        ``next_thinning`` of the batch before.
    dropped : pair of bool arrays
        As :class:`~.integer.filters.NoiseFilter` judges the events.
    """
    x, y = undistort(config, settings.camera, x, y)
    inside = roi_filter(config, t, x, y, roi=roi, hot=dropped[0], noise=dropped[1])
    found = len(inside.t)
    factor = last_thinning if settings.thin_target and last_thinning else settings.thinning
    factor = thinned_to_room(config, found, factor)
    kept = thinner((inside.t, inside.x, inside.y), factor)
    used = {"thinning_used": factor if len(t) else None} if thins(config) else {}
    n = min(len(kept[0]), config.buffer_events)
    counts = {
        "t_first": int(t[0]) & ((1 << config.time_bits) - 1) if len(t) else None,
        "events": inside.events,
        "roi_events": n,
        "outside": inside.outside,
        "overflow": len(kept[0]) - n,
        "thinned": found - len(kept[0]),
        "time_back": inside.time_back,
        "time_span": inside.time_span,
        "hot": inside.hot,
        "noise": inside.noise,
        "span": inside.span,
        **used,
    }
    flags = Flag(0)
    for flag in (Flag.OVERFLOW, Flag.THINNED, Flag.TIME_BACK, Flag.TIME_SPAN):
        flags |= flag if counts[flag.name.lower()] else Flag(0)
    stored = (axis[:n] for axis in kept)
    return TakenIn(*stored, counts, flags, next_thinning(found, settings.thin_target))
