"""Scenes whose flow is known, and a window of each."""

import pytest

from cmfpga.events import generate
from support.flowing import CAMERA, FIELDS, OMEGA, VELOCITY, measured


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
def window(sliding):
    """One window of the sliding scene."""
    return measured(sliding.recording(), window_events=9000, windows=1)[0][0]


@pytest.fixture(scope="session")
def turned(turning):
    """One window of the turning scene."""
    return measured(turning.recording(), CAMERA, window_events=9000, windows=1)[0][0]
