"""The simulated hardware of the driver's tests, compiled once, and batches for it."""

import contextlib
import time

import numpy as np
import pytest

from cmfpga.driver import Accelerator
from cmfpga.driver.simulation import SimulatedTop, SimulationBackend
from cmfpga.engines.model import ModelEngine
from cmfpga.events import Events
from cmfpga.protocol.registers import register_map
from cmfpga.protocol.results import fields_of, packet_beats
from cmfpga.protocol.settings import BatchSettings
from support.designs import SHELL

CONFIG = SHELL
REGISTERS = register_map(CONFIG)
#: Words of 64 bits in a packet.
BEATS = packet_beats(CONFIG)


@pytest.fixture
def top(compiler):
    """A fresh :class:`~cmfpga.driver.simulation.SimulatedTop`; its library is compiled once."""
    made = SimulatedTop(CONFIG)
    yield made
    made.close()


def batch(rng, events=100, *, begin=0, config=CONFIG):
    return Events(
        np.sort(rng.integers(begin, begin + 1000, events)),
        rng.integers(0, config.sensor_width, events),
        rng.integers(0, config.sensor_height, events),
        rng.integers(0, 2, events),
    )


def differences(result, expected):
    """Where a result of the wire differs from the integer model's, a line each; the model has no cycles."""
    names = [f.name for f in fields_of("batch", "region") if f.name != "cycles"]
    pairs = {name: (getattr(result, name), getattr(expected, name)) for name in names}
    return [f"{name} is {got}, {wanted} is expected" for name, (got, wanted) in pairs.items() if got != wanted]


def model_run(model, events, roi=None, config=CONFIG):
    return model.run(events, BatchSettings.from_config(config, roi))[0]


@contextlib.contextmanager
def within(seconds):
    begin = time.monotonic()
    yield
    assert time.monotonic() - begin < seconds


def works(accelerator, rng, sizes=(120, 120)):
    """As after a reset: results of batches of these sizes, each of which is the model's."""
    model, results = ModelEngine(CONFIG), []
    for number, size in enumerate(sizes):
        events = batch(rng, int(size), begin=1000 * number)
        roi = None if number else (8, 4)
        results.append(accelerator.run(events, roi=roi))
        assert differences(results[-1], model_run(model, events, roi)) == []
    return results


def streamed(model, results, events):
    """Each result of a stream is the model's of the events that it took; how many all took."""
    taken = 0
    for number, result in enumerate(results):
        part = events[taken : taken + result.events]
        taken += result.events
        assert differences(result, model_run(model, part, None if number else (8, 4))) == []
    return taken


class Wrapped(SimulationBackend):
    """The simulation of the shared top, with registers that may be made to lie."""

    def __init__(self, top):
        self.config, self.top = CONFIG, top
        self.overrides = {}

    def override(self, register, **fields):
        declared = REGISTERS[register]
        word = self.top.read32(declared.offset)
        for name, value in fields.items():
            word = word & ~declared[name].mask | declared[name].pack(value)
        self.overrides[declared.offset] = word

    def read32(self, offset):
        return self.overrides.get(offset, super().read32(offset))


@pytest.fixture
def backend(top):
    return Wrapped(top)


@pytest.fixture
def accelerator(backend):
    return Accelerator(backend)
