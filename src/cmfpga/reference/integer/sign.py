"""Model of :mod:`cmfpga.rtl.ascent.sign`."""

from ...fixed import saturate


def sign_updater(fmt, v, g, *, log2_step):
    """One step v + 2^log2_step · sign(G) of one parameter: (next raw v, whether it was limited to its format)."""
    step = 1 << (log2_step + fmt.f)
    target = v + step * ((g > 0) - (g < 0))
    limited = saturate(target, fmt.min, fmt.max)
    return limited, limited != target
