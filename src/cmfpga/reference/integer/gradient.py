"""Model of :mod:`cmfpga.rtl.image.gradient_reader` (the sums) and :mod:`cmfpga.rtl.ascent.gradient` (G)."""

from typing import NamedTuple


class Sums(NamedTuple):
    """Exact sums over the ROI's pixels."""

    i: int  # ΣI
    dx: int  # ΣDx
    dy: int  # ΣDy
    sx: int  # Σ I·Dx
    sy: int  # Σ I·Dy


def gradient_reader(images):
    """The sums that the gradient is made of."""
    i, dx, dy = images
    return Sums(*(int(total) for total in (i.sum(), dx.sum(), dy.sum(), (i * dx).sum(), (i * dy).sum())))


def gradient(config, sums):
    """(Gx, Gy), G = P·S − ΣI·ΣD: Eq. C_v_x with the means multiplied out, ∂C/∂v = 2·G/P² in raw units."""
    return config.geometry.pixels * sums.sx - sums.i * sums.dx, config.geometry.pixels * sums.sy - sums.i * sums.dy
