"""The KV260 platform: what Amaranth makes of it, as far as that goes without Vivado."""

import pytest
from amaranth.hdl import ClockDomain, Module
from amaranth.lib import io, wiring
from amaranth.lib.wiring import In

from support.board_files import BOARD, load


@pytest.fixture(scope="module")
def platform_class():
    return load("platform").KV260Platform


class Driver(wiring.Component):
    """Pins of the board, counting, so that there is a clock."""

    def __init__(self, resource):
        super().__init__({"clk": In(1)})
        self.resource = resource

    def elaborate(self, platform):
        m = Module()
        m.domains.sync = domain = ClockDomain(reset_less=True)
        m.d.comb += domain.clk.eq(self.clk)
        m.submodules.pins = pins = io.Buffer("o", platform.request(self.resource, dir="-"))
        m.d.sync += pins.o.eq(pins.o + 1)
        return m


def constraints_of(platform_class, resource):
    plan = platform_class(toolchain="Vivado").prepare(Driver(resource), "made")
    return {name: text if isinstance(text, str) else text.decode() for name, text in plan.files.items()}


def test_part(platform_class):
    platform = platform_class(toolchain="Vivado")
    assert platform.part == "xck26-sfvc784-2LV-c" == platform._part
    assert platform.family == "ultrascaleplus"
    assert platform_class.default_clk is None  # there is none without the processing system
    text = (BOARD / "README.md").read_text(encoding="utf-8")
    assert platform_class.part in text and platform_class.board_part in text


def test_the_fan(platform_class, long_tools):
    files = constraints_of(platform_class, "fan")
    assert "-part xck26-sfvc784-2LV-c" in files["made.tcl"]
    constraints = files["made.xdc"]
    assert "set_property LOC A12" in constraints
    for name, value in (("IOSTANDARD", "LVCMOS33"), ("SLEW", "SLOW"), ("DRIVE", "4")):
        assert f'set_property {name} "{value}" ' in constraints
    assert "create_clock" not in constraints  # the processing system's clocks are constrained by the block design


def test_pmod(platform_class, long_tools):
    constraints = constraints_of(platform_class, "pmod_gpio")["made.xdc"]
    for pin in ("H12", "E10", "D10", "C11"):
        assert f"set_property LOC {pin} " in constraints
    assert constraints.count('set_property IOSTANDARD "LVCMOS33"') == 4
