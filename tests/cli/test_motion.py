"""Motions beyond translation on the command line: ``track``, ``generate``, and what refuses them."""

import csv
import json

import h5py
import numpy as np
import pytest

import cmfpga
from cmfpga.cli import build, generate, track
from cmfpga.events import Events, write_hdf5
from cmfpga.events import generate as synthetic
from cmfpga.imaging.camera import RATES
from support.small_core import sets
from support.tracks import floats

OMEGA = (0.5, -1.0, 0.4)
ZOOM, ROLL, VELOCITY = 0.9, -1.2, (30.0, 15.0)


@pytest.fixture(scope="module")
def turn(tmp_path_factory):
    """A recording of a camera with a lens that turns."""
    path = tmp_path_factory.mktemp("turn") / "turn.h5"
    told = ["--camera", "200,200,118,91,-0.35,0.12,0,0,0", "--bars", "20", "--contrast", "1.5"]
    assert generate.main([str(path), "--rotation", "0.5,-1,0.4", "--duration-us", "120000", *told]) == 0
    return path


@pytest.fixture(scope="module")
def grow(tmp_path_factory):
    """A recording of an object that grows and turns."""
    path = tmp_path_factory.mktemp("grow") / "grow.h5"
    told = "--velocity 30,15 --zoom 0.9 --roll=-1.2 --size 150,150 --bars 15 --contrast 1.5 --duration-us 120000"
    assert generate.main([str(path), *told.split()]) == 0
    return path


def rows(folder):
    with open(folder / "track.csv") as file:
        return [*csv.DictReader(file)]


@pytest.fixture
def follow(command, tmp_path):
    """``follow(preset, recording, option, …)``: what ``track`` said, by the model unless told otherwise."""

    def follow(preset, recording, *options):
        done = command(track, recording, "--preset", preset, "--engine", "model", "--out", tmp_path, *options)
        assert done.status == 0, done.err
        return done

    return follow


def test_a_rotation_needs_no_option(follow, turn, tmp_path):
    """No ROI, no calibration, no batches: the recording's own calibration, the whole sensor, batches that suit it."""
    said, found = follow("rotation", turn, "--batches", 2).out, rows(tmp_path)
    assert "\nωx 0." in said and "; ωy -" in said and " rad/s in the median" in said and "undistorted image" in said
    assert "2 of 2 batches are to be trusted" in said and (floats(found, "confidence") > 150).all()
    head = (tmp_path / "track.csv").read_text().splitlines()[0].split(",")
    rates = [column for name in RATES["rotation"] for column in (name, f"{name}_sd")]
    assert head[head.index("vy_px_per_s_sd") + 1 :][: len(rates)] == rates and head[-1] == "image"
    omega = np.stack([floats(found, name) for name in RATES["rotation"]], axis=1)
    assert np.abs(omega - OMEGA).max() < 0.06
    speed = np.hypot(floats(found, "vx"), floats(found, "vy"))
    assert (speed >= 2.5).all() and (speed <= 5.5).all()
    assert (tmp_path / "track.png").stat().st_size > 10_000
    summary = json.loads(follow("rotation", turn, "--batches", 2, "--json", "--no-picture").out)
    assert summary["wy_rad_per_s"]["median"] == pytest.approx(np.median(omega[:, 1]), abs=1e-6)
    assert (summary["config"]["roi_width"], summary["config"]["roi_height"]) == (240, 180)


@pytest.mark.parametrize("sensor, camera, pixels, image", [
    ("640,480", "533,533,315,243,-0.35,0.12,0,0,0", "2×2", "320×240"),
    ("1280,720", "1066,1066,629,365,-0.35,0.12,0,0,0", "4×4", "320×180"),
])  # fmt: skip
def test_a_rotation_of_a_large_sensor_is_binned(sensor, camera, pixels, image, command, follow, tmp_path):
    """Without an option, in the unit of the small one, and as exactly; px/s are those of the sensor's pixels."""
    told = ["--sensor", sensor, "--camera", camera, "--bars", 20, "--contrast", 1.5, "--duration-us", 90_000]
    assert command(generate, tmp_path / "turn.h5", "--rotation", "0.5,-1,0.4", *told).status == 0
    said = follow("rotation", tmp_path / "turn.h5", "--batches", 2, "--no-picture")
    assert f"pixels are binned {pixels}, to {image} (binning = " in said.err
    assert "2 of 2 batches are to be trusted" in said.out
    found, focus = rows(tmp_path), float(camera.split(",")[0])
    omega = [floats(found, name) for name in RATES["rotation"]]
    assert np.abs(np.transpose(omega) - OMEGA).max() < 0.06
    np.testing.assert_allclose(floats(found, "vx_px_per_s"), -omega[1] * focus, rtol=1e-3)
    np.testing.assert_allclose(floats(found, "vy_px_per_s"), omega[0] * focus, rtol=1e-3)


@pytest.mark.usefixtures("long_tools")
def test_the_axi_top_is_built(command, tmp_path):
    """Without a camera, which shapes no hardware; its documents have the registers of the motion."""
    small = {"sensor_width": 48, "sensor_height": 32, "roi_width": 48, "roi_height": 32, "buffer_events": 64}
    told = ["--preset", "rotation", "--top", "kv260", *sets(small | {"ram_style": "auto"})]
    assert command(build, *told, "--out", tmp_path).status == 0
    told = json.loads((tmp_path / "kv260-info.json").read_text(encoding="utf-8"))
    assert told["configuration"]["motion"] == "rotation" and told["result_words"] == 22
    assert {"CENTRE", "CURVE", "NODE_WRITE", "RESULT_V_ROLL"} <= set(told["registers"])
    assert "`CURVE`" in (tmp_path / "registers.md").read_text(encoding="utf-8")


