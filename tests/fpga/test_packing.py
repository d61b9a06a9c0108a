"""Registers of an ECP5's netlist that go into RAMs and multipliers, or behind them."""

import json
from copy import deepcopy

import pytest

from cmfpga.fpga.packing import pack_registers
from support.ecp5_cells import cell, difference, register, twice_waiting


def packable(kind="MULT18X18D", sinks=(), **changes):
    """Two outputs of a RAM or multiplier, each in front of a register; ``sinks`` of the first beside that.

    ``changes``: of the second register.
    """
    output, clock = {"MULT18X18D": ("P", {}), "DP16KD": ("DOB", {"CLKB": 2})}[kind]
    cells = {"it": cell(kind, **{f"{output}0": 10, f"{output}1": 11}, **clock)}
    for k, own in enumerate(({}, changes)):
        found = {"CEMUX": "1 ", "CLKMUX": "CLK", "REGSET": "RESET", "SRMODE": "LSR_OVER_CE"}
        wires = {"CLK": 2, "DI": 10 + k, "LSR": 3, "Q": 20 + k}
        for name, value in own.items():
            (found if name in found else wires)[name] = value
        cells[f"register_{k}"] = cell("TRELLIS_FF", found, **wires)
    cells |= {name: cell("LUT4", A=bit) for name, bit in sinks}
    return {"cells": cells, "ports": {"o": {"bits": [20, 21]}}}


def test_registers_are_packed():
    module = packable()
    assert pack_registers(module) == 2
    (it,) = module["cells"].values()
    assert it["connections"] == {"P0": [20], "P1": [21], "CLK0": [2], "CE0": ["1"], "RST0": [3]}
    assert it["parameters"]["REG_OUTPUT_CLK"] == "CLK0" and it["parameters"]["RESETMODE"] == "SYNC"
    module = packable("DP16KD", LSR="0")
    module["cells"]["register_0"]["connections"]["LSR"] = ["0"]
    assert pack_registers(module) == 2
    assert module["cells"]["it"]["connections"] == {"DOB0": [20], "DOB1": [21], "CLKB": [2], "OCEB": ["1"]}
    assert module["cells"]["it"]["parameters"] == {"REGMODE_B": "OUTREG"}


@pytest.mark.parametrize(("width", "packed"), [("100100", 2), ("010010", 0)])
def test_a_wide_ram_is_read_by_both_ports(width, packed):
    module = packable("DP16KD", LSR="0")
    module["cells"]["register_0"]["connections"]["LSR"] = ["0"]
    it = module["cells"]["it"]
    it["parameters"]["DATA_WIDTH_B"] = width
    for part in ("connections", "port_directions"):
        it[part]["DOA0"] = it[part].pop("DOB0")
    assert pack_registers(module) == packed
    if packed:
        assert it["connections"] == {"DOA0": [20], "DOB1": [21], "CLKB": [2], "OCEB": ["1"]}
        assert {name: mode for name, mode in it["parameters"].items() if name.startswith("REGMODE")} == {
            "REGMODE_A": "OUTREG", "REGMODE_B": "OUTREG",
        }  # fmt: skip


@pytest.mark.parametrize(("kind", "pin"), [("MULT18X18D", "CE0"), ("DP16KD", "OCEB")])
def test_registers_with_an_enable_are_packed(kind, pin):
    module = packable(kind)
    for number in range(2):
        register = module["cells"][f"register_{number}"]
        register["parameters"]["CEMUX"] = "CE"
        register["connections"] |= {"CE": [4], "LSR": ["0"]}
        register["port_directions"]["CE"] = "input"
    assert pack_registers(module) == 2 and module["cells"]["it"]["connections"][pin] == [4]


def waiting(other=None, **changes):
    """A multiplier, one factor of which comes through two registers in a row; ``other`` reads the second."""
    cells = {"it": cell("MULT18X18D", A0=11, A1="0", B0=12, P0=30), "lut": cell("LUT4", A=8, Z=12)}
    cells |= {"first": register(9, 10), "second": register(10, 11, **changes)}
    if other:
        cells["other"] = cell("LUT4", A=other, Z=40)
    return {"ports": {"o": {"bits": [30, 40]}}, "cells": cells}


@pytest.mark.parametrize("other", [None, 11])
def test_a_factor_that_waits_is_packed(other):
    """Where another cell reads it, too, its register stays, but not for the multiplier."""
    module = waiting(other)
    assert pack_registers(module) == (0 if other else 1) and ("second" in module["cells"]) == bool(other)
    it = module["cells"]["it"]
    wanted = {"A0": [10], "A1": ["0"], "B0": [12], "P0": [30], "CLK0": [2], "CE0": [4], "RST0": ["0"]}
    assert it["connections"] == wanted
    assert {name for name in it["parameters"] if name.endswith("_CLK")} == {"REG_INPUTA_CLK"}


