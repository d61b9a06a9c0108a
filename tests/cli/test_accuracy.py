"""``cmfpga accuracy``, and ``cmfpga track --truth``."""

import csv
import json

import numpy as np
import pytest

from cmfpga.cli import accuracy, track
from cmfpga.events import generate, write_hdf5
from support.flowing import CAMERA, OMEGA

VELOCITY = (120.0, -40.0)
MODEL = ("--engine", "model", "--batch-events", 1500, "--batches", 3, "--roi", "20,16")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """An object of a sensor of 128×96 px, and nothing that tells how it moves."""
    path = tmp_path_factory.mktemp("scene") / "scene.h5"
    made = generate(seed=4, width=128, height=96, position=(55, 55), velocity=VELOCITY, duration_us=200_000)
    write_hdf5(path, made.events, 128, 96)
    return path


@pytest.fixture
def truth(tmp_path):
    def truth(*velocity, begin=0.0):
        path = tmp_path / "truth.txt"
        path.write_text("".join(f"{begin + t} {velocity[0]} {velocity[1]}\n" for t in (-0.5, 0.5)))
        return path

    return truth


def test_figures_are_those_of_the_track(command, scene, truth, tmp_path):
    done = command(accuracy, scene, "--truth", truth(*VELOCITY), *MODEL, "--json", "--out", tmp_path)
    told = json.loads(done.out)
    rows = list(csv.DictReader((tmp_path / "track.csv").read_text().splitlines()))
    sure = [row for row in rows if "doubtful" not in row["flags"]]
    errors = np.array([[float(row["vx_px_per_s"]), float(row["vy_px_per_s"])] for row in sure]) - VELOCITY
    assert done.status == 0 and told["trusted"]["count"] == len(sure) >= 2 and told["compared"] == len(rows)
    assert list(told["trusted"]["rms"].values()) == pytest.approx(np.sqrt((errors**2).mean(axis=0)), abs=1e-2)
    assert told["trusted"]["aee_px_per_s"] == pytest.approx(np.hypot(*errors.T).mean(), abs=1e-2)
    assert told["wrong"] == 0 and told["trusted"]["fwl"] > 1.1
    assert told["files"] == [str(tmp_path / name) for name in ("track.csv", "accuracy.csv")]
    both = command(track, scene, "--truth", truth(*VELOCITY), *MODEL, "--json", "--no-picture", "--out", tmp_path)
    del told["files"]
    assert json.loads(both.out)["accuracy"] == told


def test_a_wrong_truth_in_words(command, scene, truth, tmp_path):
    """As after a track's own summary."""
    told = ("--truth", truth(-120, 40), *MODEL, "--out", tmp_path)
    alone, behind = command(accuracy, scene, *told), command(track, scene, "--no-picture", *told)
    assert "3 of 3 are trusted; 3 of these are wrong, by more than 0.6 px per half batch" in alone.out
    lines = alone.out.splitlines()
    assert behind.out.splitlines()[-len(lines) :] == lines and lines[0].endswith("0.500000 s")
    assert behind.out.startswith("3 batches tracked (model engine)")


def test_the_truth_beside_the_recording(command, scene):
    beside = scene.with_name("scene.h5.truth.csv")
    beside.write_text("t_us,vx_px_per_s,vy_px_per_s\n0,120,-40\n")
    done = command(accuracy, scene, *MODEL, "--out", scene.parent)
    beside.unlink()
    assert done.status == 0 and "; 0 of these are wrong" in done.out
    assert "its true motion is not known; --truth FILE is needed" in command(accuracy, scene, *MODEL).error


def test_tiles_of_a_turning_camera(command, turning, tmp_path):
    write_hdf5(tmp_path / "turn.h5", turning.events, 128, 96)
    gyroscope = tmp_path / "imu.txt"
    gyroscope.write_text("".join(f"{t} 0 0 9.81 {' '.join(map(str, OMEGA))}\n" for t in (0.0, 0.15)))
    how = ["--engine", "model", "--flow", "--window-events", 9000, "--batches", 1, "--truth", gyroscope]
    done = command(accuracy, tmp_path / "turn.h5", *how, "--camera", CAMERA.text, "--out", tmp_path)
    assert done.status == 0 and "px/half window" in done.out and "RMS vx" in done.out
    rows = csv.DictReader((tmp_path / "accuracy.csv").read_text().splitlines())
    errors = [float(row["error_px"]) for row in rows if row["trusted"] == "1"]
    assert len(errors) > 10 and np.median(errors) < 0.5
    assert (tmp_path / "flow.csv").exists()


@pytest.mark.parametrize("arguments, message", [
    (("--truth", "none.txt"), "none.txt: cannot be read: No such file or directory"),
    (("--truth-unit", "s"), "--truth-unit: --truth FILE is needed"),
    (("--truth", "TRUTH", "--delay", "soon"), "'soon': auto, or a number of seconds, is needed"),
    (("--truth", "TRUTH", "--delay", "nan"), "'nan': auto, or a number of seconds, is needed"),
    (("--truth", "TRUTH", "--depth", "0"), "'0': a number of metres above 0 is needed"),
    (("--truth", "TRUTH", "--depth", "1"), "depth = 1: poses, and a motion that is no rotation, are needed"),
    (("--truth", "TRUTH", "--delay", "9"), "no time in common (--delay, --truth-unit)"),
    (("--truth", "TRUTH", "--tile", "32"), "--tile: --flow is needed"),
    (("--truth", "TRUTH", "--flow"), "--roi: none of a track's, and one length of windows, are allowed with --flow"),
])  # fmt: skip
def test_bad_input(command, scene, truth, tmp_path, arguments, message):
    given = (str(truth(*VELOCITY)) if one == "TRUTH" else one for one in arguments)
    assert message in command(accuracy, scene, *given, *MODEL, "--out", tmp_path / "out").error
    assert not (tmp_path / "out" / "track.csv").exists()


def test_a_recording_is_needed(command, truth):
    assert command(accuracy, "--truth", truth(1, 2)).error.startswith("RECORDING: a recording is needed")
    assert "a RECORDING is needed" in command(track, "--truth", truth(1, 2)).error


def test_the_rail(command, data_dir, tmp_path):
    """The camera on a slider: all that is seen moves along x."""
    rail = data_dir / "truth"
    done = command(
        track, data_dir / "davis240c_slider_depth_0.0s.h5", "--roi", "100,60", "--batch-events", 12_000, "--json",
        "--start-event", 6000, "--engine", "model", "--no-picture", "--out", tmp_path,
        "--truth", rail / "slider_depth_groundtruth.txt", "--camera", rail / "slider_depth_calib.txt",
    )  # fmt: skip
    told = json.loads(done.out)["accuracy"]
    assert told["depth_unknown"] and told["compared"] >= 2 and told["trusted"]["count"] >= 2
    assert told["wrong"] == 0 and told["trusted"]["aee_px"] < 0.4
