"""A small hardware, its core in Verilator, and batches for it."""

import dataclasses

import numpy as np
import pytest

from cmfpga.engines import Engine
from cmfpga.engines.rtl import VerilatedEngine
from cmfpga.events import Events
from cmfpga.protocol.settings import BatchSettings
from cmfpga.verilog.compiler import find_compiler
from cmfpga.verilog.simulation import VerilatedCore
from support.designs import SMALL

CONFIG = SMALL


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
    core = VerilatedCore(CONFIG)
    yield core
    core.close()


@pytest.fixture
def verilated_core(one_core):
    one_core.reset()
    return one_core


def engine_of(core):
    engine = VerilatedEngine.__new__(VerilatedEngine)  # without emitting the Verilog again to look the library up
    Engine.__init__(engine, core.config)
    engine._core = core
    return engine


@pytest.fixture
def verilated_engine(verilated_core):
    return engine_of(verilated_core)


def make_events(rng, count, t=None):
    t = np.sort(rng.integers(0, 1000, count)) if t is None else t
    return Events(t, rng.integers(4, 20, count), rng.integers(4, 16, count), np.zeros(count))


def settings(roi=None, **changes):
    return dataclasses.replace(BatchSettings.from_config(CONFIG, roi), **changes)


def without_cycles(result):
    return dataclasses.replace(result, cycles=None)
