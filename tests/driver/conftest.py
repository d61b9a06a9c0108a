"""The simulated hardware, compiled once, and batches for it."""

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.engines.rtl import find_compiler
from cmfpga.events import Events

SMALL = {"sensor_width": 48, "sensor_height": 32, "roi_width": 16, "roi_height": 16, "buffer_events": 64}
CONFIG = preset("fast").replace(**SMALL)


@pytest.fixture
def compiler():
    if find_compiler() is None:
        pytest.skip("no C++ compiler to compile the Verilog with: install g++")


@pytest.fixture
def top(compiler):
    """A fresh :class:`~cmfpga.driver.simulation.SimulatedTop`; its library is compiled once."""
    from cmfpga.driver.simulation import SimulatedTop

    made = SimulatedTop(CONFIG)
    yield made
    made.close()


def batch(rng, events=100, *, begin=0, config=CONFIG):
    """Random events all over the sensor."""
    return Events(
        np.sort(rng.integers(begin, begin + 1000, events)),
        rng.integers(0, config.sensor_width, events),
        rng.integers(0, config.sensor_height, events),
        rng.integers(0, 2, events),
    )
