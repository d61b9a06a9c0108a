"""Model of :mod:`cmfpga.rtl.ascent.constant`."""

from ...fixed import floor_shift, round_half_up, saturate


def gain(config, eta):
    """Raw ``config.formats.gain``: η times the mantissa of 2/P², once per batch."""
    return round_half_up(eta * config.widths.gradient_scale[1], 8)


def updater(config, v, g, *, gain):
    """One step v + η·∂C/∂v (Eq. v_update) along one axis.

    Parameters
    ----------
    v : int
        Raw ``config.formats.v``.
    g : int
        G of this axis.
    gain : int
        From :func:`gain`.

    Returns
    -------
    (v, saturated) : (int, bool)
        The next raw v; whether the gradient or v was limited to its format.
    """
    fmt = config.formats.gradient
    slope = floor_shift(g, config.widths.gradient_shift)
    limited_slope = saturate(slope, fmt.min, fmt.max)
    target = v + round_half_up(limited_slope * gain, config.widths.step_shift)
    limited = saturate(target, config.formats.v.min, config.formats.v.max)
    return limited, limited_slope != slope or limited != target
