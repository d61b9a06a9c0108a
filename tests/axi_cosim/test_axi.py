"""The emitted AXI top in Verilator and in Icarus, driven by cocotb and cocotbext-axi."""

import functools
import re
from pathlib import Path

import pytest
from simulators import Simulation, require

from cmfpga.config import preset

SMALL = {"sensor_width": 64, "sensor_height": 48, "roi_width": 16, "roi_height": 12, "buffer_events": 128}
CONFIGS = {
    "small fast": preset("fast").replace(**SMALL, max_batch_events=2000),
    # Icarus takes some milliseconds a clock cycle.
    "tiny paper": preset("paper").replace(
        sensor_width=40, sensor_height=30, roi_width=8, roi_height=6, buffer_events=64, max_batch_events=2000,
        iterations=2, max_iterations=7,
    ),
    # The sensor of the Prophesee recording, on which those of the DAVIS fit too.
    "recordings": preset("fast").replace(sensor_width=640, sensor_height=480),
}  # fmt: skip
#: Which configuration each simulator runs.
RUNS = {"verilator": "small fast", "icarus": "tiny paper"}


def names_in(module):
    """Names of a module's cocotb tests; it can only be imported in a simulation."""
    text = (Path(__file__).parent / f"{module}.py").read_text(encoding="utf-8")
    return re.findall(r"^@cocotb\.test\(.*\)\nasync def (\w+)", text, re.MULTILINE)


#: (simulator, module, test).
CASES = [("verilator", module, test) for module in ("cocotb_registers", "cocotb_batches") for test in names_in(module)]
CASES += [("icarus", "cocotb_registers", test) for test in names_in("cocotb_registers")]
CASES += [
    ("icarus", "cocotb_batches", test)
    for test in ("all_formats_under_back_pressure", "ten_batches_back_to_back", "reset_in_traffic")
]


@pytest.fixture(scope="session")
def outcomes(tmp_path_factory):
    """What was wrong in a case, and the log; each simulator is built once, and runs each module once."""

    @functools.cache
    def simulation(simulator):
        require(simulator)
        return Simulation(simulator, CONFIGS[RUNS[simulator]], tmp_path_factory.mktemp(simulator))

    @functools.cache
    def run(simulator, module):
        return simulation(simulator).run(
            module, [test for case in CASES if case[:2] == (simulator, module) for test in case[2:]]
        )

    def outcome(simulator, module, test):
        found, said = run(simulator, module)
        assert test in found, said[-6000:]
        return found[test], said

    return outcome


@pytest.mark.parametrize("simulator, module, test", CASES, ids="-".join)
def test_in_simulation(outcomes, simulator, module, test):
    wrong, said = outcomes(simulator, module, test)
    assert wrong is None, said


@pytest.fixture(scope="session")
def recordings(data_dir, tmp_path_factory):
    require("verilator")
    simulation = Simulation("verilator", CONFIGS["recordings"], tmp_path_factory.mktemp("recordings"))
    return simulation.run("cocotb_recordings", names_in("cocotb_recordings"), CMFPGA_DATA=str(data_dir.resolve()))


@pytest.mark.slow
@pytest.mark.parametrize("test", names_in("cocotb_recordings"))
def test_recordings(recordings, test):
    found, said = recordings
    assert found.get(test, "did not run") is None, said
