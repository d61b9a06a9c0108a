"""Models of what is in front of the warp: :mod:`cmfpga.rtl.image.dither`, :mod:`cmfpga.rtl.ingest.reciprocal` and
:mod:`cmfpga.rtl.image.time_scaler`.
"""

import torch

from ...config.dither import DITHER_BITS, FACTORS
from ...fixed import round_half_up, saturate


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


def reciprocal(config, span):
    """``(shift, mantissa)`` for the range ``span`` = t_N − t_1 > 0: 1/span = mantissa · 2^shift / 2^(…), floored.

    ``span << shift`` has its top bit set, so the mantissa lies in 2^(reciprocal_bits−1) … 2^reciprocal_bits.
    """
    shift = config.span_bits - int(span).bit_length()
    return shift, (1 << (config.span_bits - 1 + config.reciprocal_bits)) // (int(span) << shift)


def time_scaler(config, t, *, span):
    """Raw ``config.formats.dt`` of events at ``t`` µs after t_1: (2t − span)/span, −1 … 1 (Eqs. t_ref and dt).

    In windows that slide ``span`` is known before the events are: later ones count as at its end. Times before t_1,
    such as the last window's t_ref, are limited to −2, from −2 itself on, which a floored mantissa would not reach.
    """
    shift, mantissa = reciprocal(config, span)
    numerator = (2 * t - span) << shift
    scaled = round_half_up(numerator * mantissa, config.span_bits - 1 + config.reciprocal_bits - config.dt_frac)
    beyond = (2 * t <= -span) * (4 << config.dt_frac)
    return saturate(scaled - beyond, config.formats.dt.min, 1 << config.dt_frac)
