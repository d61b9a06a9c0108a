"""Files of calibrations: what is read, and refused in one line; pixels, rays, and what a turning camera sees."""

import os
from dataclasses import astuple

import h5py
import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.errors import ConfigError
from cmfpga.imaging.camera import Camera, read_calibration

LENSES = {
    "pinhole": Camera(199.0, 201.0, 120.0, 90.0),
    "barrel": Camera(199.1, 198.8, 132.2, 110.7, -0.368, 0.151, -0.0003, -0.0009, 0.01),
    "cushion": Camera(210.0, 205.0, 118.0, 92.0, 0.25, 0.05, 0.002, 0.001, -0.02),
}
NINE = (199.09, 198.83, 132.19, 110.71, -0.368, 0.151, -0.0003, -0.0008, 0.0)

CALIBRATOR = """\
image_width: 240
image_height: 180
camera_name: davis
camera_matrix:
  rows: 3
  cols: 3
  data: [199.09, 0, 132.19, 0, 198.83, 110.71, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.368, 0.151, -0.0003, -0.0008, 0]}
projection_matrix: {rows: 3, cols: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}
"""
MESSAGE = """\
header:
  frame_id: "camera"
height: 180
width: 240
distortion_model: "plumb_bob"
D: [-0.368, 0.151, -0.0003, -0.0008, 0.0]
K: [199.09, 0.0, 132.19, 0.0, 198.83, 110.71, 0.0, 0.0, 1.0]
---
"""
TEXTS = {
    "calibrator.yaml": (CALIBRATOR, (240, 180)),
    "message.yaml": (MESSAGE, (240, 180)),
    "ros2.yml": (MESSAGE.replace("D:", "d:").replace("K:", "k:").replace("width: 240\n", ""), None),
    "calib.txt": (" ".join(map(repr, NINE)) + "\n", None),
    "noted.txt": ("# fx fy cx cy\n199.09, 198.83, 132.19, 110.71  # px\n-0.368 0.151 -0.0003 -0.0008\n", None),
}


@pytest.mark.parametrize("name", TEXTS)
def test_texts(name, tmp_path):
    text, size = TEXTS[name]
    (tmp_path / name).write_text(text)
    found = read_calibration(tmp_path / name)
    assert (astuple(found.camera), found.size) == (NINE, size)
    assert preset("fast").replace(undistortion="on", camera=found.camera.text).lens == NINE  # to the last bit


def test_hdf5(tmp_path, data_dir):
    with h5py.File(tmp_path / "rec.h5", "w") as file:
        file["camera_calibration"] = np.array(NINE)
    assert read_calibration(tmp_path / "rec.h5").camera == Camera(*NINE)
    found = read_calibration(data_dir / "davis240c_boxes_translation_18.6s.h5").camera
    assert (round(found.fx, 3), round(found.k1, 4)) == (199.092, -0.3684)
    assert str(found) == (
        "f = 199.092, 198.829 px, centre 132.192, 110.713 px, k1 = -0.368436, k2 = 0.150947, p1 = -0.000296131, "
        "p2 = -0.000759432"
    )


