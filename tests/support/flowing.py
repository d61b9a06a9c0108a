"""Small scenes whose flow is known, and what the hardware measures in them."""

import contextlib

from cmfpga.camera import Camera
from cmfpga.config import preset
from cmfpga.engines.regions import RegionEngine
from cmfpga.flow import grid
from cmfpga.flow.run import Run

#: What slides, px/s; the camera, and how it turns, rad/s; what all scenes share.
VELOCITY = (90.0, -60.0)
CAMERA = Camera(100.0, 100.0, 63.5, 47.5)
OMEGA = (0.4, -0.7, 0.5)
FIELDS = {"seed": 3, "width": 128, "height": 96, "duration_us": 100_000}


def measured(recording, camera=None, engine="model", **how):
    """The windows of a recording of that size, and the run that made them."""
    given = {"camera": camera.text} if camera else {}
    config = preset("flow").replace(sensor_width=128, sensor_height=96, **given)
    with contextlib.closing(RegionEngine(engine, config)) as running:
        run = Run(recording, running, grid(config), **how)
        return [*run], run
