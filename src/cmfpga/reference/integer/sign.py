"""Model of :mod:`cmfpga.rtl.ascent.sign`."""

from ...fixed import saturate


def sign_updater(config, v, g, *, log2_step):
    """One step v + 2^log2_step · sign(G) along one axis: (next raw v, whether it was limited to its format)."""
    step = 1 << (log2_step + config.formats.v.f)
    target = v + step * ((g > 0) - (g < 0))
    limited = saturate(target, config.formats.v.min, config.formats.v.max)
    return limited, limited != target
