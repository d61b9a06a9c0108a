"""The motion in an ROI: the contrast's highest peak over a grid of velocities, coarse to fine.

Positions are dithered; no start value is needed.
"""

import math

import numpy as np

from ..iwe import dithered, image_of_warped_events

REACH_PX = 10  # velocities that the grid holds, px per half window


def estimate(x, y, dt, width, height):
    """Velocity at which the image of warped events is sharpest, px per half window, and how much sharper than at 0.

    Parameters
    ----------
    x, y : float64 [n]
        Positions in the ROI, px.
    dt : float64 [n]
        Scaled times, −1 … 1.
    width, height : int
        Of the ROI, px.

    Returns
    -------
    (vx, vy), gain, clarity : float64 [2], float, float
        ``gain`` is the contrast at v over the one at v = 0. ``clarity`` is what the contrast loses, as a share of it, 3
        px away in the direction in which it loses least, in an image of pixels twice as wide: near 0 where all edges
        have one direction, along which the motion cannot be seen.
    """
    x, y = dithered(x, y)

    def contrast(v, level, border=0):
        size = {"width": width + 2 * border, "height": height + 2 * border}
        return image_of_warped_events(x + border, y + border, dt, v, **size, level=level).var()

    grid = np.arange(-REACH_PX, REACH_PX + 1.0)
    v = max(((vx, vy) for vx in grid for vy in grid), key=lambda v: contrast(v, 2))
    for level, step in ((1, 1.0), (1, 0.5), (0, 0.5), (0, 0.25), (0, 0.125)):
        best = contrast(v, level)
        while True:
            around = [(v[0] + a * step, v[1] + b * step) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]
            values = [contrast(near, level) for near in around]
            if max(values) <= best:
                break
            best, v = max(values), around[int(np.argmax(values))]
            if max(map(abs, v)) > REACH_PX + 2:
                break
    still = contrast((0.0, 0.0), 0)
    # With a border that no event leaves: what is lost there says nothing of the peak.
    ring = [(v[0] + 3 * math.cos(a), v[1] + 3 * math.sin(a)) for a in np.arange(16) * math.pi / 8]
    peak, *around = (contrast(near, 1, border=16) for near in (v, *ring))
    clarity = 1 - max(around) / max(peak, 1e-12)
    return np.array(v), best / max(still, 1e-12), clarity
