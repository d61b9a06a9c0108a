"""``--camera`` of ``track``, ``generate`` and from Python, and what ``info`` says of a calibration."""

import json

import h5py
import numpy as np
import pytest

import cmfpga
from cmfpga.cli import generate, info, track
from cmfpga.errors import ConfigError
from cmfpga.events import generate as generate_events
from cmfpga.imaging.camera import Camera, read_calibration

NUMBERS = "200,200,120,90,-0.35,0.12,0.001,-0.0005,0"
CAMERA = Camera(*map(float, NUMBERS.split(",")))
ROI = (18, 12)  # around the object in the undistorted image
TRUE = (110.0, 60.0)

FOUR = {"roi": ROI, "batch_us": 60_000, "batches": 4, "engine": "model"}
ONE = FOUR | {"batches": 1}


@pytest.fixture(scope="module")
def lens(command, tmp_path_factory):
    """A recording through a lens with a barrel's distortion, of an object in a corner of the sensor."""
    path = tmp_path_factory.mktemp("lens") / "lens.h5"
    told = "--position 50,44 --velocity 110,60 --size 40,40 --duration-us 300000 --seed 7 --contrast 0.5 --noise 0.05"
    assert command(generate, path, *told.split(), "--camera", NUMBERS).status == 0
    return path


@pytest.fixture
def tracked(command, lens, tmp_path):
    """``tracked(option, …)``: what ``track`` printed of four batches."""
    arguments = ["--batch-us", 60_000, "--batches", 4, "--engine", "model", "--no-picture", "--out", tmp_path]

    def tracked(*options):
        done = command(track, lens, *arguments, *options)
        assert done.status == 0
        return done.out

    return tracked


def test_the_undistorted_track_is_right_and_the_distorted_one_is_not(lens, tracked, tmp_path):
    """The lens shows the corner smaller: what moves there seems slower."""
    right = cmfpga.track(lens, **FOUR, camera=lens)
    place = np.array(ROI) + 31.5
    start = tuple((CAMERA.distorted(*place[:, None])[:, 0] - 31.5).round().astype(int).tolist())
    wrong = cmfpga.track(lens, **FOUR | {"roi": start})
    errors = [np.hypot(one.vx_px_per_s - TRUE[0], one.vy_px_per_s - TRUE[1]) for one in (right, wrong)]
    assert np.median(errors[0]) < 3 and errors[0].max() < 6 and errors[1].min() > 10
    assert (right.config.image, wrong.config.image) == ("undistorted", "")
    assert right.roi_x[0] == ROI[0]
    found = json.loads(tracked("--roi", "{},{}".format(*ROI), "--camera", lens, "--json"))
    assert found["image"] == "undistorted" and found["config"]["camera"] == read_calibration(lens).camera.text
    right.to_csv(tmp_path / "python.csv")
    assert (tmp_path / "track.csv").read_text() == (tmp_path / "python.csv").read_text()
    trace = right.trace(1)
    assert trace.x.dtype == np.float64 and (trace.x % 1 != 0).any() and trace.x.min() >= -0.5 and trace.x.max() < 63.5
    assert np.abs(trace[0].raw["v_next"]).any()


def test_every_output_says_which_image(lens, tracked, tmp_path):
    said = tracked("--roi", "{},{}".format(*ROI), "--camera", NUMBERS, "--report")
    assert f"\nROI and velocity are in the undistorted image: {CAMERA}\n" in said
    head, *rows = (tmp_path / "track.csv").read_text().splitlines()
    assert head.endswith(",flags,ambiguity,image") and len(rows) == 4
    assert all(row.endswith(",undistorted") for row in rows)
    page = (tmp_path / "report.html").read_text()
    assert "<li>ROI, velocity and pictures are in the undistorted image.</li>" in page
    found = cmfpga.track(lens, **ONE, camera=CAMERA)
    assert found.plot().axes[0].get_xlabel() == "x, undistorted [px]"
    assert cmfpga.track(lens, **ONE).plot().axes[0].get_xlabel() == "x [px]"
    # The frame that is kept for the report is the undistorted image, too.
    detail = found._kept.details[0]
    x, y = ROI
    assert detail.frame[y : y + 64, x : x + 64].sum() == found.results[0].roi_events + found.results[0].thinned
    columns, rows = found._kept.places(detail)
    assert columns.min() >= -0.5 and rows.max() < 63.5 and (columns % 1 != 0).any()


