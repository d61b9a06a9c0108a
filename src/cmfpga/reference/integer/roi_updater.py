"""Model of :mod:`cmfpga.rtl.ascent.roi_updater`: one move."""

from ..roi_follower import move_within


def roi_updater(config, position, v, *, roi_gain):
    """Move the ROI by roi_gain·v (Eq. roi_update, which has a gain of 1), limited to the sensor.

    ``position`` and the result are raw (x, y) of ``config.formats.roi_x`` and ``config.formats.roi_y``; ``v`` is raw
    ``config.formats.v``, ``roi_gain`` raw ``config.formats.roi_gain``. Exact: no bit is rounded away. The second result
    tells whether the sensor's border limited the move.
    """
    frac = config.formats.roi_x.f
    limits = (config.geometry.roi_x_max << frac, config.geometry.roi_y_max << frac)
    return move_within(position, tuple(axis * roi_gain for axis in v), limits)
