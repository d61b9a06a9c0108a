"""Model of :mod:`cmfpga.rtl.image.warp`."""

from ...fixed import floor_shift, saturate


def warp(config, x, y, dt, v, level=0):
    """Warped positions x' = x − dt·v (Eq. x'_k), in pixels 2^level wide, floored and clamped.

    Parameters
    ----------
    x, y : int64 tensors, [n]
        Columns and rows in the ROI, with ``dithered_frac`` fraction bits.
    dt : int64 tensor, [n]
        Raw ``config.formats.dt``.
    v : pair of int, or of int64 tensors [n]
        Along x and y, with ``v_frac`` fraction bits.
    level : int
        Pixels are 2^level px wide: x'' = (x' + ½)/2^level − ½.

    Returns
    -------
    (x'', y'') : int64 tensors, [n]
        Raw ``config.formats.position_x`` and ``config.formats.position_y``, limited to −2 … size + 1 px: farther
        is as good as there.
    """
    return (
        _warp_axis(config, x, dt, v[0], level, config.roi_width),
        _warp_axis(config, y, dt, v[1], level, config.roi_height),
    )


def _warp_axis(config, x, dt, v, level, size):
    frac = config.dt_frac + config.v_frac
    position = (x << (frac - config.formats.dithered_frac)) - dt * v
    half = 1 << (frac - 1)
    scaled = floor_shift(position + half, frac + level - config.position_frac) - (1 << (config.position_frac - 1))
    return saturate(scaled, -2 << config.position_frac, ((size + 1) << config.position_frac) - 1)
