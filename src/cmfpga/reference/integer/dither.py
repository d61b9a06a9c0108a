"""Model of :mod:`cmfpga.rtl.image.dither`."""

import torch

from ...config.dither import DITHER_BITS, FACTORS


def dither(config, x, y):
    """Positions with a sub-pixel offset: raw with ``dither_frac`` fraction bits.

    The offset of the k-th stored event is frac((k + ½)·α) − ½, floored, with the R2 sequence's α of each axis.
    """
    frac = config.dither_frac
    if not frac:
        return x, y
    k = torch.arange(len(x))
    return tuple(
        (axis << frac) + (((factor // 2 + k * factor) % (1 << DITHER_BITS)) >> (DITHER_BITS - frac)) - (1 << (frac - 1))
        for axis, factor in zip((x, y), FACTORS, strict=True)
    )
