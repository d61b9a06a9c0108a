"""Known motion: its truth, what is counted of tracks; studies of confidence, bias, and the slider on its rail."""

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest
from studies.accuracy.synthetic import synthetic_cases

from cmfpga.config import preset
from cmfpga.errors import RecordingError
from cmfpga.imaging.camera import read_calibration
from studies.accuracy import bias, default_use, judged, known

FAST = preset("fast")


@pytest.fixture(scope="module")
def scene():
    """The generated recording that has most batches to the event, with one track."""
    one = known.generated()[2]
    return dataclasses.replace(one, rois=one.rois[7:8])


def middle(one, share=0.5):
    """Truth at the sensor's middle in 20 ms around a time."""
    at = int(one.events.t[0] + share * (one.events.t[-1] - one.events.t[0]))
    return one.truth(at - 10_000, at + 10_000, *(np.array([side / 2]) for side in one.sensor))


def test_the_generated_ones():
    for one, (_, velocity, *_) in zip(known.generated(), known.SCENES, strict=True):
        assert np.allclose(middle(one), velocity) and one.doubt == 0 and one.in_sum
        assert len(set(one.rois)) == len(one.rois) >= 12
        assert all(0 <= x <= one.sensor[0] - 64 and 0 <= y <= one.sensor[1] - 64 for x, y in one.rois)


@pytest.mark.usefixtures("long_tools")
def test_what_is_counted(scene):
    """Trusted are those of the engine; with another truth all of them are wrong."""
    told = default_use.scores(default_use.measure(scene, FAST, "model")["model"], 1)
    assert told["batches"] == told["answered"] >= told["trusted"] > 3 * told["wrong_of_trusted"]
    assert told["median_error_of_trusted_px"] < 0.3 and told["median_motion_px"] > 1
    elsewhere = dataclasses.replace(scene, truth=lambda *_: (400.0, 300.0), doubt=100.0)
    wrong = default_use.scores(default_use.measure(elsewhere, FAST, "model")["model"], 1)
    assert wrong["wrong_of_trusted"] == wrong["trusted"] == told["trusted"]
    assert wrong["truth_known_to_px"] == pytest.approx(wrong["median_motion_px"] / 5, rel=0.01)
    assert default_use.measure(dataclasses.replace(scene, left=240), FAST, "model")["model"].shape == (0, 6)


def test_scores():
    rows = [(1, 1, 0.1, 3, 0, 0.5), (1, 1, 0.7, 3, 0, 2.0), (1, 0, 5, 3, 0, 99.0), (0, 0, 9, 3, 0, np.nan)]
    values = np.array(rows)
    told = default_use.scores(values, 2)
    counts = ("tracks", "batches", "answered", "trusted", "wrong_of_trusted")
    assert [told[name] for name in counts] == [2, 4, 3, 2, 1]
    assert told["median_error_of_trusted_px"] == pytest.approx(0.4)
    assert told["in_ellipses"] == [0.5, 1.0, 1.0], "inside of 1.39, 2.28 and 5.99 deviations squared"
    none = default_use.scores(values[2:], 1)
    assert none["median_error_of_trusted_px"] is None and none["in_ellipses"] == []


def test_errors_in_deviations():
    """By hand: 0.2 px along x of sd 0.1, 0.1 px along y of sd 0.2; a doubt; and where no covariance is stated."""
    assert default_use.sizes((0.2, 0.1), (0.01, 0.04, 0.0)) == pytest.approx(4 + 0.25)
    assert default_use.sizes((0.3, 0.2), (0.08, 0.03, 0.0), doubt=0.1) == pytest.approx(1 + 1)
    assert np.isnan(default_use.sizes((0.2, 0.1), None))


def test_command(scene, written, capsys, monkeypatch):
    pytest.importorskip("eventcv")
    monkeypatch.setattr(default_use, "recordings", lambda folder: [scene])
    found = written("--batches", "4", "--known", "--eventcv")["results"]
    out = capsys.readouterr().out
    assert len(found["synthetic, cold, eventcv"]["values"]) == 4
    for engine in ("model", "eventcv"):
        alone, total = (found[f"known motion, {name}, {engine}"] for name in (scene.name, "sum"))
        assert alone == total and alone["scores"]["batches"] == len(alone["values"]) > 2
        assert f"| {scene.name} | {engine} " in " ".join(out.split())


def test_without_eventcv_a_line_says_so(run, capsys, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "eventcv", None)
    assert run("--batches", "1", "--eventcv") == 2
    assert "eventcv is not installed; pip install 'cmfpga[eventcv]'" in capsys.readouterr().err


#: Angular velocity, rad/s, that others found by a search of their own.
NOTED = {
    known._shapes: ("davis240c_shapes_rotation_2.1s_gtflow.h5", (-0.071, 0.663, -0.122)),
    known._poster: ("davis240c_poster_rotation_0.6s.h5", (-0.005, -0.637, -0.135)),
}


