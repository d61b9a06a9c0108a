"""Small scenes whose flow is known, and what the hardware measures in them."""

import contextlib

import pytest

from cmfpga.config import preset
from cmfpga.dense import grid
from cmfpga.dense.window import Run
from cmfpga.engines import make_engine
from cmfpga.events import generate
from cmfpga.imaging.camera import Camera

#: What slides, px/s; the camera, and how it turns, rad/s; what all scenes share.
VELOCITY = (90.0, -60.0)
CAMERA = Camera(100.0, 100.0, 63.5, 47.5)
OMEGA = (0.4, -0.7, 1.0)
FIELDS = {"seed": 3, "width": 128, "height": 96, "duration_us": 100_000}


def measured(recording, camera=None, engine="model", slices=1, **how):
    """The windows of a recording of that size, and the run that made them."""
    given = {"camera": camera.text} if camera else {}
    config = preset("flow").replace(sensor_width=128, sensor_height=96, slices=slices, **given)
    with contextlib.closing(make_engine(engine, config)) as running:
        run = Run(recording, running, grid(config), **how)
        return [*run], run


@pytest.fixture(scope="session")
def sliding():
    """All that is seen moves by ``VELOCITY``."""
    return generate(**FIELDS, size=(200, 160), bars=30, velocity=VELOCITY, noise=0.05)


@pytest.fixture(scope="session")
def turning():
    """The camera turns by ``OMEGA``."""
    fields = {"size": (220, 180), "bars": 40, "velocity": (0.0, 0.0), "rotation": OMEGA, "camera": CAMERA}
    return generate(**FIELDS, **fields, noise=0.05)


@pytest.fixture(scope="session")
def slid(sliding):
    return measured(sliding.recording(), window_events=9000, windows=1)[0][0]


@pytest.fixture(scope="session")
def turned(turning):
    return measured(turning.recording(), CAMERA, window_events=9000, windows=1)[0][0]
