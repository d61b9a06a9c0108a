"""Verilator's lint of the emitted core, with and without the waivers of sim/verilator.vlt."""

import re

import pytest

from cmfpga.boards import ULX3S
from cmfpga.config import PRESETS, preset
from cmfpga.rtl.axi.top import AxiTop
from cmfpga.rtl.uart.top import UartTop
from cmfpga.verilog.compile import kept_verilog
from cmfpga.verilog.emit import AXI_TOP, UART_TOP
from support.verilog_tools import CONFIGS, emitted, verilator_lint

WAIVED = {"DECLFILENAME", "UNUSEDSIGNAL"}


@pytest.fixture
def waivers(sim_dir):
    return sim_dir / "verilator.vlt"


def test_the_file_waives_these_rules_with_reasons(waivers):
    text = waivers.read_text()
    assert set(re.findall(r"^lint_off -rule (\w+)", text, re.MULTILINE)) == WAIVED
    assert len(re.findall(r"^lint_off", text, re.MULTILINE)) == len(WAIVED)
    assert len(re.findall(r"^//.*\nlint_off", text, re.MULTILINE)) == len(WAIVED)


OTHERS = {
    **{name: preset(name) for name in PRESETS},
    "filtered": preset("fast").replace(hot_pixels=1, background=1),
    "undistorted": preset("fast").replace(undistortion="on", undistortion_frac=6, background=1),
    "undistorted, no dither": preset("paper").replace(undistortion="on", sensor_width=64, sensor_height=65),
}


@pytest.mark.parametrize("name", [*CONFIGS, *OTHERS])
def test_no_warning_beside_them_and_all_are_needed(name, waivers, tmp_path):
    _, text = emitted(CONFIGS.get(name) or OTHERS[name])
    assert verilator_lint(text, tmp_path, "-Wall", waivers) == (0, set())
    assert verilator_lint(text, tmp_path) == (0, set())  # as docs/verification.md says
    status, warnings = verilator_lint(text, tmp_path, "-Wall")
    assert status and warnings == WAIVED


def _serial(config):
    return UartTop(config, clock_hz=ULX3S.clock_hz, baud=ULX3S.baud)


@pytest.mark.parametrize("make, top, name", [
    (AxiTop, AXI_TOP, "fast"), (AxiTop, AXI_TOP, "objects"), (AxiTop, AXI_TOP, "rotation"),
    (AxiTop, AXI_TOP, "sliding"), (_serial, UART_TOP, "fast"),
])  # fmt: skip
def test_tops(make, top, name, waivers, tmp_path):
    text = kept_verilog(make(preset(name)), top)
    assert verilator_lint(text, tmp_path, "-Wall", waivers, top=top) == (0, set())
    assert verilator_lint(text, tmp_path, top=top) == (0, set())


@pytest.mark.parametrize("line, warning", {
    "wire [3:0] cut_off = settings_eta;": "WIDTHTRUNC",
    "wire undriven; assign event_ready = undriven;": "UNDRIVEN",
    "reg stays; always @* if (rst) stays = clk;": "LATCH",
    "assign result_valid = rst;": "MULTIDRIVEN",
}.items())  # fmt: skip
def test_other_warnings_are_not_waived(line, warning, waivers, tmp_path):
    _, text = emitted(CONFIGS["default"])
    _, warnings = verilator_lint(text.replace("endmodule", f"  {line}\nendmodule", 1), tmp_path, "-Wall", waivers)
    assert warning in warnings
