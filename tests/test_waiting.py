"""What a terminal shows while something takes seconds; other outputs show nothing."""

import contextlib
import io
import time

import pytest
from tqdm import tqdm

from cmfpga import waiting
from cmfpga.cli import build, flow, generate, info, track
from cmfpga.errors import ConfigError
from support.building import TINY_SETS


@pytest.fixture(autouse=True)
def _impatient(monkeypatch):
    monkeypatch.setattr(waiting, "_TICK_S", 0.01)


@contextlib.contextmanager
def output(terminal=True):
    """Standard error."""
    shown = io.StringIO()
    shown.isatty = lambda: terminal
    with contextlib.redirect_stderr(shown):
        yield shown


def test_its_clock_runs_and_it_leaves_nothing():
    with output() as shown, waiting.waiting("Resting", total=2) as bar:
        time.sleep(0.2)
        bar.update()
        time.sleep(0.2)
    lines = shown.getvalue().split("\r")
    assert sum("Resting:   0%" in line for line in lines) > 2 and sum("Resting:  50%" in line for line in lines) > 2
    assert not lines[-1].strip()


def test_nothing_is_shown_of_short_work_and_on_other_outputs(monkeypatch):
    with output(terminal=False) as shown, waiting.waiting("Resting"):
        time.sleep(0.1)
    assert shown.getvalue() == ""
    monkeypatch.setattr(waiting, "_TICK_S", 5)
    with output() as shown, waiting.waiting("Resting"):
        pass
    assert not shown.getvalue().strip()


def test_build_and_track(dot, small, tmp_path, monkeypatch):
    monkeypatch.setattr(waiting, "tqdm", lambda **options: tqdm(**{**options, "delay": 0}))  # at once
    with output() as shown:
        assert build.main([*TINY_SETS, "--json", "--out", str(tmp_path)]) == 0
        options = ["--engine", "model", "--batch-events", "90", "--batches", "1", "--out", str(tmp_path)]
        assert track.main([str(dot), "--roi", "8,9", *options, *map(str, small)]) == 0
        assert info.main([str(dot), *map(str, small)]) == 0
        assert generate.main([str(tmp_path / "a.h5"), "--duration-us", "9000"]) == 0
        assert flow.main([str(tmp_path / "a.h5"), "--engine", "float", "--no-picture", "--out", str(tmp_path)]) == 0
        with pytest.raises(ConfigError, match="nothing moves clearly"):
            track.main([str(dot), "--roi", "auto", *map(str, small)])
    for doing in (
        "Emitting the Verilog", "Looking for motion", "Looking for noise", "Opening the engine", "Making the events",
        "Writing the files",
    ):  # fmt: skip
        assert f"\r{doing}: 00:00" in shown.getvalue()
    assert "\rWriting the scenes: " in shown.getvalue()
