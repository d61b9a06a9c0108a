"""The emitted AXI top in Verilator and in Icarus, driven by cocotb and cocotbext-axi."""

import re
from pathlib import Path

import pytest

from cmfpga.config import preset
from support.axi.simulators import Simulation, require

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
REGISTERS, BATCHES, RECORDINGS = "cocotb_registers", "cocotb_batches", "cocotb_recordings"
#: Of the batches; all of them would take many minutes.
ON_ICARUS = ["all_formats_under_back_pressure", "ten_batches_back_to_back", "reset_in_traffic"]


def names_in(module):
    """Names of a module's cocotb tests; it can only be imported in a simulation."""
    text = (Path(__file__).parents[1] / "support" / "axi" / f"{module}.py").read_text(encoding="utf-8")
    return re.findall(r"^@cocotb\.test\(.*\)\nasync def (\w+)", text, re.MULTILINE)


def check(simulation, module, tests, **environment):
    """All of ``tests`` ran and passed. One pytest item runs many, because each process would compile anew."""
    assert len(tests) >= 3 and set(tests) <= set(names_in(module))
    found, said = simulation.run(module, tests, **environment)
    wrong = {test: found.get(test, "did not run") for test in tests if found.get(test, "did not run") is not None}
    assert not wrong, f"{', '.join(wrong)}\n{said[-20000:]}"


def test_in_verilator(tmp_path):
    require("verilator")
    simulation = Simulation("verilator", CONFIGS[RUNS["verilator"]], tmp_path)
    check(simulation, REGISTERS, names_in(REGISTERS))
    check(simulation, BATCHES, names_in(BATCHES))


@pytest.mark.parametrize(
    "module, tests",
    [(REGISTERS, names_in(REGISTERS)), pytest.param(BATCHES, ON_ICARUS, marks=pytest.mark.slow)],
    ids=[REGISTERS, BATCHES],
)
def test_in_icarus(module, tests, tmp_path):
    require("icarus")
    check(Simulation("icarus", CONFIGS[RUNS["icarus"]], tmp_path), module, tests)


@pytest.mark.slow
def test_recordings(data_dir, tmp_path):
    require("verilator")
    simulation = Simulation("verilator", CONFIGS["recordings"], tmp_path)
    check(simulation, RECORDINGS, names_in(RECORDINGS), CMFPGA_DATA=str(data_dir.resolve()))