def test_each_register_of_a_multiplier_has_its_own_enable():
    """One without an enable, one with, and behind both the product with another."""
    cells = {"it": cell("MULT18X18D", A0=11, B0=21, P0=30), "product": register(30, 31)}
    cells |= {"a": register(10, 11, CEMUX="1"), "b": register(20, 21)}
    cells["product"]["connections"]["CE"] = [5]
    cells |= {f"lut_{net}": cell("LUT4", {"INIT": "10" * 8}, A=net - 1, Z=net) for net in (10, 20)}
    module = {"ports": {"o": {"bits": [31]}}, "cells": cells}
    before = deepcopy(module)
    assert pack_registers(module) == 3 and difference(before, module) is None
    it = module["cells"]["it"]
    assert [it["parameters"][f"REG_{name}_CE"] for name in ("OUTPUT", "INPUTA", "INPUTB")] == ["CE0", "CE1", "CE2"]
    assert [it["connections"][f"CE{k}"] for k in range(3)] == [[5], ["1"], [4]]


def test_a_factor_that_cannot_wait_inside_stays():
    """A register that starts at one; one behind logic; a multiplier whose registers have another clock."""
    kept = [waiting(REGSET="SET"), waiting(), waiting(), waiting()]
    kept[1]["cells"]["first"]["type"] = "LUT4"
    kept[2]["cells"]["it"]["connections"] |= {"CLK0": [3], "CE0": ["1"], "RST0": ["0"]}
    kept[2]["cells"]["it"]["port_directions"] |= dict.fromkeys(("CLK0", "CE0", "RST0"), "input")
    kept[3]["cells"]["it"]["connections"]["A1"] = ["1"]
    for module in kept:
        before = json.dumps(module)
        assert pack_registers(module) == 0 and json.dumps(module) == before


@pytest.mark.parametrize(("before", "packed"), [("TRELLIS_FF", 2), ("LUT4", 2), ("L6MUX21", 2), ("DP16KD", 0)])
def test_a_factor_from_an_adder_is_packed_where_the_other_is(before, packed):
    module = waiting()
    cells = module["cells"]
    cells["first"] = cell("CCU2C", A0=9, S0=10)
    cells["lut"] = register(13, 12)
    cells["before"] = cell(before, **{"Q" if before == "TRELLIS_FF" else "Z": 13})
    assert pack_registers(module) == packed
    if packed:
        assert (cells["it"]["connections"]["A0"], cells["it"]["connections"]["B0"]) == ([10], [13])


def test_the_product_waits_in_place_of_its_factors():
    module = twice_waiting()
    cells, before = module["cells"], deepcopy(module)
    assert pack_registers(module) == 7 - 3  # the first ones stay; one is new
    assert difference(before, module) is None
    wires = cells["it"]["connections"]
    assert (wires["A0"], wires["A1"], wires["B0"]) == ([11], ["0"], [21])
    ((name, new),) = ((name, each) for name, each in cells.items() if name.startswith("it_"))
    assert new["connections"] == {"CLK": [2], "CE": [4], "DI": wires["P0"], "Q": [31]}
    assert wires["P0"][0] not in (30, 31)
    assert new["type"] == "TRELLIS_FF" and {*cells} == {"it", name, "register_10", "register_20"}


def test_two_multipliers_along_one_row_of_registers():
    """The last register has no reader but a multiplier, and the one before none but that and another multiplier."""
    module = twice_waiting()
    module["cells"]["other"] = cell("MULT18X18D", A0=12, B0=22, P0=40)
    module["ports"]["o"]["bits"].append(40)
    before = deepcopy(module)
    pack_registers(module)
    assert difference(before, module) is None
    wires = module["cells"]["other"]["connections"]
    assert (wires["A0"], wires["B0"]) == ([11], [21])
    assert {name for name in module["cells"] if name.startswith("register")} == {"register_10", "register_20"}


@pytest.mark.parametrize("why", ["start at one", "logic before", "only one factor"])
def test_factors_that_wait_otherwise_do_so_themselves(why):
    module = twice_waiting(**({"REGSET": "SET"} if why == "start at one" else {}))
    if why == "logic before":
        module["cells"]["register_20"]["type"] = "LUT4"
    if why == "only one factor":
        module["cells"]["register_21"]["connections"]["CE"] = [5]
    pack_registers(module)
    assert module["cells"]["it"]["connections"]["P0"] == [31] and not any("behind" in name for name in module["cells"])


@pytest.mark.parametrize("module", [
    packable("DP16KD"), packable(sinks=[("lut", 10)]), packable(CEMUX="CE", CE=4), packable(CLKMUX="INV"),
    packable(REGSET="SET"), packable(SRMODE="ASYNC"), packable(LSR=4), packable(LSR="0"), packable(CLK=5),
    packable(DI=9, M=11), {**packable(), "ports": {"o": {"bits": [10]}}},
])  # fmt: skip
def test_what_a_register_inside_cannot_do_stays_outside(module):
    """A RAM's reset, another reader, an enable, another edge, a start at one, two resets, two clocks, another pin."""
    before = json.dumps(module)
    assert pack_registers(module) == 0 and json.dumps(module) == before
