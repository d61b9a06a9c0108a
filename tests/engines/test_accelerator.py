"""The accelerator as an engine of ``track``."""

import contextlib
import csv

import numpy as np
import pytest

import cmfpga
from cmfpga import cli
from cmfpga.cli import track
from cmfpga.config import preset
from cmfpga.engines import make_engine
from cmfpga.errors import ConfigError
from cmfpga.events import Events, generate
from cmfpga.protocol.results import BatchResult
from cmfpga.protocol.settings import BatchSettings
from cmfpga.tracking.columns import COLUMNS
from cmfpga.tracking.kept import Kept
from cmfpga.verilog import compiler
from support.driving import CONFIG


@pytest.mark.usefixtures("compiler")
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
    core, schedules = Core(preset("fast")), preset("fast").schedules
    for k, (a, b) in enumerate(zip(rows["axi"], rows["model"], strict=True)):
        counts = {name: int(a[name]) for name in ("events", "roi_events")}
        plan = schedules.warm if k else schedules.cold
        assert a == b | {"iterations": str(len(plan)), "cycles": str(core.cycles(**counts, iterations=plan))}
    assert len(rows["axi"]) == 4 and "axi engine" in capsys.readouterr().out


@pytest.mark.usefixtures("compiler")
def test_what_a_result_without_a_trace_shows(tmp_path, capsys):
    """The arrays and the report, but for the path of v; what is nothing without a trace is refused."""
    scene, options = generate(**track.DEMO_SCENE), {"preset": "fast", "batch_events": 1640, "batches": 3}
    found, expected = (cmfpga.track(scene, engine=engine, **options) for engine in ("axi", "model"))
    for name in COLUMNS:
        if name != "cycles":
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert all(isinstance(result, BatchResult) and result.trace is None for result in found.results)
    with pytest.raises(ConfigError, match=r"^trace: the axi engine gives only results; rtl, model or float is needed$"):
        found.trace(1)

    arguments = ["--engine", "axi", "--batch-events", "1640", "--batches", "3", "--out", str(tmp_path), "--no-picture"]
    assert cli.run(track.main, [*arguments, "--report"]) == 0
    kept = Kept.load(tmp_path / "track.npz")
    assert [detail.v.tolist() for detail in kept.details] == [[list(result.v)] for result in found.results]
    assert [len(detail.levels) for detail in kept.details] == expected.iterations.tolist()
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "the axi engine does not tell the path to it." in page and "from the ring to the star" not in page
    capsys.readouterr()
    assert cli.run(track.main, [*arguments, "--wave", "0"]) == 2
    assert capsys.readouterr().err == (
        "error: --wave: the axi engine gives only results, and a trace is needed: take rtl or model\n"
    )


@pytest.mark.usefixtures("compiler")
def test_an_empty_batch_has_no_trace_either():
    with contextlib.closing(make_engine("axi", preset("fast"))) as engine:
        result = engine.run(Events.empty(), BatchSettings.from_config(engine.config, (3, 4)))[0]
    assert isinstance(result, BatchResult) and result.trace is None and result.roi_next == (3, 4)


def test_without_a_compiler(monkeypatch, capsys):
    monkeypatch.setattr(compiler.shutil, "which", lambda name: None)
    with pytest.raises(ConfigError, match=r"no C\+\+ compiler found, .*: one of c\+\+, g\+\+, clang\+\+ is needed"):
        make_engine("axi", CONFIG.replace(buffer_events=33))
    assert cli.run(track.main, ["--engine", "axi", "--set", "buffer_events=33", "--batches", "1"]) == 2
    note, error = capsys.readouterr().err.splitlines()
    assert note.startswith("note: in batches: engine axi") and error.startswith("error: no C++ compiler")
