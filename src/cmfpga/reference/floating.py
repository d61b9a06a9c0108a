"""Contrast Maximization in float64: the article, equation by equation, and what the robust ascent adds to it.

This is the yardstick: pure functions on torch tensors, with no fixed-point rounding and no saturation. Names in
parentheses, like (Eq. I_w), are the article's equation labels. Everything is differentiable in ``v``, so autograd
can check the analytic gradient; nothing here uses autograd itself.

Not the article's are :func:`dither` and the coarse levels of :func:`evaluate`. :mod:`.float_core` climbs.

Conventions, for all functions:

* ``x``, ``y``: columns and rows relative to the ROI's origin, shape [n], in pixels (integers, or reals if dithered);
  n may be 0.
* ``dt``: scaled times in [−1, 1], shape [n]. ``v`` = (vx, vy), shape [2], in pixels per half batch.
* Images have shape [height, width] and are indexed [y, x]. P = width·height is the article's N_p.
* The four corners of a cell stand in the order of (Eq. weights): (i, j), (i+1, j), (i, j+1), (i+1, j+1).
* Inputs are tensors, NumPy arrays or numbers. Integers are taken exactly; floats other than float64 are refused.
"""

from typing import NamedTuple

import numpy as np
import torch

from ..config.dither import R2


def _tensor(values):
    """A tensor as it is; anything else by way of a NumPy copy, so that read-only and reversed arrays are welcome."""
    return values if isinstance(values, torch.Tensor) else torch.from_numpy(np.array(values, order="C"))


def float64(values):
    """``values`` as a float64 tensor. A float32 is refused, because the bits it lost would never be seen missing."""
    values = _tensor(values)
    if values.is_floating_point() and values.dtype != torch.float64:
        raise TypeError(f"{values.dtype}: float64 or integers are needed")
    return values.to(torch.float64)


def scaled_times(t, t_first, t_last):
    """Time of each event from the middle of the batch, in half batches (Eq. tref, dt, scaled as in the article's §4).

    dt = (t − t_ref) / ((t_N − t_1)/2) with t_ref = t_1 + (t_N − t_1)/2: float64 [n], in [−1, 1]; zeros where t_1 = t_N.

    ``t`` are integers [n]. ``t_first`` and ``t_last``, t_1 and t_N, are of **all** events of the batch, those outside
    the ROI included. Raises :exc:`ValueError` for a time stamp outside of them.
    """
    t = _tensor(t)
    if t.is_floating_point() and len(t):
        raise TypeError(f"{t.dtype}: integer time stamps are needed")
    since_first = t.to(torch.int64) - int(t_first)
    span = int(t_last) - int(t_first)
    if bool(((since_first < 0) | (since_first > span)).any()):
        raise ValueError(f"time stamps outside the batch, {t_first} to {t_last}")
    if not span:
        return torch.zeros(t.shape, dtype=torch.float64, device=t.device)
    # In integers up to the one division, so that dt is the float64 nearest to the true quotient.
    return (2 * since_first - span).to(torch.float64) / span


def warp(x, y, dt, v):
    """Positions at the reference time: x' = x − dt·vx, y' = y − dt·vy (Eq. x'k). Two float64 [n]."""
    x, y, dt, v = float64(x), float64(y), float64(dt), float64(v)
    return x - dt * v[0], y - dt * v[1]


def dither(n):
    """Sub-pixel offsets (along x, along y) of a batch's n ROI events, in the order of their arrival: two float64 [n].

    Event k, counted from 0, gets frac((k + ½)·α) − ½ px, in −½ … ½: see :mod:`cmfpga.config.dither`.
    """
    k = torch.arange(n, dtype=torch.float64) + 0.5
    return tuple((k * alpha).frac() - 0.5 for alpha in R2)


class Votes(NamedTuple):
    """The four bilinear votes of each event, [4, n]."""

    pixel: torch.Tensor  # int64: address y·width + x of the corner; P for a corner outside the ROI
    weight: torch.Tensor  # w (Eq. weights), in [0, 1]; the four of an event sum to 1
    by_x: torch.Tensor  # ∂w/∂x' (Eq. w_dx_x), in [−1, 1]; the four of an event sum to 0
    by_y: torch.Tensor  # ∂w/∂y', likewise


def bilinear_votes(x_warped, y_warped, width, height):
    """:class:`Votes` of events at ``x_warped``, ``y_warped`` into an image of ``width`` × ``height`` pixels.

    The cell is (i, j) = (⌊x'⌋, ⌊y'⌋), so that dx, dy lie in [0, 1). A corner outside the image is dropped alone, the
    others count.
    """
    x_warped, y_warped = float64(x_warped), float64(y_warped)
    i, j = torch.floor(x_warped.detach()), torch.floor(y_warped.detach())
    dx, dy = x_warped - i, y_warped - j
    columns, rows = torch.stack((i, i + 1, i, i + 1)), torch.stack((j, j, j + 1, j + 1))
    # Compared as floats: an address is only formed where it is valid, so far positions cannot alias.
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    return Votes(
        pixel=torch.where(inside, rows * width + columns, float(width * height)).to(torch.int64),
        weight=torch.stack(((1 - dx) * (1 - dy), dx * (1 - dy), (1 - dx) * dy, dx * dy)),
        by_x=torch.stack((-(1 - dy), 1 - dy, -dy, dy)),
        by_y=torch.stack((-(1 - dx), -dx, 1 - dx, dx)),
    )


