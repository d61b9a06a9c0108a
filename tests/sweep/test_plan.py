"""What a sweep is made of: configurations, recordings with their ROI and truth, keys, and what is kept."""

import dataclasses
import json
import os
from pathlib import Path
from unittest.mock import Mock

import h5py
import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.errors import ConfigError, RecordingError
from cmfpga.forms import Text
from cmfpga.sweep import task
from cmfpga.sweep.plan import Subject, choices, rows, subjects
from cmfpga.sweep.task import Run, Task, run_task, version
from cmfpga.truth import pieces, read_truth, sidecar
from support.sweeping import make_recording, run_here, small


def test_all_combinations_the_last_field_fastest():
    found, _ = choices("paper", ["eta=2"], ["iterations=5,10", "roi_gain=1,2"])
    varied = [{"iterations": t, "roi_gain": gain} for t in (5, 10) for gain in (1.0, 2.0)]
    assert [choice.varied for choice in found] == varied
    assert [choice.number for choice in found] == [0, 1, 2, 3]
    assert found[1].changes == {"eta": 2.0, "iterations": 5, "roi_gain": 2.0}
    assert found[1].label == "iterations = 5, roi_gain = 2.0"


def test_presets_vary_too_and_schedules_keep_their_blanks():
    found, skipped = choices("paper", [], ["preset=fast,paper,full-frame", "cold=0:1:1*8,1:1:1*4 0:1:1*4"])
    assert [choice.preset for choice in found] == ["fast", "fast", "full-frame", "full-frame"]
    assert [choice.number for choice in found] == [0, 1, 2, 3]
    unread = "cold = '{}': ascent = newton is needed; ascent = constant ignores it"
    assert skipped == [unread.format(schedule) for schedule in ("0:1:1*8", "1:1:1*4 0:1:1*4")]
    subject = Subject(name="x", path=Path("x"), roi=None)
    assert found[1].fields(subject) == preset("fast").to_dict() | {"cold": "1:1:1*4 0:1:1*4"}
    (only,), _ = choices("fast", [], [])
    wide = preset("fast").replace(sensor_width=640, sensor_height=480).to_dict()
    assert only.fields(dataclasses.replace(subject, sensor=(640, 480))) == wide and only.label == "as given"


@pytest.mark.parametrize("fixed, varied, message", [
    ([], ["eta"], "--vary eta: FIELD=VALUE,VALUE,… is needed"),
    ([], ["eta="], "--vary eta=: FIELD=VALUE,VALUE,… is needed"),
    ([], ["eta=1,x"], "eta = 'x': a number is needed"),
    ([], ["eta=1,"], "eta = '': a number is needed"),
    ([], ["preset=quick"], "preset 'quick': one of paper, fast, .* is needed"),
    ([], ["eta=1,1.0"], "--vary eta=1,1.0: 1.0 stands twice"),
    ([], ["eta=1", "eta=2"], "--vary eta=2: eta is set twice"),
    (["eta=1"], ["eta=2"], "--vary eta=2: eta is set twice"),
    (["ascent=newton"], ["eta=2,3"], "eta = 2.0: ascent = constant is needed; ascent = newton ignores it"),
])  # fmt: skip
def test_what_cannot_vary(fixed, varied, message):
    with pytest.raises(ConfigError, match=f"^{message}$"):
        choices("paper", fixed, varied)


def test_a_combination_that_is_not_allowed_is_a_flagged_row(recordings, tmp_path):
    options = [*small(buffer_events=None, min_roi_events=20), "--vary", "buffer_events=10,96", "--engine", "model"]
    done = run_here(recordings[0], *options, "--out", tmp_path)
    assert done.status == 0
    assert "1 of 2 rows without a result: min_roi_events = 20: at most 10 is allowed (buffer_events)\n" in done.out
    assert run_here(recordings[0], *small(), "--vary", "eta=1", "--out", tmp_path).error.endswith("eta is set twice")


def test_combinations_with_a_field_that_is_not_read_are_skipped_and_told_once(recordings, tmp_path):
    options = [*small(eta=None, iterations=None, max_iterations=None), "--engine", "model", "--batches", "1"]
    options += ["--set", "gradient=one_pass", "--set", "border=whole"]
    vary = ("--vary", "ascent=constant,newton", "eta=0.1,0.2")
    done = run_here(*recordings[:2], *options, *vary, "--json", "--out", tmp_path)
    labels = sorted(entry["label"] for entry in json.loads(done.out)["ranking"])
    assert labels == ["ascent = constant, eta = 0.1", "ascent = constant, eta = 0.2"]
    why = "eta = 0.1: ascent = constant is needed; ascent = newton ignores it"
    assert done.err == f"note: 2 of 4 combinations are skipped, as {why}\n"


