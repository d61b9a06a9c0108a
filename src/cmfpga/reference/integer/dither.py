"""Model of :mod:`cmfpga.rtl.image.dither`."""

import torch

from ...config.dither import DITHER_BITS, FACTORS


def dither(config, x, y, first=0):
    """Positions with a sub-pixel offset: from ``event_frac`` to ``dithered_frac`` fraction bits, raw.

    An undistorted position is dithered too: what comes from one pixel still lies on one point. The offset of the k-th
    stored event is frac((k + ½)·α) − ½, floored, with the R2 sequence's α of each axis; ``first`` is the first k.
    """
    frac, wide = config.dither_frac, config.formats.dithered_frac
    x, y = (axis << (wide - config.formats.event_frac) for axis in (x, y))
    if not frac:
        return x, y
    k = torch.arange(first, first + len(x))
    offsets = (
        (((factor // 2 + k * factor) % (1 << DITHER_BITS)) >> (DITHER_BITS - frac)) - (1 << (frac - 1))
        for factor in FACTORS
    )
    return tuple(axis + (offset << (wide - frac)) for axis, offset in zip((x, y), offsets, strict=True))
