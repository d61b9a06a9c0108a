"""eventcv, a foreign program for Contrast Maximization (PyPI, Apache-2.0, Rust), on the same batches."""

import numpy as np

from cmfpga.errors import needs
from cmfpga.imaging.iwe import events_in_roi

FOREIGN = "eventcv"  # its name in tables


def _stream(x, y, t, p, size):
    """Events as the program has them. Raises :exc:`~cmfpga.errors.MissingPackage` where it is not installed."""
    with needs(FOREIGN, FOREIGN, f"the comparison with {FOREIGN}"):
        import eventcv
    return eventcv.from_numpy(np.stack([x, y, t, p], axis=1), sensor_size=size, time_unit="us")


def find(events, roi, width, height):
    """v in px per half batch of the whole batch's time range, and the improvement of its score over v = 0.

    It starts at v = 0, by its own defaults. ``((0.0, 0.0), 0.0)`` of fewer than two ROI events.
    """
    index, x, y = events_in_roi(events, roi, width, height)
    half = (int(events.t[-1]) - int(events.t[0])) / 2e6 if len(events) else 0.0
    if len(index) < 2 or not half:
        return (0.0, 0.0), 0.0
    found = _stream(x, y, events.t[index] - events.t[0], events.p[index], (width, height)).contrast_maximise()
    vx, vy = (axis * half for axis in found["params"])
    return (vx, vy), found["improvement"]


def find_rotation(camera, events, width, height):
    """(ωx, ωy, ωz), rad/s, of all events, undistorted as the program does it, to whole pixels; it starts at 0."""
    stream = _stream(events.x, events.y, events.t - events.t[0], events.p, (width, height))
    from eventcv import Camera as Lens

    distortion = {name: getattr(camera, name) for name in ("k1", "k2", "p1", "p2", "k3")}
    lens = Lens(camera.fx, camera.fy, camera.cx, camera.cy, **distortion)
    return np.array(stream.undistort(lens).contrast_maximise(model="rotation", camera=lens)["params"])
