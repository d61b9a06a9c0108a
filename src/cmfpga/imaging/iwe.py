"""Image of warped events in NumPy float64: for contrasts and pictures, where torch need not be installed.

The same equations as :mod:`cmfpga.reference.floating`, which the tests compare it with.
"""

import numpy as np


def scaled_roi_events(config, events, roi, *, thinned=False):
    """ROI events of a batch as the engines use them: columns and rows in the ROI, and dt in −1 … 1, float64 [n].

    Empty where the batch has no range of time. Events beyond ``span_bits``, or after the buffer is full, are left out,
    as in the hardware; of a ``thinned`` batch, all ROI events are returned, which the stored ones stand for.
    """
    since = events.t - events.t[0] if len(events) else events.t
    kept = since < 1 << config.span_bits
    span = int(since[kept][-1]) if len(events) else 0
    if not span:
        return np.zeros((3, 0))
    x, y = events.x.astype(np.int64) - roi[0], events.y.astype(np.int64) - roi[1]
    kept &= (x >= 0) & (x < config.roi_width) & (y >= 0) & (y < config.roi_height)
    index = np.flatnonzero(kept)[: None if thinned else config.buffer_events]
    return np.stack([x[index], y[index], (2 * since[index] - span) / span])


def image_of_warped_events(x, y, dt, v, *, width, height):
    """I (Eq. I_w of the article), float64 [height, width], for events at ``x``, ``y`` and v in px per half batch."""
    wx, wy = x - dt * v[0], y - dt * v[1]
    column, row = np.floor(wx).astype(np.int64), np.floor(wy).astype(np.int64)
    fx, fy = wx - column, wy - row
    image = np.zeros((height, width))
    for right, down in ((0, 0), (1, 0), (0, 1), (1, 1)):
        weight = (fx if right else 1 - fx) * (fy if down else 1 - fy)
        c, r = column + right, row + down
        inside = (c >= 0) & (c < width) & (r >= 0) & (r < height)
        np.add.at(image, (r[inside], c[inside]), weight[inside])
    return image


def contrast(config, events, roi, v, *, thinned=False):
    """Population variance of the image of warped events (Eq. C), in squared events per pixel."""
    x, y, dt = scaled_roi_events(config, events, roi, thinned=thinned)
    return float(image_of_warped_events(x, y, dt, v, width=config.roi_width, height=config.roi_height).var())
