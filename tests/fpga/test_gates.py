"""Gates that go into the adders behind them: what a netlist does stays the same."""

from copy import deepcopy

import pytest
from amaranth.back import verilog
from amaranth.hdl import Cat, Const, Elaboratable, Module, Signal

from cmfpga.fpga.gates import pack_gates
from cmfpga.fpga.tools import yosys
from support.ecp5_cells import adder, cell, difference

XOR, XNOR, AND = "0110" * 4, "1001" * 4, "1000" * 4


def added(table, reads=(), **wires):
    """Nets 10 and 20 ⊕ 21, or what the table says, are added to 30; others may read that, too."""
    cells = {"it": adder(**{"A0": 10, "B0": 25, "S0": 30, "COUT": 31} | wires)}
    cells["gate"] = cell("LUT4", {"INIT": table}, A=20, B=21, C="0", D="0", Z=25)
    return {"ports": {"o": {"bits": [30, *reads]}}, "cells": cells}


def outputs(module):
    for each in module["cells"].values():
        each["port_directions"]["Z" if each["type"] == "LUT4" else "S0"] = "output"
    return module


@pytest.mark.parametrize("carry", ["0", "1"])
@pytest.mark.parametrize(("table", "packed"), [(XOR, 1), (XNOR, 1), (AND, 0)])
def test_an_addend_that_is_inverted(table, packed, carry):
    module = outputs(added(table, C0=carry, CIN=40))
    before = deepcopy(module)
    assert pack_gates(module) == packed
    assert difference(before, module, 64) is None


@pytest.mark.parametrize(
    ("reads", "wires"),
    [([25], {}), ([], {"C0": 50}), ([], {"D0": "0"}), ([], {"B0": 26, "A0": 25})],
    ids=["read by others", "three addends", "another table", "the other addend"],
)
def test_what_stays(reads, wires):
    module = outputs(added(XOR, reads, **wires))
    before = deepcopy(module)
    assert pack_gates(module) == 0 and module == before


class Division(Elaboratable):
    """A division that does not restore: it adds or subtracts, by its own sign."""

    def __init__(self):
        self.by, self.rest = Signal(9), Signal(12)

    def elaborate(self, platform):
        m = Module()
        down = ~self.rest[-1]
        by = Cat(down, self.by ^ down.replicate(9), down.replicate(3))
        m.d.sync += self.rest.eq((Cat(Const(1, 1), self.rest) + by)[1:])
        return m


def test_a_division_by_yosys():
    division = Division()
    text = verilog.convert(division, ports=[division.by, division.rest], name="top")
    (netlist,) = yosys("read_verilog core.v\nsynth_ecp5 -top top\nwrite_json 0.json\n", text, ["yosys"], lambda _: None)
    module = netlist["modules"]["top"]
    before = deepcopy(module)
    assert pack_gates(module) >= 9
    assert difference(before, module, 200) is None
