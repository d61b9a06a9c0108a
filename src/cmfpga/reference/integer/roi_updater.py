"""Model of :mod:`cmfpga.rtl.ascent.roi_updater`: one move."""

from ..roi_follower import move_within


def roi_updater(config, position, v, *, roi_gain):
    """Move the ROI by roi_gain·v (Eq. roi_update, which has a gain of 1), limited to the sensor.

    ``position`` and the result are raw (x, y) of ``config.roi_x_format`` and ``config.roi_y_format``; ``v`` is raw
    ``config.v``, ``roi_gain`` raw ``config.roi_gain_format``. Exact: no bit is rounded away. The second result tells
    whether the sensor's border limited the move.
    """
    frac = config.roi_x_format.f
    limits = (config.roi_x_max << frac, config.roi_y_max << frac)
    return move_within(position, tuple(axis * roi_gain for axis in v), limits)
