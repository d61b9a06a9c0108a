"""Model of :mod:`cmfpga.rtl.roi_updater`."""

from ...fixed import saturate


def roi_updater(config, position, v, *, roi_gain):
    """Move the ROI by roi_gain·v (Eq. roi_update, which has a gain of 1), limited to the sensor.

    ``position`` and the result are raw (x, y) of ``config.roi_x_format`` and ``config.roi_y_format``; ``v`` is raw
    ``config.v``, ``roi_gain`` raw ``config.roi_gain_format``. Exact: no bit is rounded away. The second result tells
    whether the sensor's border limited the move.
    """
    frac = config.roi_x_format.f
    target = tuple(p + axis_v * roi_gain for p, axis_v in zip(position, v, strict=True))
    limits = (config.roi_x_max << frac, config.roi_y_max << frac)
    moved = tuple(saturate(p, 0, limit) for p, limit in zip(target, limits, strict=True))
    return moved, moved != target
