"""Model of :mod:`cmfpga.rtl.ingest.roi_filter`."""

from dataclasses import dataclass

import numpy as np
import torch


@dataclass(frozen=True)
class Filtered:
    """ROI events, relative to the batch's first event and the ROI's origin, and the count of every other."""

    t: torch.Tensor  # µs since the batch's first event
    x: torch.Tensor  # column in the ROI, event_frac
    y: torch.Tensor  # row in the ROI, event_frac
    events: int
    outside: int
    time_back: int
    time_span: int
    hot: int
    noise: int
    span: int  # t_N − t_1, µs


def roi_filter(config, t, x, y, *, roi, size=None, hot=False, noise=False):
    """Events of a batch that lie in the ROI.

    Parameters
    ----------
    t, x, y : integer arrays, one length
        Time stamps in µs (only their ``time_bits`` low bits count); columns and rows, raw with ``event_frac`` fraction
        bits, as of :func:`cmfpga.imaging.camera.undistort`. The nearest pixel tells whether an event is in the ROI.
    roi : pair of int
        Left column and top row of the ROI.
    size : pair of int, optional
        Its columns and rows, by default the configuration's.
    hot, noise : bool arrays
        Events that are dropped, as :class:`~.filters.NoiseFilter` judges them.
    """
    t, x, y = (np.asarray(a, np.int64) for a in (t, x, y))
    if not len(t):
        none = torch.zeros(0, dtype=torch.int64)
        return Filtered(none, none, none, *[0] * 7)
    wrap, half = 1 << config.time_bits, 1 << (config.time_bits - 1)
    since_first = (t - t[0] + half) % wrap - half
    back, late, span = _time_errors(config, since_first)
    frac = config.formats.event_frac
    half = (1 << frac) >> 1
    rx, ry = x - (roi[0] << frac), y - (roi[1] << frac)
    column, row = (rx + half) >> frac, (ry + half) >> frac
    width, height = size or (config.roi_width, config.roi_height)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    timely = ~(back | late)
    hot, noise = (np.broadcast_to(mask, len(t)) for mask in (hot, noise))
    good = timely & ~(hot | noise)
    stored = good & inside
    return Filtered(
        *(torch.from_numpy(a[stored]) for a in (since_first, rx, ry)),
        events=len(t),
        outside=int((good & ~inside).sum()),
        time_back=int(back.sum()),
        time_span=int(late.sum()),
        hot=int((timely & hot).sum()),
        noise=int((timely & noise & ~hot).sum()),
        span=span,
    )


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