def test_python_finds_the_same(follow, turn, tmp_path):
    follow("rotation", turn, "--batches", 1, "--no-picture")
    found = cmfpga.track(turn, preset="rotation", engine="model", batches=1)
    found.to_csv(tmp_path / "python.csv")
    assert (tmp_path / "python.csv").read_text() == (tmp_path / "track.csv").read_text()
    found.report(tmp_path / "page.html")
    assert "<h2>Angular velocity of the camera</h2>" in (tmp_path / "page.html").read_text(encoding="utf-8")
    assert found.wy_rad_per_s.dtype == np.float64 and set(RATES["rotation"]) <= set(found.to_arrays())
    assert [axis.get_title("left") for axis in found.plot().axes][-2:].count("angular velocity of the camera") == 1
    trace = found.trace(0)
    assert trace[len(trace) - 1].raw["v_next"].shape == (3,)


def test_a_similarity_tracks_an_roi(follow, grow, tmp_path):
    told = ["similarity", grow, "--roi", "56,26", "--batches", 1]
    said, (row,) = follow(*told, "--batch-us", 100_000).out, rows(tmp_path)
    zoom, roll, contact = (float(row[name]) for name in RATES["similarity"])
    assert zoom == pytest.approx(ZOOM, abs=0.15) and roll == pytest.approx(ROLL, abs=0.1)
    assert contact == pytest.approx(1 / zoom, abs=1e-4) and "time to contact " in said
    assert {*RATES["similarity"]} <= {*json.loads(follow(*told, "--json", "--no-picture").out)}


def test_two_objects_of_which_one_turns(follow, tmp_path):
    """Each has the columns of one object alone, and its own motion."""
    how = {"size": (60, 60), "bars": 14, "contrast": 2.0, "duration_us": 80_000}
    made = [
        synthetic(seed=1, position=(50.0, 60.0), velocity=(60.0, 20.0), **how),
        synthetic(seed=2, position=(170.0, 115.0), velocity=(0.0, -40.0), roll=2.5, zoom=-0.8, **how),
    ]
    write_hdf5(tmp_path / "two.h5", Events.merge(scene.events for scene in made), 240, 180)
    where = ["{},{}".format(*one.roi_start(64, 64)) for one in made]
    fields = {"motion": "similarity", "ascent": "sign", "schedule_entries": 64, "confidence_limit": 30}
    told = ["objects", tmp_path / "two.h5", *sets(fields), "--batch-us", 75_000, "--batches", 1, "--no-picture"]
    said, heads = follow(*told, "--roi", f"a={where[0]}", "--roi", f"b={where[1]}").out, set()
    assert "a: roll" not in said and "\na: zoom " in said and "\nb: zoom " in said
    for name, zoom, roll in (("a", 0.0, 0.0), ("b", -0.8, 2.5)):
        text = (tmp_path / f"track-{name}.csv").read_text(encoding="utf-8")
        (row,) = csv.DictReader(text.splitlines())
        heads.add(text.splitlines()[0])
        assert float(row["zoom_per_s"]) == pytest.approx(zoom, abs=0.3) and row["flags"] in ("", "thinned")
        assert float(row["roll_rad_per_s"]) == pytest.approx(roll, abs=0.3)
    follow(*told, "--roi", where[0])
    assert heads == {(tmp_path / "track.csv").read_text(encoding="utf-8").splitlines()[0]}


def test_a_rotation_without_a_calibration(command, follow, grow, turn, tmp_path):
    told = ["--preset", "rotation", "--engine", "model", "--out", tmp_path]
    assert "no calibration, which motion = rotation needs: --camera FILE" in command(track, grow, *told).error
    assert "synthetic scene: it holds no calibration" in command(track, *told).error
    follow("rotation", grow, "--camera", turn, "--batch-us", 60_000, "--batches", 1)


@pytest.mark.parametrize("told, why", [
    (["--rotation", "0,1,0"], "rotation: a camera is needed"),
    (["--rotation", "0,1", "--camera", "200,200,120,90"], "three numbers"),
    (["--rotation", "0,1,0", "--camera", "200,200,120,90", "--velocity", "1,1"], "nothing but the camera moves"),
    (["--zoom", "1e9"], "zoom = 1000000000.0"), (["--roll", "x"], "a number is needed"), (["--bars", "0"], "bars"),
])  # fmt: skip
def test_scenes_that_there_are_not(command, told, why, tmp_path):
    assert why in command(generate, tmp_path / "scene.h5", *told).error


def test_the_file_tells_the_truth(turn, grow):
    with h5py.File(turn) as file:
        assert tuple(file.attrs["angular_velocity_rad_per_s"]) == OMEGA and "ground_truth" not in file
    with h5py.File(grow) as file:
        assert (file.attrs["zoom_per_s"], file.attrs["roll_rad_per_s"]) == (ZOOM, ROLL)
        assert tuple(file["ground_truth/motion/velocity"][0]) == VELOCITY


@pytest.mark.usefixtures("long_tools")
@pytest.mark.parametrize("preset", ["similarity", "rotation"])
def test_the_core_is_built_without_a_camera(command, preset, tmp_path):
    """Which shapes no hardware."""
    assert command(build, "--preset", preset, "--out", tmp_path).status == 0
    assert json.loads((tmp_path / "build-info.json").read_text(encoding="utf-8"))["configuration"]["motion"] == preset
    verilog = (tmp_path / "cmfpga_core.v").read_text(encoding="utf-8")
    assert "\nmodule cmfpga_core_image_one_pass_gradient_moments" in verilog
