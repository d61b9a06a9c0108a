"""Model of :mod:`cmfpga.rtl.image.gradient_reader` (the sums) and :mod:`cmfpga.rtl.ascent.gradient` (G)."""

from typing import NamedTuple


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
