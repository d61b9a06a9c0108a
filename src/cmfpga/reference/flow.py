"""Motions beyond translation in float64: the same ascent by signs, of parameters whose basis depends on the position.

An event at q px from the centre moves by u = Σ v_p·b_p(q) px per half batch; x' = x − dt·u (:mod:`cmfpga.config.motion`
names the parameters). The gradient of the contrast is Σ I·∂I/∂v_p, ∂I/∂v_p the sum over events of
−dt·b_p·∂w/∂x': :func:`slopes`. An image of that sum for each p would be needed; the hardware has one for each axis. In
a similarity it takes b_p at the pixel for that of the events, in a rotation at the event that arrives for those that
were there before it: :func:`sums`.
"""

import numpy as np
import torch

from ..config.schedule import used
from ..protocol.trace import Trace
from .floating import accumulate, at_level, bilinear_votes, float64, level_size


def basis(config, x, y, *, roi, camera, middle=None):
    """b of events, of a motion beyond translation: float64 [2, parameters, n], along x and y.

    ``x``, ``y``, float64 [n], are columns and rows in the ROI, px, whose corner is ``roi``. ``camera`` has the nine
    numbers of a rotation. ``middle`` is that of a region in the ROI, in half pixels
    (:meth:`cmfpga.protocol.regions.Region.middle`), by default the ROI's.
    """
    motion = config.motion_model
    arm, focus, centre = float(1 << motion.lever), 1.0, [at / 2 for at in middle or config.geometry.middle]
    if config.motion == "rotation":
        focus = (camera[0] * camera[1]) ** 0.5
        centre = [at - corner for at, corner in zip(camera[2:4], roi, strict=True)]
    p, q = (float64(axis) - middle for axis, middle in zip((x, y), centre, strict=True))
    members = {"p": p / arm, "q": q / arm, "xx": p * p / focus**2, "xy": p * q / focus**2, "yy": q * q / focus**2}
    found = torch.zeros(2, len(motion.names), len(p), dtype=torch.float64)
    for row, (axis, terms) in enumerate(motion.terms.items()):
        found[row, motion.names.index(axis)] = 1.0
        for name, member, sign in terms:
            found[row, motion.names.index(name)] += sign * members[member]
    return found


def pixel_basis(config, level, middle=None):
    """b in the middle of pixels 2^level px wide, of a similarity: float64 [2, parameters, pixels], row by row."""
    columns, rows = (torch.arange(level_size(size, level)) for size in (config.roi_width, config.roi_height))
    x, y = ((at + 0.5) * (1 << level) - 0.5 for at in (columns, rows))
    y, x = (axis.flatten() for axis in torch.meshgrid(y, x, indexing="ij"))
    return basis(config, x.double(), y.double(), roi=(0, 0), camera=(), middle=middle)


def warped(x, y, dt, v, b, level=0):
    """Positions at the reference time in pixels 2^level px wide: two float64 [n]."""
    u = torch.einsum("apn,p->an", b, float64(v))
    return tuple(at_level(float64(axis) - float64(dt) * moved, level) for axis, moved in zip((x, y), u, strict=True))


def _votes(x, y, dt, v, b, *, width, height, level):
    """(votes, dt of events whose cells are whole, size of the image)."""
    size = level_size(width, level), level_size(height, level)
    votes = bilinear_votes(*warped(x, y, dt, v, b, level), *size)
    return votes, float64(dt) * (votes.pixel < size[0] * size[1]).all(0), size


def slopes(x, y, dt, v, b, *, width, height, level=0):
    """Σ I·∂I/∂v_p, half the derivative of Σ I²: float64 [parameters]. Only whole cells change with v."""
    votes, dt, size = _votes(x, y, dt, v, b, width=width, height=height, level=level)
    image = accumulate(votes.pixel, votes.weight, *size)
    moved = [-dt * (b[0, p] * votes.by_x + b[1, p] * votes.by_y) for p in range(b.shape[1])]
    return torch.stack([(image * accumulate(votes.pixel, each, *size)).sum() for each in moved])


def squares(x, y, dt, v, b, *, width, height, level=0):
    """Σ I²."""
    votes, _, size = _votes(x, y, dt, v, b, width=width, height=height, level=level)
    return float(accumulate(votes.pixel, votes.weight, *size).square().sum())


def sums(x, y, dt, v, b, *, width, height, level=0, at_pixels=None):
    """(ΣI, S): S_p = Σ b_p·(what an event adds to Σ I·D along each axis), one event after the other, as in hardware.

    ``at_pixels`` is :func:`pixel_basis`, which is then taken; by default that of the events, ``b``.
    """
    votes, dt, size = _votes(x, y, dt, v, b, width=width, height=height, level=level)
    pixel, order = torch.sort(votes.pixel.T.flatten(), stable=True)
    event, inside = order // 4, pixel < size[0] * size[1]
    fresh = torch.ones_like(inside)
    fresh[1:] = pixel[1:] != pixel[:-1]
    first = torch.cummax(torch.arange(len(pixel)) * fresh, 0).values if len(pixel) else event

    def of_pixels(values):
        """Votes in the order of their pixels, and what the pixel had before each."""
        values = values.T.flatten()[order] * inside
        total = values.cumsum(0) - values
        return values, total - total[first]

    w, i = of_pixels(votes.weight)
    s = torch.zeros(b.shape[1], dtype=torch.float64)
    taken = b[:, :, event] if at_pixels is None else at_pixels[:, :, pixel * inside]
    for along, slope in zip(taken, (votes.by_x, votes.by_y), strict=True):
        d, before = of_pixels(-dt * slope)
        s += along @ (i * d + w * (before + d))
    return w.sum(), s


def by_signs(slopes, log2_step):
    """±2^log2_step for each slope that is not zero, half of it where one is less than half of the steepest: [p]."""
    return 2.0**log2_step * slopes.sign() * torch.where(2 * slopes.abs() < slopes.abs().max(), 0.5, 1.0)


def ascend(x, y, dt, b, *, v_start, schedule, limits, at_pixels=lambda level: None, **size):
    """v ← v + :func:`by_signs` of S, within ±``limits``: :class:`Trace`, whose ΣD are 0.

    ``at_pixels(level)`` is what :func:`sums` takes.
    """
    v, found = [float64(v_start)], []
    for k, entry in enumerate(schedule):
        part = used(entry, k, len(dt))
        size |= {"level": entry.level, "at_pixels": at_pixels(entry.level)}
        found.append(sums(x[part], y[part], dt[part], v[-1], b[:, :, part], **size))
        target = v[-1] + by_signs(found[-1][1], entry.log2_step)
        v.append(torch.minimum(torch.maximum(target, -limits), limits))
    v, sum_i, s = (torch.stack(rows).numpy() for rows in (v, *zip(*found, strict=True)))
    return Trace(v=v, sum_i=sum_i, sum_d=np.zeros((len(sum_i), 2)), s=s)
