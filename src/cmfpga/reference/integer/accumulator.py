"""Model of :mod:`cmfpga.rtl.image.accumulator`."""

from typing import NamedTuple

import torch


class Images(NamedTuple):
    """The image of warped events and its derivatives, int64 [roi_height, roi_width]."""

    i: torch.Tensor  # Eq. I_w, weight_frac
    dx: torch.Tensor  # ∂I/∂vx, derivative_frac
    dy: torch.Tensor  # ∂I/∂vy, derivative_frac


def accumulator(config, votes):
    """Sum :class:`~.voter.Votes` into images."""
    keep = votes.inside
    pixel = votes.row[keep] * config.roi_width + votes.column[keep]

    def image(values):
        total = torch.zeros(config.geometry.pixels, dtype=torch.int64).index_add_(0, pixel, values[keep])
        return total.view(config.roi_height, config.roi_width)

    return Images(image(votes.w), image(votes.dx), image(votes.dy))
