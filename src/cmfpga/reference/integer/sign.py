"""Model of :mod:`cmfpga.rtl.ascent.sign`."""

from ...fixed import saturate


def lesser(config, gradient):
    """Which parameters' slopes are less than half of the steepest one's, a bool each.

    Whole parts of S are compared, rounded down, of negative ones less one: −8 counts as 7.
    """
    whole = [g >> config.widths.s_frac for g in gradient]
    sizes = [part if part >= 0 else ~part for part in whole]
    return [2 * size < max(sizes) for size in sizes]


def sign_updater(fmt, v, g, *, log2_step, halved=False):
    """One step v + 2^log2_step · sign(G) of one parameter: (next raw v, whether it was limited to its format).

    ``halved``: half of that step, rounded down.
    """
    step = (1 << (log2_step + fmt.f)) >> halved
    target = v + step * ((g > 0) - (g < 0))
    limited = saturate(target, fmt.min, fmt.max)
    return limited, limited != target