def test_batches_and_proposals_see_the_undistorted_image(lens, tracked, tmp_path):
    by_roi = cmfpga.track(lens, roi=ROI, batch_roi_events=700, batches=2, engine="model", camera=lens)
    assert by_roi.results[0].roi_events + by_roi.results[0].thinned == 700
    x, y = json.loads(tracked("--roi", "auto", "--camera", lens, "--json"))["roi"]
    assert ROI[0] - 8 <= x <= ROI[0] + 33 and ROI[1] - 8 <= y <= ROI[1] + 18  # where it is at some time of the 0.3 s
    rows = np.genfromtxt(tmp_path / "track.csv", delimiter=",", names=True, dtype=None, encoding=None)
    assert np.hypot(rows["vx_px_per_s"] - TRUE[0], rows["vy_px_per_s"] - TRUE[1]).max() < 6


def test_a_camera_in_all_forms(lens, tmp_path):
    (tmp_path / "calib.txt").write_text(NUMBERS)
    forms = [tmp_path / "calib.txt", str(lens), CAMERA, NUMBERS, [float(one) for one in NUMBERS.split(",")]]
    forms.append(read_calibration(lens))
    assert len({tuple(cmfpga.track(lens, **ONE, camera=one).results[0].sums) for one in forms}) == 1


def test_a_scene_through_a_lens(lens):
    with h5py.File(lens) as file:
        assert file["camera_calibration"][()].tolist() == [float(one) for one in NUMBERS.split(",")]
        assert file["camera_calibration"].attrs["order"] == "fx fy cx cy k1 k2 p1 p2 k3"
    fields = {"seed": 5, "position": (50.0, 44.0), "velocity": TRUE, "duration_us": 100_000}
    seen, plain = generate_events(**fields, camera=CAMERA).events, generate_events(**fields).events
    assert abs(len(seen) - len(plain)) < 0.1 * len(plain)  # a few leave the sensor
    back = CAMERA.undistorted(seen.x, seen.y)
    assert np.abs(back.mean(axis=1) - [plain.x.mean(), plain.y.mean()]).max() < 0.5


def test_info_prints_it(lens, command, data_dir, tmp_path):
    def told(path, *options):
        done = command(info, path, "--no-frame", "--no-proposal", *options)
        assert done.status == 0
        return done.out

    assert f"\ncamera      {CAMERA}\n" in told(lens)
    found = json.loads(told(lens, "--json"))["camera"]
    assert found["k1"] == -0.35 and found["text"] == str(CAMERA)
    assert "camera" not in told(data_dir / "davis240c_slider_depth_0.0s.h5")
    with h5py.File(tmp_path / "bad.h5", "w") as file, h5py.File(lens) as good:
        good.copy("events", file)
        file["camera_calibration"] = np.eye(3)
    needed = "/camera_calibration: fx fy cx cy k1 k2 p1 p2 k3 is needed, nine numbers\n"
    assert needed in told(tmp_path / "bad.h5", "--sensor", "240,180")


@pytest.mark.parametrize("camera, options, message", [
    ("other.yaml", [], "other.yaml: a camera of 640×480 px; the sensor has 240×180 px"),
    ("1,2,3", [], "camera: '1 2 3': fx fy cx cy k1 k2 p1 p2 k3 is needed, nine numbers"),
    (NUMBERS, ["--set", "undistortion=off"], "camera = '200.0,200.0,120.0,90.0,-0.35,0.12,0.001,-0.0005,0.0': undist"),
])  # fmt: skip
def test_what_is_refused(lens, command, tmp_path, monkeypatch, camera, options, message):
    (tmp_path / "other.yaml").write_text("width: 640\nheight: 480\nK: [200, 0, 120, 0, 200, 90, 0, 0, 1]\nD: []\n")
    monkeypatch.chdir(tmp_path)
    arguments = ["--roi", "30,20", "--batches", 1, "--engine", "model", "--camera", camera, *options]
    assert command(track, lens, *arguments).error.startswith(message)
    with pytest.raises(ConfigError, match=r"^camera = 7: a file, or fx fy cx cy k1 k2 p1 p2 k3, is needed$"):
        cmfpga.track(lens, roi=ROI, camera=7)