@pytest.mark.parametrize("make", NOTED, ids=lambda make: make.keywords["name"])
def test_truth_of_turning_cameras(make, data_dir):
    file, omega = NOTED[make]
    one = make(data_dir / file)
    camera = read_calibration(data_dir / file).camera
    places = np.array(one.rois).T + 32.0
    found = [one.truth(*one.events.t[[0, -1]].tolist(), *place[:, None]) for place in places.T]
    assert np.abs(np.array(found).T - camera.speeds(omega, *places)).max() < 5 and 0 < one.doubt < 10


def test_the_calibration_does_not_hold_at_the_left_border(data_dir):
    """When an object's last edge leaves a column: a straight line, slower than the truth, which is not used there."""
    one = known._shapes(data_dir / NOTED[known._shapes][0])
    events = one.events[(one.events.y >= 39) & (one.events.y <= 53)]
    left_at = np.array([events.t[events.x == column].max() for column in range(10)]) / 1e6
    speed, _ = np.polyfit(left_at, range(10), 1)
    columns, rows = np.arange(10.0), np.full(10, 46.0)
    assert speed == pytest.approx(-112, abs=5)
    assert one.truth(*one.events.t[[0, -1]].tolist(), columns, rows)[0] == pytest.approx(-131, abs=5)
    assert one.left == min(x for x, _ in one.rois) > 20 and len(one.rois) == 45


def test_truth_of_the_spinner(data_dir):
    one = known._spinner(data_dir / "prophesee_spinner_640x480.h5")
    first = int(one.events.t[0])
    dot = np.mean(one.rois, axis=0) + 32
    across, down = one.truth(first, first + 450, *dot)
    assert math.hypot(across, down) == pytest.approx(13_050, rel=0.02) and across > 0 > down and not one.in_sum


def test_truth_of_long_recordings(data_dir):
    board = known._checkerboard(data_dir / "davis240b_evbench_seq0002.h5")
    pan = known._gyroscope(data_dir / "davis240c_translboxes_imu.h5")
    for share in (0.1, 0.9):
        (vx, vy), (pan_vx, pan_vy) = middle(board, share), middle(pan, share)
        assert abs(vx) < 2 and -33 < vy < -30 and 19 < pan_vx < 33 and pan_vy == 0
    assert board.in_sum and not pan.in_sum and min(x for x, _ in board.rois) == board.left


def test_a_missing_recording_is_an_error(tmp_path):
    with pytest.raises(RecordingError, match="evbench"):
        known.recordings(tmp_path)


def test_separation():
    values = np.array([(0.1, 50, 1), (0.2, 40, 1), (0.1, 10, 0), (0.9, 20, 0), (3.0, -math.inf, 0)])
    assert judged.separation(values) == (pytest.approx(5 / 6), 0.5)
    assert all(map(math.isnan, judged.separation(values[:3])))


def test_batches_of_the_confidence_study(scene):
    """Cut or drawn, their truth is that of the part: the ascent finds it where it is sure."""
    batches = judged.cut(synthetic_cases(8)) + judged.drawn(scene, 6)
    assert {case.facts.get("moved") for case in batches} == {True, False, None}
    assert len(batches) > 12 and all(0 <= case.roi[0] <= 176 and 0 <= case.roi[1] <= 116 for case in batches)
    values = judged_errors(batches)
    assert values[values[:, 2] > 0, 0].max() < 0.6 and (values[:, 2] > 0).sum() > 5
    false = [dataclasses.replace(case, truth=(-case.truth[0], -case.truth[1])) for case in batches]
    assert judged_errors(false)[values[:, 2] > 0, 0].mean() > 2


def judged_errors(batches):
    return judged.measure("model", FAST, judged.judge, batches, warm=False, progress=iter)


@pytest.mark.parametrize("camera", [(bias.edges, 40), (bias.pixels, 40), (bias.pixels, 40, 0.15, 0.1)])
def test_cameras_of_the_bias_study_see_the_motion(camera, monkeypatch):
    monkeypatch.setattr(bias, "BATCHES", 2)
    batches = bias.cases(4.0, *camera)
    assert np.allclose([math.hypot(*case.truth) for case in batches], 4.0, rtol=0.02)
    assert np.allclose(bias.measure("model", FAST, bias._shares, batches), 1, atol=0.12)


def test_the_slider_by_auto(data_dir):
    """The rail moves along x alone: no trusted window is off along y, and those that are compared share no time."""
    tracking = default_use._tracked(data_dir / default_use.SLIDER, "model", roi="auto")
    assert tracking.trusted.sum() > 25 and np.abs(tracking.vy[tracking.trusted]).max() < default_use.WRONG
    found = default_use.apart(tracking, tracking.trusted)
    assert len(found) >= 2 and all(tracking.trusted[k] for k, *_ in found)
    assert all(one[2] <= two[1] + 1 for one, two in pairwise(found))


def test_the_grid_reaches_all_borders():
    places = np.array(known.grid((240, 180)))
    assert len({*map(tuple, places)}) == 45 and places.min() == 0
    assert (places.max(axis=0) + known.ROI == (240, 180)).all()