def test_the_roi_stands_behind_the_recording(recordings, tmp_path):
    a, b = recordings[:2]
    odd = tmp_path / "odd@3,4"
    odd.write_bytes(a.read_bytes())
    found = subjects([f"{a}@1,2", f"{a}@-3,5", str(b), str(odd), f"{odd}@0,0"], (7, 8), Run())
    assert [subject.roi for subject in found] == [(1, 2), (-3, 5), (7, 8), (7, 8), (0, 0)]
    assert [subject.name for subject in found] == [str(a), str(a), str(b), str(odd), str(odd)]
    assert found[0].digest == found[3].digest != found[2].digest and not any(s.problem for s in found)
    with pytest.raises(ConfigError, match="stands twice"):
        subjects([f"{a}@1,2", f"{a}@1,2"], None, Run())


def test_without_an_roi_the_truth_says_where_the_object_is(tmp_path):
    made = make_recording(tmp_path / "x.h5", 3, (400.0, -200.0))
    config = preset("paper").replace(sensor_width=32, sensor_height=24, roi_width=8, roi_height=8)
    for start_event in (0, 100):
        (subject,) = subjects([str(tmp_path / "x.h5")], None, Run(start_event=start_event))
        centre = made.motion.position(made.events.t[start_event])
        assert np.abs(np.add(subject.roi_for(config), 3.5) - centre).max() <= 0.5
    assert subject.roi_for(config.replace(roi_width=32, roi_height=24)) == (0, 0)


def test_an_roi_is_asked_for_where_nothing_says_it(tmp_path):
    make_recording(tmp_path / "x.h5", 3, (300.0, 0.0), truth=False)
    done = run_here(tmp_path / "x.h5", *small(), "--out", tmp_path / "out")
    name = str(tmp_path / "x.h5")
    assert done.error.startswith(f"{name}: an ROI is needed, as {name}@X,Y, or --roi X,Y for all")
    assert not (tmp_path / "out").exists()


