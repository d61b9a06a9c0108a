"""The accelerator as an engine of ``track``."""

import csv

import pytest

from cmfpga import cli, track
from cmfpga.engines import ENGINES, make_engine, rtl
from cmfpga.errors import ConfigError
from support.driving import CONFIG


@pytest.mark.skipif(rtl.find_compiler() is None, reason="no C++ compiler to compile the Verilog with: install g++")
def test_track_by_the_axi_top(tmp_path, capsys):
    """The same file as from the model, but for the cycles, which the core's formula gives."""
    from cmfpga.rtl.core import Core

    rows = {}
    for engine in ("axi", "model"):
        folder = tmp_path / engine
        arguments = ["--engine", engine, "--preset", "fast", "--batches", "4", "--out", str(folder)]
        assert cli.run(track.main, [*arguments, *(["--no-picture"] if engine == "model" else [])]) == 0
        with (folder / "track.csv").open() as file:
            rows[engine] = list(csv.DictReader(file))
    assert (tmp_path / "axi" / "track.png").stat().st_size > 20_000
    core = Core(cli.preset("fast"))
    for a, b in zip(rows["axi"], rows["model"], strict=True):
        counts = {name: int(a[name]) for name in ("events", "roi_events", "iterations")}
        assert a == b | {"cycles": str(core.cycles(**counts))}
    assert len(rows["axi"]) == 4 and "axi engine" in capsys.readouterr().out


def test_without_a_compiler(monkeypatch, capsys):
    monkeypatch.setattr(rtl.shutil, "which", lambda name: None)
    with pytest.raises(ConfigError, match=r"no C\+\+ compiler found, .*: one of c\+\+, g\+\+, clang\+\+ is needed"):
        make_engine("axi", CONFIG.replace(buffer_events=33))
    assert cli.run(track.main, ["--engine", "axi", "--set", "buffer_events=33", "--batches", "1"]) == 2
    assert capsys.readouterr().err.startswith("error: no C++ compiler")


def test_unknown_engines_are_refused():
    with pytest.raises(ConfigError, match="engine 'gpu': one of rtl, model, float, axi is needed"):
        make_engine("gpu", CONFIG)
    assert "axi" not in ENGINES  # the others have a trace
