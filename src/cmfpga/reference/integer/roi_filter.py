"""Model of :mod:`cmfpga.rtl.ingest.roi_filter`."""

from typing import NamedTuple

import numpy as np
import torch

from ...fixed import round_half_up


class Filtered(NamedTuple):
    """ROI events, relative to the batch's first event and the ROI's origin, and the count of every other."""

    t: torch.Tensor  # µs since the batch's first event
    x: torch.Tensor  # column in the ROI, event_frac
    y: torch.Tensor  # row in the ROI, event_frac
    counts: dict  # what is known of the batch, by the names of the fields of BatchResult


def inside(config, x, y, corner, size):
    """Whether the pixels nearest to raw positions are among ``size`` columns and rows from ``corner`` on: bool [n]."""
    column, row = (round_half_up(axis, config.formats.event_frac) - at for axis, at in zip((x, y), corner, strict=True))
    return (column >= 0) & (column < size[0]) & (row >= 0) & (row < size[1])


def roi_filter(config, t, x, y, *, roi, size=None, hot=False, noise=False):
    """Events of a batch that lie in the ROI, of the corner ``roi`` and ``size`` (by default the configuration's), px.

    ``t``, ``x``, ``y`` are integer arrays of one length: time stamps in µs (only their ``time_bits`` low bits count);
    columns and rows, raw, as of :func:`cmfpga.imaging.camera.undistort`. The nearest pixel tells whether an event is in
    the ROI. Those that are ``hot`` or ``noise``, as :class:`~.filters.NoiseFilter` judges them, are dropped.
    """
    t, x, y = (np.asarray(a, np.int64) for a in (t, x, y))
    if not len(t):
        none = torch.zeros(0, dtype=torch.int64)
        names = ("events", "outside", "time_back", "time_span", "hot", "noise", "span")
        return Filtered(none, none, none, {"t_first": None} | dict.fromkeys(names, 0))
    wrap, half = 1 << config.time_bits, 1 << (config.time_bits - 1)
    since_first = (t - t[0] + half) % wrap - half
    back, late, span = _time_errors(config, since_first)
    x, y = (axis - (at << config.formats.event_frac) for axis, at in zip((x, y), roi, strict=True))
    here = inside(config, x, y, (0, 0), size or (config.roi_width, config.roi_height))
    timely = ~(back | late)
    hot, noise = (timely & mask for mask in (hot, noise))
    good = timely & ~(hot | noise)
    stored = good & here
    masks = {"outside": good & ~here, "time_back": back, "time_span": late, "hot": hot, "noise": noise & ~hot}
    counts = {name: int(mask.sum()) for name, mask in masks.items()}
    counts |= {"t_first": int(t[0]) % wrap, "events": len(t), "span": span}
    return Filtered(*(torch.from_numpy(a[stored]) for a in (since_first, x, y)), counts)


def _time_errors(config, since_first):
    """Masks of the events that step back and of those beyond the span; time of the last good event."""
    late = since_first >= 1 << config.span_bits
    back = np.zeros(len(since_first), bool)
    if (np.diff(since_first) < 0).any():
        latest = 0
        for k, time in enumerate(since_first.tolist()):
            back[k] = time < latest
            if not (back[k] or late[k]):
                latest = time
    late &= ~back
    good = since_first[~(back | late)]
    return back, late, int(good[-1])