NEEDED = "fx fy cx cy k1 k2 p1 p2 k3 is needed, nine numbers"
BAD = {
    "empty.txt": ("", "empty; fx fy cx cy k1 k2 p1 p2 k3 is needed, a camera_info YAML, or HDF5"),
    "words.txt": ("1 2 x 4", f"'1 2 x 4': {NEEDED}"),
    "ten.txt": ("1 " * 10, f"'1 1 1 1 1 1 1 1 1 1': {NEEDED}"),
    "zero.txt": ("0 1 2 3", "fx = 0, fy = 1: focal lengths above 0 px are needed"),
    "binary.txt": (b"\x80\x81\xff", "no readable calibration ("),
    "fisheye.yaml": (CALIBRATOR.replace("plumb_bob", "equidistant"), "distortion_model 'equidistant': plumb_bob is"),
    "eight.yaml": (CALIBRATOR.replace("-0.0008, 0]", "0, 0, 1, 2]"), "distortion_coefficients: 0 or 4 or 5 numbers"),
    "skew.yaml": (CALIBRATOR.replace("[199.09, 0,", "[199.09, 3,"), "camera_matrix: fx 0 cx, 0 fy cy, 0 0 1 is needed"),
    "none.yaml": ("a: 1\n", "camera_matrix: 9 numbers are needed, as in camera_info"),
    "list.yaml": ("- a: 1\n", "camera_matrix: 9 numbers are needed, as in camera_info"),
    "broken.yaml": ("a: [1\nb: }", "no readable YAML ("),
    "deep.yaml": (CALIBRATOR + "a: " + "[" * 20_000, "no readable YAML (nested too deeply)"),
    "aliases.yaml": ("a: &a [1]\n" + CALIBRATOR + "b: *a\n", "no readable YAML (aliases are not read)"),
    "true.yaml": (CALIBRATOR.replace("0, 0, 1]", "0, 0, true]", 1), "camera_matrix: 9 numbers are needed"),
    "huge.yaml": (CALIBRATOR.replace("199.09", "9" * 5000), "camera_matrix: 9 numbers are needed"),
    "long.yaml": (CALIBRATOR + "#" * (1 << 16), "no calibration: larger than 64 kB"),
    "negative.yaml": (CALIBRATOR.replace("[199.09", "[-199.09"), "fx = -199.09, fy = 198.83: focal lengths above 0 px"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files(name, tmp_path):
    content, message = BAD[name]
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ConfigError) as caught:
        read_calibration(tmp_path / name)
    said = str(caught.value)
    assert said.startswith(f"{tmp_path / name}: {message}") and "\n" not in said


@pytest.mark.parametrize("content, needed", [
    ({}, "no calibration; the data set /camera_calibration is needed"),
    ({"camera_calibration/a": 1}, "/camera_calibration: f"),
    ({"camera_calibration": [1.0, 2.0]}, "/camera_calibration: f"),
])  # fmt: skip
def test_bad_hdf5(content, needed, tmp_path):
    with h5py.File(tmp_path / "rec.h5", "w") as file:
        for name, values in content.items():
            file[name] = values
    with pytest.raises(ConfigError, match=rf"^{tmp_path}/rec.h5: {needed}"):
        read_calibration(tmp_path / "rec.h5")


def test_what_a_calibration_does_not_need_is_no_matter(tmp_path):
    """Impossible dates, numbers without an end, and tags stay texts."""
    text = CALIBRATOR + f"a: 2024-13-45\nb: {'9' * 5000}\nc: !!python/object/apply:os.system [x]\n"
    (tmp_path / "a.yaml").write_text(text)
    assert read_calibration(tmp_path / "a.yaml").size == (240, 180)


@pytest.mark.parametrize("name, why", [("pipe", "not a regular file"), ("none", "No such file or directory")])
def test_what_is_no_file(tmp_path, name, why):
    os.mkfifo(tmp_path / "pipe")  # which nobody writes to
    with pytest.raises(ConfigError, match=rf"{name}: no readable calibration \({why}\)$"):
        read_calibration(tmp_path / name)


@pytest.mark.parametrize("name", LENSES)
def test_opencv_undistorts_the_same(name):
    cv2 = pytest.importorskip("cv2")
    camera = LENSES[name]
    y, x = (axis.ravel() for axis in np.mgrid[0:180, 0:240])
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    pixels = np.stack([x, y], axis=1).astype(float)[:, None]
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    wanted = (
        cv2.undistortPointsIter(pixels, matrix, np.array(astuple(camera)[4:]), None, matrix, until)
        if hasattr(cv2, "undistortPointsIter")
        else cv2.undistortPoints(pixels, matrix, np.array(astuple(camera)[4:]), P=matrix, criteria=until)
    )
    assert np.abs(camera.undistorted(x, y) - wanted[:, 0].T).max() < 1e-6
    assert np.abs(camera.distorted(*camera.undistorted(x, y)) - [x, y]).max() < 1e-6


def test_a_distortion_that_no_lens_has_is_refused():
    with pytest.raises(ConfigError, match=r"^camera: f = 100, 100 px, centre 50, 50 px, k1 = -2: no ray is seen at "):
        Camera(100.0, 100.0, 50.0, 50.0, -2.0).rays(np.arange(240.0), np.zeros(240))


def turned(omega, seconds, rays):
    """Rays of still points after a camera has turned, by Rodrigues' formula: nothing of the module under test."""
    angle = -np.linalg.norm(omega) * seconds  # the scene turns the other way
    x, y, z = np.divide(omega, np.linalg.norm(omega))
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    moved = matrix @ np.stack([*rays, np.ones(rays.shape[1])])
    return moved[:2] / moved[2]


@pytest.mark.parametrize("omega", [(0.5, 0.0, 0.0), (0.0, -0.7, 0.0), (0.0, 0.0, 2.0), (0.3, -0.4, 1.0)])
@pytest.mark.parametrize("camera", LENSES.values(), ids=LENSES)
def test_speeds_are_those_of_a_scene_that_stands_still(camera, omega, rng):
    at = rng.uniform([[20], [20]], [[219], [159]], (2, 50))
    seconds, rays = 1e-4, camera.rays(*at)
    after, before = (camera.pixels(*turned(omega, step, rays)) for step in (seconds, -seconds))
    assert np.allclose(camera.speeds(omega, *at), (after - before) / (2 * seconds), rtol=1e-4, atol=1e-3)