def accumulate(pixel, values, width, height):
    """Image [height, width] of the sums of ``values`` at each address ``pixel``; address P is dropped."""
    image = values.new_zeros(width * height + 1)  # one word more, where the dropped corners fall
    return image.index_add(0, pixel.flatten(), values.flatten())[:-1].view(height, width)


def iwe(x_warped, y_warped, width, height):
    """Image of warped events: I(i, j) = Σ_k w_kij (Eq. I_w). Each pixel in [0, n]."""
    votes = bilinear_votes(x_warped, y_warped, width, height)
    return accumulate(votes.pixel, votes.weight, width, height)


def at_level(position, level):
    """Positions in the image whose pixels are 2^level px wide: x'' = (x' + ½)/2^level − ½.

    Its first pixel covers the first 2^level pixels, −½ … 2^level − ½.
    """
    return (position + 0.5) / (1 << level) - 0.5 if level else position


def level_size(size, level):
    """Pixels of an image at a coarse level along an axis that is ``size`` px long: ⌈size/2^level⌉."""
    return -(-size // (1 << level))


def derivative_images(votes, dt, width, height):
    """Dx = ∂I/∂vx and Dy = ∂I/∂vy of :class:`Votes` (Eq. I_w_v_x, w_dx_x, dx_k_x'_k_x'_k_v_x). Each pixel in [−n, n].

    ∂w/∂vx = ∂w/∂x' · ∂x'/∂vx with ∂x'/∂vx = −dt. On a grid line, where ∂w/∂x' jumps, it is that of the cell ⌊x'⌋.
    """
    return (
        accumulate(votes.pixel, -dt * votes.by_x, width, height),
        accumulate(votes.pixel, -dt * votes.by_y, width, height),
    )


def contrast(image):
    """C = Var(I), the population variance: divided by P, not by P − 1 (Eq. C)."""
    return (image - image.mean()).square().mean()


def gradient(image, derivative_x, derivative_y):
    """∇C = (∂C/∂vx, ∂C/∂vy), shape [2] (Eq. gradient, C_v_x).

    ∂C/∂v = (2/P)·Σ (I − μ)·(∂I/∂v − ∂μ/∂v) with ∂μ/∂v = mean(∂I/∂v) (Eq. mu_v_x). (Eq. C_v_x) prints μ/∂v where
    only ∂μ/∂v makes sense; it is read so.
    """
    centred = image - image.mean()
    return torch.stack([2 * (centred * (d - d.mean())).mean() for d in (derivative_x, derivative_y)])


class Iteration(NamedTuple):
    """Every intermediate of one iteration, in real units (a full vote is 1.0).

    At a coarse level the image is ⌈width/2^level⌉ × ⌈height/2^level⌉ pixels large and stands in the upper left corner
    of the ROI's P pixels, the others being zero, as in the hardware's memory. So P, the means and the contrast are
    those of all P pixels at every level. Derivatives are by v **in pixels of the level**: ∂I/∂(v/2^level).
    """

    v: torch.Tensor  # [2], at which all was computed, in pixels of the sensor per half batch at every level
    image: torch.Tensor  # I, [height, width]
    derivative_x: torch.Tensor  # Dx, [height, width]
    derivative_y: torch.Tensor  # Dy, [height, width]
    sum_i: torch.Tensor  # ΣI over the ROI
    sum_d: torch.Tensor  # ΣDx and ΣDy, [2]
    s: torch.Tensor  # S = Σ I·D along x and y, [2]
    g: torch.Tensor  # G = P·S − ΣI·ΣD, so that ∂C/∂v = 2·G/P², [2]
    contrast: torch.Tensor  # C
    gradient: torch.Tensor  # ∇C, [2], computed as the article writes it, not from G


def evaluate(x, y, dt, v, *, width, height, level=0, border="corners"):
    """:class:`Iteration` of the events at velocity ``v``, in pixels 2^level px wide.

    With ``border = "whole"`` an event changes the derivatives only if all four corners of its cell are inside, so that
    what leaves the image is no loss of contrast; ``gradient`` is then not the derivative of ``contrast``.
    """
    dt, v = float64(dt), float64(v)
    size = level_size(width, level), level_size(height, level)
    votes = bilinear_votes(*(at_level(position, level) for position in warp(x, y, dt, v)), *size)
    image, pixels = accumulate(votes.pixel, votes.weight, *size), width * height
    if border == "whole":
        dt = dt * (votes.pixel < size[0] * size[1]).all(0)
    derivatives = derivative_images(votes, dt, *size)
    if level:
        rest = (0, width - size[0], 0, height - size[1])
        image, *derivatives = (torch.nn.functional.pad(part, rest) for part in (image, *derivatives))
    sum_i, sum_d = image.sum(), torch.stack([d.sum() for d in derivatives])
    s = torch.stack([(image * d).sum() for d in derivatives])
    g = pixels * s - sum_i * sum_d
    return Iteration(
        v, image, *derivatives, sum_i, sum_d, s, g, contrast=contrast(image), gradient=gradient(image, *derivatives)
    )
