"""Models of :mod:`~cmfpga.rtl.image.warp`, :mod:`~cmfpga.rtl.image.voter`, :mod:`~cmfpga.rtl.image.accumulator`,
:mod:`~cmfpga.rtl.image.gradient_reader` (the sums) and :mod:`cmfpga.rtl.ascent.gradient` (G).
"""

from typing import NamedTuple

import torch

from ...fixed import floor_shift, round_half_up, saturate


def warp(config, x, y, dt, v, level=0):
    """Warped positions x' = x − dt·v (Eq. x'_k), in pixels 2^level px wide: x'' = (x' + ½)/2^level − ½, floored.

    All are int64 tensors [n]: ``x``, ``y``, columns and rows in the ROI, with ``dithered_frac`` fraction bits; ``dt``
    raw; ``v`` along x and y, or a pair of int, with ``v_frac``. Returns x'' and y'', raw ``formats.position_x`` and
    ``position_y``, limited to −2 … size + 1 px: farther is as good as there.
    """
    frac, size = config.dt_frac + config.v_frac, (config.roi_width, config.roi_height)
    half, scaled_half = 1 << (frac - 1), 1 << (config.position_frac - 1)
    warped = []
    for start, by, side in zip((x, y), v, size, strict=True):
        position = (start << (frac - config.formats.dithered_frac)) - dt * by
        scaled = floor_shift(position + half, frac + level - config.position_frac) - scaled_half
        warped.append(saturate(scaled, -2 << config.position_frac, ((side + 1) << config.position_frac) - 1))
    return tuple(warped)


class Votes(NamedTuple):
    """Four votes per event, corners in the order (0,0), (1,0), (0,1), (1,1) of (right, down)."""

    inside: torch.Tensor  # bool [n, 4]; a corner outside the ROI is dropped alone
    column: torch.Tensor  # [n, 4]
    row: torch.Tensor  # [n, 4]
    w: torch.Tensor  # [n, 4] raw weights, weight_frac
    dx: torch.Tensor  # [n, 4] raw ∂w/∂vx, derivative_frac
    dy: torch.Tensor  # [n, 4] raw ∂w/∂vy, derivative_frac


def voter(config, x, y, dt, level=0):
    """Bilinear votes and their derivatives (Eqs. weights, w_dx_x, I_w_v_x) of raw warped positions.

    The derivative of a corner is the rounded magnitude with its sign, so that those of one event sum to exactly
    zero unless a corner is dropped; with ``border = whole`` they are zero if one is. At a coarse level the image is
    smaller; the derivatives are those by v in units of that level's pixels.
    """
    width, height = config.geometry.level_size(level)
    frac = config.position_frac
    one = 1 << frac
    fx, fy = x & (one - 1), y & (one - 1)
    gx, gy = one - fx, one - fy

    def weight(a, b):
        return round_half_up(a * b, 2 * frac - config.weight_frac)

    def derivative(a):
        return round_half_up(dt * a, config.dt_frac + frac - config.derivative_frac)

    column = torch.stack([x >> frac, (x >> frac) + 1] * 2, -1)
    row = torch.stack([y >> frac] * 2 + [(y >> frac) + 1] * 2, -1)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    dx = torch.stack([derivative(gy), -derivative(gy), derivative(fy), -derivative(fy)], -1)
    dy = torch.stack([derivative(gx), derivative(fx), -derivative(gx), -derivative(fx)], -1)
    counted = inside.all(-1, keepdim=True) if config.border == "whole" else 1
    w = torch.stack([weight(gx, gy), weight(fx, gy), weight(gx, fy), weight(fx, fy)], -1)
    return Votes(inside, column, row, w=w, dx=dx * counted, dy=dy * counted)


class Images(NamedTuple):
    """The image of warped events and its derivatives, int64 [roi_height, roi_width]."""

    i: torch.Tensor  # Eq. I_w, weight_frac
    dx: torch.Tensor  # ∂I/∂vx, derivative_frac
    dy: torch.Tensor  # ∂I/∂vy, derivative_frac


def accumulator(config, votes):
    """Sum :class:`Votes` into images."""
    keep = votes.inside
    pixel = votes.row[keep] * config.roi_width + votes.column[keep]

    def image(values):
        total = torch.zeros(config.geometry.pixels, dtype=torch.int64).index_add_(0, pixel, values[keep])
        return total.view(config.roi_height, config.roi_width)

    return Images(image(votes.w), image(votes.dx), image(votes.dy))


class Sums(NamedTuple):
    """Exact sums over the ROI's pixels."""

    i: int  # ΣI
    dx: int  # ΣDx
    dy: int  # ΣDy
    s: tuple[int, ...]  # Σ I·D of each parameter of the motion

    def named(self, config):
        """``{part: value}``, by the names of the core's sums."""
        own = {f"s{name}": s for name, s in zip(config.motion_model.names, self.s, strict=True)}
        return {"i": self.i, "dx": self.dx, "dy": self.dy, **own}


def gradient_reader(images):
    """The sums that the gradient is made of."""
    i, dx, dy = images
    return Sums(*(int(total) for total in (i.sum(), dx.sum(), dy.sum())), (int((i * dx).sum()), int((i * dy).sum())))


def gradient(config, sums):
    """(Gx, Gy), G = P·S − ΣI·ΣD: Eq. C_v_x with the means multiplied out, ∂C/∂v = 2·G/P² in raw units.

    Of another motion than translation S itself, since ΣD = 0 where only whole cells have derivatives.
    """
    if config.motion_model.basis:
        return sums.s
    return tuple(config.geometry.pixels * s - sums.i * d for s, d in zip(sums.s, (sums.dx, sums.dy), strict=True))
