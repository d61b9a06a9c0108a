"""A small hardware, its core in Verilator, and batches for it."""

import dataclasses

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.engines.rtl import RtlEngine
from cmfpga.engines.verilated import VerilatedEngine
from cmfpga.events import Events
from cmfpga.protocol.settings import BatchSettings
from cmfpga.simulation.core import VerilatedCore
from cmfpga.verilog.compiler import find_compiler

HARDWARE = {
    "sensor_width": 32, "sensor_height": 24, "roi_width": 8, "roi_height": 8, "buffer_events": 96,
    "max_batch_events": 100, "time_bits": 16, "span_bits": 10, "max_iterations": 15, "v_int": 3,
}  # fmt: skip
CONFIG = Config(**HARDWARE, iterations=3)

#: The same hardware of both ascents, for recordings that say how large their sensor is: options of ``cmfpga.track``.
_SIZES = {name: value for name, value in HARDWARE.items() if not name.startswith("sensor_")}
PAPER = {"preset": "paper", **_SIZES, "iterations": 15, "eta": 0.1, "min_roi_events": 3}
FAST = {
    "preset": "fast", **_SIZES, "min_roi_events": 3, "max_level": 2, "cold": "2:0*2 1:0 1:-1*2 0:-2*3",
    "warm": "1:-1 0:-2*2",
}  # fmt: skip
ROUNDS = {**FAST, "ascent": "newton", "cold": "2:3/2:2 1:1:1 0:3/4:3/4", "warm": "1:1:3/2 0:3/4:1/8"}


def sets(fields):
    """Fields of a configuration as command-line options; one that is None is left out."""
    return [part for name, value in fields.items() if value is not None for part in ("--set", f"{name}={value}")]


def options(config):
    """A configuration with its preset as command-line options."""
    return ["--preset", config["preset"], *sets({name: config[name] for name in config if name != "preset"})]


@pytest.fixture(scope="session")
def compiler():
    if find_compiler() is None:
        pytest.skip("no C++ compiler to compile the Verilog with: install g++")


@pytest.fixture(scope="session")
def one_core(compiler):
    """One simulated core for all tests."""
    core = VerilatedCore(CONFIG)
    yield core
    core.close()


@pytest.fixture
def verilated_core(one_core):
    """A simulated core after a reset."""
    one_core.reset()
    return one_core


def engine_of(core):
    """The engine of a simulated core."""
    engine = VerilatedEngine.__new__(VerilatedEngine)  # without emitting the Verilog again to look the library up
    RtlEngine.__init__(engine, core.config)
    engine._core = core
    return engine


@pytest.fixture
def verilated_engine(verilated_core):
    return engine_of(verilated_core)


def make_events(rng, count, t=None, right=20, bottom=16):
    t = np.sort(rng.integers(0, 1000, count)) if t is None else t
    return Events(t, rng.integers(4, right, count), rng.integers(4, bottom, count), np.zeros(count))


def settings(roi=None, **changes):
    return dataclasses.replace(BatchSettings.from_config(CONFIG, roi), **changes)


def without_cycles(result):
    return dataclasses.replace(result, cycles=None)
