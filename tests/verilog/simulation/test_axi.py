"""The emitted AXI top in Verilator and in Icarus, driven by cocotb and cocotbext-axi."""

import re
from pathlib import Path

import pytest

from cmfpga.config import preset
from support.axi.simulators import require, simulate

SMALL = {"sensor_width": 64, "sensor_height": 48, "roi_width": 16, "roi_height": 12, "buffer_events": 128}
CONFIGS = {
    "small fast": preset("fast").replace(**SMALL, max_batch_events=2000),
    # Icarus takes some milliseconds a clock cycle.
    "tiny paper": preset("paper").replace(
        sensor_width=40, sensor_height=30, roi_width=8, roi_height=6, buffer_events=64, max_batch_events=2000,
        iterations=2, max_iterations=7,
    ),
    "small similarity": preset("similarity").replace(**SMALL, max_batch_events=2000),
    "small rotation": preset("rotation").replace(
        **SMALL | {"roi_width": 64, "roi_height": 48}, max_batch_events=2000, ram_style="auto",
        camera="70,70,31,22,-0.2,0,0,0",
    ),
}  # fmt: skip
REGISTERS, BATCHES = "cocotb_registers", "cocotb_batches"
#: Stalls on every channel, a reset in the middle of a packet. All of the batches would take many minutes.
SOME = {BATCHES: ["all_formats_under_back_pressure", "reset_in_traffic"]}


def names_in(module):
    """Names of a module's cocotb tests; it can only be imported in a simulation."""
    text = (Path(__file__).parents[2] / "support" / "axi" / f"{module}.py").read_text(encoding="utf-8")
    return re.findall(r"^@cocotb\.test\(.*\)\nasync def (\w+)", text, re.MULTILINE)


def check(simulator, config, tests, folder):
    """All of ``tests`` ran and passed. One pytest item runs many, because each process would compile anew."""
    require(simulator)
    for module, names in tests.items():
        known = names_in(module)
        assert len(known) >= 3 and names and set(names) <= set(known)
    found, said = simulate(simulator, CONFIGS[config], tests, folder)
    asked = [test for names in tests.values() for test in names]
    assert len({*asked}) == len(asked)
    wrong = {test: found.get(test, "did not run") for test in asked if found.get(test, "did not run") is not None}
    assert not wrong, f"{', '.join(wrong)}\n{said[-20000:]}"


def test_in_verilator(tmp_path):
    check("verilator", "small fast", {module: names_in(module) for module in (REGISTERS, BATCHES)}, tmp_path)


@pytest.mark.parametrize("motion", ["similarity", "rotation"])
def test_motions_in_verilator(motion, tmp_path):
    check("verilator", f"small {motion}", SOME, tmp_path)


@pytest.mark.parametrize("tests", [{REGISTERS: names_in(REGISTERS)}, SOME], ids=[REGISTERS, BATCHES])
def test_in_icarus(tests, tmp_path):
    check("icarus", "tiny paper", tests, tmp_path)
