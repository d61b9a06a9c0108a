"""``python -m studies.accuracy``: what it prints, and what it refuses."""

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.engines import make_engine
from studies.accuracy import bias, large, real, studies, suites, table

FAST = preset("fast")


def test_command(written, capsys):
    found = written("--batches", 4)
    shown = capsys.readouterr()
    assert "Synthetic batches: error of v, px per half batch" in shown.out and "| model  " in shown.out
    assert "synthetic batches only" in shown.err
    assert found["config"] == FAST.to_dict()
    cold = found["results"]["synthetic, cold, model"]
    assert len(cold["values"]) == cold["scores"]["batches"] == 4
    assert cold["scores"]["median_px"] == pytest.approx(np.median(cold["values"]))


@pytest.mark.parametrize("study", sorted({*studies.STUDIES} - {*studies.OF_RECORDINGS}))
def test_studies(study, run, capsys, monkeypatch):
    monkeypatch.setattr(studies, "PLAIN_ETAS", (2.0,))
    monkeypatch.setattr(bias, "SPEEDS", (4.0,))
    monkeypatch.setattr(bias, "BATCHES", 1)
    monkeypatch.setattr(large, "SENSORS", ((240, 180, 0.5),))
    monkeypatch.setattr(large, "FIELDS", {"turn": large.FIELDS["turn"]})
    assert run("--study", study, "--batches", 2) == 0
    out = capsys.readouterr().out
    assert "px" in out and out.count("\n| ") >= 3


def test_all_suites_by_two_engines(run, capsys, data_dir, monkeypatch):
    monkeypatch.setattr(suites, "ENGINES", ("rtl", "float", "model"))
    monkeypatch.setattr(table, "make_engine", lambda name, config: make_engine("model", config))
    monkeypatch.setattr(real, "WINDOWS", real.WINDOWS[1:2])
    assert run("--engine", "all", "--batches", 3, "--data", data_dir) == 0
    out = capsys.readouterr().out
    assert "Real batches" in out and "Checkerboard, tracked" in out
    assert "real: rtl and model agree exactly in 5 of 5 batches" in out
    assert "track: rtl and model agree exactly in 10 of 10 batches" in out


def test_real_batches_run_with_the_configuration_as_it_is(written, capsys, data_dir, monkeypatch):
    """No larger buffer in secret: in the suites, in a study, and in what the bench prints of them."""
    monkeypatch.setattr(real, "WINDOWS", real.WINDOWS[1:2])  # five batches
    events = [case.facts["roi_events"] for case in real.real_cases(data_dir)]
    assert max(events) > FAST.buffer_events
    drop = ("--set", "when_full=drop")
    found = written("--batches", 1, "--data", data_dir, *drop)["results"]["real, model"]
    dropped = [max(0, n - FAST.buffer_events) for n in events]
    assert [int(row[2]) for row in found["values"]] == dropped
    assert found["scores"]["batches_that_drop_events"] == np.count_nonzero(dropped)
    assert "batches that drop events" in capsys.readouterr().out
    monkeypatch.setattr(studies, "WIDTHS", studies.WIDTHS[2:3])  # those of the preset
    studied = written("--study", "widths", "--batches", 1, "--data", data_dir, *drop)["results"]
    assert studied["real, widths 8, 6, 4, 4, 4, 4"] == found
    monkeypatch.setattr(suites, "preset", lambda name: preset(name).replace(when_full="drop"))
    told = suites.brief("model", data=data_dir, batches=1)
    assert told["scores"]["real, cold"] == found["scores"]
    assert told["text"][-1].endswith(f"; {np.count_nonzero(dropped)} drop events")


def test_seeds_make_other_batches(written):
    suite = "synthetic, cold, model"
    found = [written("--batches", 2, "--seeds", seeds)["results"][suite]["values"] for seeds in ("1", "2", "1-2")]
    assert found[0] + found[1] == found[2] and found[0] != found[1]


def test_a_difference_between_rtl_and_model_is_said(capsys):
    suites.compare_with_model({("rtl", "cold"): np.array([1.0, 2.0]), ("model", "cold"): np.array([1.0, 2.5])})
    assert capsys.readouterr().out == "cold: rtl and model agree exactly in 1 of 2 batches\n"


ALONE = "{}: --study, --known and --engine all go without it"
ONE = "--motion, --flow, --moving: one of them at a time"


@pytest.mark.parametrize(("arguments", "message"), [
    *(([*suite, *more], ALONE.format(suite[0]))
      for suite in (["--flow"], ["--motion", "rotation"])
      for more in (["--known"], ["--engine", "all"], ["--study", "plain"])),
    (["--moving", "--study", "plain"], ALONE.format("--moving")),
    (["--flow", "--motion", "rotation"], ONE),
    (["--moving", "--flow"], ONE),
    (["--moving", "--preset", "paper"], "--moving: ascent = constant: rounds are needed, as of preset quad"),
    (["--motion", "rotation", "--preset", "similarity"],
     "--motion rotation: --preset rotation is needed, not motion = similarity"),
    *((["--study", study, "--batches", "1"], f"--study {study}: --data, a folder of recordings, is needed")
      for study in ("slider", "auto")),
    (["--data", "nowhere"], "--data nowhere: no such folder"),
    (["--seeds", "3-1"], "argument --seeds: '3-1': one seed, or the first and the last as in 1-3, is needed"),
    (["--seeds", "x"], "argument --seeds: 'x': one seed, or the first and the last as in 1-3, is needed"),
    (["--batches", "0"], "argument --batches: '0': a whole number of 1 or more is needed"),
    (["--set", "roi_width=32"], "ROI of 32×64 px: the suites are for 64×64 px"),
    (["--study", "magic"], "argument --study: invalid choice: 'magic'"),
    (["--study", "schedules", "--preset", "paper"], "ascent = 'constant': schedules belong to ascent = newton"),
    (["--json", "no/such/folder/scores.json"], "no/such/folder/scores.json: No such file or directory"),
])  # fmt: skip
def test_mistakes_get_one_line(arguments, message, run, capsys):
    assert run(*arguments) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith(f"error: {message}")