def test_a_file_that_does_not_say_its_sensor(tmp_path):
    t = np.arange(300)
    np.savez(tmp_path / "x.npz", t=t, x=t % 8 + 4, y=t % 7 + 4, p=t // 300 + 1)
    options = [*small(), "--engine", "model", "--roi", "4,4", "--time-unit", "us", "--out", tmp_path / "out"]
    done = run_here(tmp_path / "x.npz", *options)
    told = "does not say how large its sensor is: taking 240×180 px; say it with --sensor W,H"
    assert done.err == f"note: {tmp_path / 'x.npz'} {told}\n"
    assert run_here(tmp_path / "x.npz", *options, "--sensor", "32,24").err == ""


def test_truth_beside_the_recording_goes_first(tmp_path):
    path = tmp_path / "x.h5"
    make_recording(path, 3, (300.0, 50.0))
    found = read_truth(path)
    assert (found.source, found.times, found.velocities, found.start) == ("recording", (0,), ((300.0, 50.0),), (14, 11))
    sidecar(path).write_text("\ufeffnote,t_us,vx_px_per_s,vy_px_per_s\na,0,1.5,2\nb,100,3,-4\n")
    found = read_truth(path)
    assert found.source == "sidecar" and found.times == (0, 100) and found.velocities == ((1.5, 2.0), (3.0, -4.0))
    assert found.motion.velocity(99).tolist() == [1.5, 2] and found.motion.velocity(100).tolist() == [3, -4]
    assert read_truth(__file__) is None


HEAD = "t_us,vx_px_per_s,vy_px_per_s\n"


@pytest.mark.parametrize("text, message", [
    ("t,vx,vy\n1,2,3\n", r": the columns t_us, vx_px_per_s, vy_px_per_s are needed"),
    ("", r": the columns .* are needed"),
    (HEAD, r": one time, and vx and vy, are needed for each piece"),
    (HEAD + "1,2,3\n1,2\n", r", line 3: three numbers are needed"),
    (HEAD + "1,2,x\n", r", line 2: three numbers are needed"),
    (HEAD + "1,2,nan\n", r": finite numbers, and times that ascend, are needed"),
    (HEAD + "2,2,2\n2,2,2\n", r": finite numbers, and times that ascend, are needed"),
])  # fmt: skip
def test_a_malformed_sidecar(recordings, tmp_path, text, message):
    path = tmp_path / "x.h5"
    path.write_bytes(recordings[0].read_bytes())
    sidecar(path).write_text(text)
    with pytest.raises(RecordingError, match=f"x.h5.truth.csv{message}$"):
        read_truth(path)
    (subject,) = subjects([str(path)], (0, 0), Run())
    assert "truth.csv" in subject.problem


@pytest.mark.parametrize("name, value", [
    ("t", [0, 1]), ("velocity", [[1.0]]), ("t", [b"x"]), ("start", [1.0]), ("start", [1.0, np.nan]), ("t", None),
])  # fmt: skip
def test_a_malformed_truth_in_the_recording(tmp_path, name, value):
    make_recording(tmp_path / "x.h5", 3, (300.0, 0.0))
    with h5py.File(tmp_path / "x.h5", "a") as file:
        del file[pieces.GROUP][name]
        if value is not None:
            file[pieces.GROUP][name] = value
    with pytest.raises(RecordingError, match="ground_truth/motion: "):
        read_truth(tmp_path / "x.h5")


@pytest.fixture
def a_task(recordings):
    found, _ = choices("fast", ["roi_width=8", "roi_height=8"], [])
    return rows(subjects([str(recordings[0])], None, Run()), found, Run())[0].task


@pytest.mark.parametrize("part, changes", [
    *((None, one) for one in ({"digest": "0"}, {"roi": (1, 1)}, {"truth": None}, {"version": "0.0.1"})),
    *(("run", one) for one in (
        {"engine": "model"}, {"size": {"events": 7}}, {"size": {"duration_us": 5000}}, {"start_event": 1},
        {"batches": 3}, {"sensor": (32, 24)}, {"time_unit": "us"},
    )),
    ("config", {"roi_gain": 1.0}), ("config", {"weight_frac": 5}),
])  # fmt: skip
def test_a_key_depends_on_all_that_the_result_does(a_task, part, changes):
    changes = {part: dataclasses.replace(getattr(a_task, part), **changes)} if part else changes
    assert dataclasses.replace(a_task, **changes).key != a_task.key
    fields = {field.name for kind in (Task, Run) for field in dataclasses.fields(kind)}
    assert fields == {
        "path", "digest", "config", "roi", "run", "truth", "version",
        "engine", "size", "start_event", "batches", "sensor", "time_unit",
    }  # fmt: skip
    assert dataclasses.replace(a_task, path="elsewhere").key == a_task.key, "it does not depend on the path"


def test_a_worker_of_another_version_refuses(a_task):
    done = run_task(dataclasses.replace(a_task, version="0.0.1"))
    assert done["status"] == "failed" and version() in done["reason"] and "0.0.1 is needed" in done["reason"]


def test_only_good_outcomes_are_kept(tmp_path):
    kept = task.Store(tmp_path / "new")
    assert kept.get("a", dict) is None
    assert kept.put("b", {"status": "failed", "reason": "x"})["reason"] == "x"
    assert not kept.folder.exists()
    assert kept.put("a", {"status": "ok", "pair": (1, 0.1)}) == {"status": "ok", "pair": [1, 0.1]}
    assert kept.get("a", dict) == {"status": "ok", "pair": [1, 0.1]} and kept.get("a", {"status": Text()}) is None
    for damaged in ("", '{"status": "o', "[1]", '{"status": "failed"}', "\0"):
        (kept.folder / "a.json").write_text(damaged)
        assert kept.get("a", dict) is None


def test_a_write_that_fails_changes_nothing(tmp_path, monkeypatch):
    task.write_atomically(tmp_path / "x", b"before")
    for call in ("fsync", "replace"):
        with monkeypatch.context() as patch:
            patch.setattr(task.os, call, Mock(side_effect=OSError(28, "No space left on device")))
            with pytest.raises(OSError, match="No space"):
                task.write_atomically(tmp_path / "x", b"after")
        assert [path.name for path in tmp_path.iterdir()] == ["x"] and (tmp_path / "x").read_bytes() == b"before"

    def replaced(*names):
        os.rename(*names)
        raise KeyboardInterrupt

    monkeypatch.setattr(task.os, "replace", replaced)
    with pytest.raises(KeyboardInterrupt):
        task.write_atomically(tmp_path / "x", b"after")
    assert [path.name for path in tmp_path.iterdir()] == ["x"] and (tmp_path / "x").read_bytes() == b"after"
