"""Model of :mod:`cmfpga.rtl.image.voter`."""

from typing import NamedTuple

import torch

from ...fixed import round_half_up


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
    return Votes(
        inside,
        column,
        row,
        w=torch.stack([weight(gx, gy), weight(fx, gy), weight(gx, fy), weight(fx, fy)], -1),
        dx=dx * counted,
        dy=dy * counted,
    )
