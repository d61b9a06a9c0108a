"""Model of :mod:`cmfpga.rtl.warp`."""

from ...fixed import floor_shift, saturate


def warp(config, x, y, dt, v):
    """Warped positions x' = x − dt·v (Eq. x'_k), floored to ``position_frac`` bits and clamped.

    Parameters
    ----------
    x, y : int64 tensors, [n]
        Columns and rows in the ROI.
    dt : int64 tensor, [n]
        Raw ``config.dt``.
    v : pair of int
        Raw ``config.v``.

    Returns
    -------
    (x', y') : int64 tensors, [n]
        Raw ``config.position_x`` and ``config.position_y``, limited to −2 … size + 1 px: farther is as good as there.
    """
    return (
        _warp_axis(config, x, dt, v[0], config.roi_width),
        _warp_axis(config, y, dt, v[1], config.roi_height),
    )


def _warp_axis(config, x, dt, v, size):
    product_frac = config.dt_frac + config.v_frac
    position = floor_shift((x << product_frac) - dt * v, product_frac - config.position_frac)
    return saturate(position, -2 << config.position_frac, ((size + 1) << config.position_frac) - 1)
