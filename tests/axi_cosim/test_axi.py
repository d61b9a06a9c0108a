"""The emitted AXI top in Verilator and in Icarus, driven by cocotb and cocotbext-axi."""

import re
from pathlib import Path

import pytest
from simulators import Simulation, require

from cmfpga.config import preset

SMALL = {"sensor_width": 64, "sensor_height": 48, "roi_width": 16, "roi_height": 12, "buffer_events": 128}
CONFIGS = {
    "small fast": preset("fast").replace(**SMALL, max_batch_events=2000),
    "small paper": preset("paper").replace(**SMALL, max_batch_events=2000, iterations=4),
}
#: Which configuration each simulator runs.
RUNS = {"verilator": "small fast", "icarus": "small paper"}


def names_in(module):
    """Names of a module's cocotb tests; it can only be imported in a simulation."""
    text = (Path(__file__).parent / f"{module}.py").read_text(encoding="utf-8")
    return re.findall(r"^@cocotb\.test\(.*\)\nasync def (\w+)", text, re.MULTILINE)


@pytest.fixture(scope="session", params=RUNS)
def simulation(request, tmp_path_factory):
    require(request.param)
    return Simulation(request.param, CONFIGS[RUNS[request.param]], tmp_path_factory.mktemp(request.param))


@pytest.fixture(scope="session")
def outcome(simulation):
    """Of one test; its module runs once."""
    ran = {}

    def of(module, test):
        if module not in ran:
            ran[module] = simulation.run(module)
        found, said = ran[module]
        assert test in found, said[-6000:]
        return found[test], said

    return of


@pytest.mark.parametrize("test", names_in("cocotb_registers"))
def test_registers(outcome, test):
    wrong, said = outcome("cocotb_registers", test)
    assert wrong is None, said


@pytest.mark.parametrize("test", names_in("cocotb_batches"))
def test_batches(outcome, test):
    wrong, said = outcome("cocotb_batches", test)
    assert wrong is None, said
