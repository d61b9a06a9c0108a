"""Image of warped events in NumPy float64: for contrasts and pictures, where torch need not be installed.

The same equations as :mod:`cmfpga.reference.floating`, which the tests compare it with.
"""

import numpy as np

from ..config.dither import DITHER_BITS, FACTORS
from .camera import flow

_RIM = 3  # pixels on each side of the image; they take the votes that fall outside


def events_in_roi(events, roi, width, height):
    """Which events lie in an ROI, and their columns and rows in it: three int64 [n]; of undistorted ones, float64."""
    x, y = (
        axis.astype(np.promote_types(axis.dtype, np.int64)) - corner
        for axis, corner in zip((events.x, events.y), roi, strict=True)
    )
    index = np.flatnonzero((x >= -0.5) & (x < width - 0.5) & (y >= -0.5) & (y < height - 0.5))
    return index, x[index], y[index]


def scaled_roi_events(config, events, roi, *, thinned=False, dropped=None):
    """ROI events of a batch as the engines use them: columns and rows in the ROI, and dt in −1 … 1, float64 [n].

    Empty where the batch has no range of time. Events beyond ``span_bits``, or after the buffer is full, are left out,
    as in the hardware, and so are those that are ``dropped`` (bool [N], of all events; None: none). Of a ``thinned``
    batch, all other ROI events are returned, which the stored ones stand for.
    """
    since = events.t - events.t[0] if len(events) else events.t
    kept = since < 1 << config.span_bits
    span = int(since[kept][-1]) if len(events) else 0
    if not span:
        return np.zeros((3, 0))
    kept = kept if dropped is None else kept & ~dropped
    inside = events_in_roi(events, roi, config.roi_width, config.roi_height)
    stored = np.flatnonzero(kept[inside[0]])[: None if thinned else config.buffer_events]
    index, x, y = (column[stored] for column in inside)
    return np.stack([x, y, (2 * since[index] - span) / span])


def dithered(x, y):
    """``x`` and ``y`` with the sub-pixel offsets of the R2 sequence, −½ … ½ px, in the order of the events."""
    k = np.arange(len(x)) + 0.5
    return tuple(at + k * factor * 2.0**-DITHER_BITS % 1 - 0.5 for at, factor in zip((x, y), FACTORS, strict=True))


def _bilinear(position):
    """First pixel along one axis, and the weights of two pixels."""
    first = np.floor(position)
    after = position - first
    return first.astype(np.int64), (1 - after, after)


def _spread(position):
    """First pixel along one axis, and the weights of three: :func:`_bilinear`, averaged over the width of a pixel."""
    middle = np.floor(position + 0.5)
    u = position - middle
    return middle.astype(np.int64) - 1, (0.5 * (0.5 - u) ** 2, 0.75 - u**2, 0.5 * (0.5 + u) ** 2)


def image_of_warped_events(x, y, dt, v, *, width, height, level=0, spread=False):
    """I (Eq. I_w of the article), float64 [height, width], for events at ``x``, ``y`` and v in px per half batch.

    ``x``, ``y``, ``dt`` are float64 or int [n]: columns and rows in the ROI of ``width`` × ``height`` px; scaled times,
    −1 … 1. ``v`` is of all events, (float, float), or of each, as :func:`cmfpga.imaging.camera.flow` gives it. With a
    ``level`` the image's pixels are 2^level px wide: it has ⌈height/2^level⌉ rows and ⌈width/2^level⌉ columns. With
    ``spread`` each event votes from everywhere in its pixel, evenly: the mean of the images over all dithers.
    """
    columns, rows = -(-width >> level), -(-height >> level)
    across, down = (
        votes_along(at, dt, axis, size, level=level, spread=spread)
        for at, axis, size in zip((x, y), v, (columns, rows), strict=True)
    )
    return image_of_votes(across, down, columns, rows)


def votes_along(at, dt, v, size, *, level=0, spread=False):
    """Votes along one axis: the first pixel of each event's, int64 [n], and the weights of its 2 or 3, [n] each."""
    scale, kernel = 2.0**-level, _spread if spread else _bilinear
    first, weights = kernel(np.minimum(np.maximum((at - dt * v) * scale + (0.5 * scale - 0.5), -2.0), size + 0.5))
    return first + _RIM, weights


def image_of_votes(across, down, columns, rows):
    """The image, float64 [rows, columns], of :func:`votes_along` both axes."""
    (left, wx), (top, wy) = across, down
    stride, near = columns + 2 * _RIM, np.arange(len(wx))
    # All votes at once: on few events, most of the time of a search is the calls'.
    pixels = top * stride + left + (near[:, None] * stride + near)[..., None]
    votes = np.stack(wy)[:, None] * np.stack(wx)
    image = np.bincount(pixels.ravel(), votes.ravel(), (rows + 2 * _RIM) * stride).reshape(-1, stride)
    return image[_RIM:-_RIM, _RIM:-_RIM]


def gain(config, x, y, dt, v, roi):
    """Contrast at ``v``, a motion's parameters, over the one at v = 0, where the image shows motion only.

    Dithered, whatever the configuration: on whole pixels, v = 0 has an edge that the motion did not give it.
    """
    size = {"width": config.roi_width, "height": config.roi_height}
    moves = (0.0, 0.0), flow(config, v, x, y, roi)
    still, moved = (image_of_warped_events(*dithered(x, y), dt, at, **size).var() for at in moves)
    return float(moved / max(still, 1e-12))


def contrast(config, events, roi, v, **which):
    """Contrast (Eq. C), squared events per pixel; ``which`` events: as of :func:`scaled_roi_events`."""
    x, y, dt = scaled_roi_events(config, events, roi, **which)
    v = flow(config, v, x, y, roi)
    return float(image_of_warped_events(x, y, dt, v, width=config.roi_width, height=config.roi_height).var())
