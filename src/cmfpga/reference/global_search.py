"""One motion for all events: the contrast's highest peak in float64, by a global search.

The motion is any flow that is linear in its parameters, u = Σ θ_j·b_j at an event's position: see :func:`translation`,
:func:`affine` and :func:`rotation`. It may change linearly in time. No ROI, no schedule and no narrow arithmetic is
involved, so that a result can serve as the truth of what an engine finds in an ROI.
"""

from dataclasses import dataclass

import numpy as np
import torch

from .floating import at_level, contrast, dither, float64, iwe, level_size

#: Grid of starts along the first two parameters, and steps and levels of the search, px per half of the time range.
REACH, STEPS = 12, ((2, 4.0), (2, 2.0), (1, 1.0), (0, 0.5), (0, 0.25), (0, 0.125), (0, 1 / 16), (0, 1 / 32))
_GRID_EVENTS = 20_000  # used for the grid
_BORDER = 8  # px around the events' positions where no window is given


@dataclass(frozen=True)
class Flow:
    """Positions of events, and how each parameter moves them."""

    position: np.ndarray  # float64 [2, n], in px of the image that is made
    basis: np.ndarray  # float64 [2, k, n]: b, px per unit of each parameter


def _dithered(x, y):
    return np.stack([axis + offset.numpy() for axis, offset in zip((x, y), dither(len(x)), strict=True)])


def translation(x, y):
    """Flow of (vx, vy), px/s."""
    return Flow(_dithered(x, y), np.broadcast_to(np.eye(2)[:, :, None], (2, 2, len(x))))


def affine(x, y, centre, scale):
    """Flow of (vx, vy) at ``centre`` and their slopes along x and y, px/s per ``scale`` px: six parameters."""
    at = _dithered(x, y)
    across, down = (at - np.reshape(centre, (2, 1))) / scale
    one, zero = np.ones_like(across), np.zeros_like(across)
    rows = [one, zero, across, down, zero, zero], [zero, one, zero, zero, across, down]
    return Flow(at, np.array(rows))


def rotation(camera, x, y):
    """Flow of a :class:`~cmfpga.imaging.camera.Camera`'s angular velocity (ωx, ωy, ωz), rad/s, undistorted."""
    rays = camera.rays(*_dithered(x, y))
    focus = np.array([camera.fx, camera.fy])
    centre = np.array([camera.cx, camera.cy])
    return Flow(rays * focus[:, None] + centre[:, None], camera.rotation(*rays) * focus[:, None, None])


def rotation_as_seen(camera, x, y):
    """:func:`rotation` as the lens shows it: for lenses to be compared by the contrast that they allow."""
    at = _dithered(x, y)
    return Flow(at, np.stack([camera.speeds(axis, *at) for axis in np.eye(3)], axis=1))


@dataclass(frozen=True)
class Found:
    """The motion found."""

    at_middle: np.ndarray  # float64 [k], parameters in the middle of the time range
    rate: np.ndarray  # float64 [k], their change per s; 0 unless ``linear``
    contrast: float  # population variance of the image

    def at(self, seconds):
        """Parameters so many seconds after the middle."""
        return self.at_middle + self.rate * seconds


def search(flow, t, *, linear=False, window=None):
    """The :class:`Found` motion of all events of a :class:`Flow`, at ``t`` µs, integers [n].

    ``linear``: the parameters change linearly in time. ``window`` has the first and last column and row of the image,
    px; events may enter and leave it. By default it holds all.
    """
    t = np.asarray(t, np.int64)
    seconds = (t - (t[0] + t[-1]) / 2) * 1e-6
    half = max(float(seconds[-1]), 1e-9)
    lows, highs = flow.position.min(axis=1) - _BORDER, flow.position.max(axis=1) + _BORDER
    if window is not None:
        lows, highs = np.array([window[0], window[2]]), np.array([window[1], window[3]])
    width, height = (int(size) for size in np.ceil(highs - lows) + 1)
    position, basis = float64(flow.position - lows[:, None]), float64(flow.basis)
    count = basis.shape[1]
    dt = float64(seconds)
    # A unit of each parameter moves the events by 1 px (rms) per half of the time range.
    unit = 1 / (half * basis.square().sum(0).mean(1).sqrt().clamp_min(1e-12))
    unit = torch.cat([unit, unit * 2 / half]) if linear else unit

    def score(theta, level, stride=1):
        theta, part = theta * unit, slice(None, None, stride)
        at, by, s = position[:, part], basis[:, :, part], dt[part]
        moved = torch.einsum("akn,k->an", by, theta[:count]) * s
        if linear:
            moved = moved + torch.einsum("akn,k->an", by, theta[count:]) * (s * s / 2)
        warped = (at_level(axis, level) for axis in at - moved)
        return float(contrast(iwe(*warped, level_size(width, level), level_size(height, level))))

    grid = torch.arange(-REACH, REACH + 1, 4, dtype=torch.float64)
    starts = torch.zeros(len(grid) ** 2, len(unit), dtype=torch.float64)
    starts[:, :2] = torch.cartesian_prod(grid, grid)
    stride = -(-len(t) // _GRID_EVENTS)
    best = max(starts, key=lambda theta: score(theta, 2, stride)).clone()
    for level, step in STEPS:
        highest, better = score(best, level), True
        while better:
            better = False
            for axis in range(len(unit)):
                for way in (step, -step):
                    tried = best.clone()
                    tried[axis] += way
                    if (value := score(tried, level)) > highest:
                        best, highest, better = tried, value, True
                        break
    found = (best * unit).numpy()
    return Found(found[:count], found[count:] if linear else np.zeros(count), highest)
