"""Files of a true motion: each kind, as it is found in the wild, and what is refused."""

import math

import numpy as np
import pytest

from cmfpga.errors import RecordingError
from cmfpga.truth import read_known
from cmfpga.truth.pieces import Signal


@pytest.fixture
def read(tmp_path):
    def read(text, unit=None):
        (tmp_path / "truth.txt").write_text(text)
        return read_known(tmp_path / "truth.txt", unit)

    return read


def at(known, t):
    """The value at a time, s."""
    t = np.array([t * 1e6])
    return known.signal.mean(t - 50, t + 50)[0]


@pytest.mark.parametrize("text", [
    "0.5 10 -20\n1.5 30 -20\n",
    "t vx vy\n0.5 10 -20\n1.5 30 -20\n",
    "\ufeff# time [ms], vy (px/s), vx (px/s), note\n500, -20, 10, 0\n1500, -20, 30, 0\n",
    "t_ns;vx_px_per_s;vy_px_per_s\n500000000;10;-20\n\n1500000000;30;-20  # the end\n",
    "500000 10 -20\n1500000 30 -20\n",
])  # fmt: skip
def test_velocity_is_a_line_between_samples(read, text):
    known = read(text)
    assert (known.kind, known.rows, known.signal.first, known.signal.last) == ("velocity", 2, 5e5, 1.5e6)
    np.testing.assert_allclose(at(known, 1.0), [20, -20])


def test_a_sidecar_holds_each_velocity(read):
    known = read("t_us,vx_px_per_s,vy_px_per_s\n0,1,2\n1000000,3,4\n")
    np.testing.assert_allclose([at(known, 0.9), at(known, 5.0)], [[1, 2], [3, 4]])
    assert known.signal.last == math.inf and "to the end" in known.text


@pytest.mark.parametrize("text, unit", [
    ("0.5 1 2 3\n0.6 1 2 3\n", None),
    ("0.5 9 9 9 1 2 3\n0.6 9 9 9 1 2 3\n", None),
    ("500 1 2 3\n600 1 2 3\n", "ms"),
    ("t [s] wz [deg/s] wx [rad/s] wy [rad/s]\n0.5 171.88733853924697 1 2\n0.6 171.88733853924697 1 2\n", None),
    ("#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1]\n5e8,1,2,3\n6e8,1,2,3\n", None),
])  # fmt: skip
def test_a_gyroscope(read, text, unit):
    known = read(text, unit)
    assert known.kind == "gyroscope" and known.signal.first == 5e5
    np.testing.assert_allclose(at(known, 0.55), [1, 2, 3])


def test_poses_are_rates_along_the_cameras_axes(read):
    """The camera turns about its z by 0.5 rad/s, half a turn ahead, while it moves along the world's x."""
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    for t in np.arange(0, 1.01, 0.05):
        angle, sign = math.pi / 2 + 0.5 * t, -1 if round(t * 20) % 2 else 1  # q and −q are the same
        lines.append(f"{t:.3f} {0.2 * t} 0 0 0 0 {sign * math.sin(angle / 2)} {sign * math.cos(angle / 2)}")
    known = read("\n".join(lines))
    found = at(known, 0.025)
    assert known.kind == "poses" and known.signal.last == 1e6
    angle = math.pi / 2 + 0.5 * 0.025
    moved = [0.2 * math.cos(angle), -0.2 * math.sin(angle), 0]
    np.testing.assert_allclose(found, [0, 0, 0.5, *moved], atol=1e-4)


HEAD = "t px py pz qx qy qz qw\n"


@pytest.mark.parametrize("text, message", [
    ("", ": no rows of numbers; t vx vy"),
    ("t vx vy\n", ": no rows of numbers; t vx vy"),
    ("0 1 2\n", ": 1 row; two or more are needed"),
    ("0 1 2\n1 nan 2\n", ", line 2: finite numbers are needed, no NaN"),
    ("0 1 2\n1 2\n", ", line 2: 3 numbers are needed"),
    ("0 1 2\n1 2 x\n", ", line 2: 3 numbers are needed"),
    ("0 1\n1 2\n", ", line 1: 3 numbers are needed"),
    ("0.1 1 2\n0.1 1 2\n", ", row 2: its time is not after that of the row before; it must increase"),
    ("0 1 2 3 4\n1 1 2 3 4\n", ": 5 columns: of no known kind"),
    ("t foo bar\n0 1 2\n1 2 3\n", ": columns t, foo, bar: of no known kind"),
    ("t vx vx\n0 1 2\n1 2 3\n", ": a column is named twice in t, vx, vx"),
    ("t vx [m/s] vy\n0 1 2\n1 2 3\n", ": vx in 'm/s': px/s is needed"),
    ("t [h] vx vy\n0 1 2\n1 2 3\n", ": t in 'h': one of s, ms, us, ns is needed"),
    (HEAD + "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 2\n", ", row 2: qx qy qz qw are no rotation: of length 2, not 1"),
    ("\0\0", ": no text; t vx vy"),
])  # fmt: skip
def test_what_is_refused(read, text, message):
    with pytest.raises(RecordingError) as error:
        read(text)
    assert f"truth.txt{message}" in str(error.value) and "\n" not in str(error.value)


def test_no_file(tmp_path):
    for path in (tmp_path / "none.txt", tmp_path, "a\0b"):
        with pytest.raises(RecordingError, match="cannot be read"):
            read_known(path)


@pytest.mark.parametrize("end", [None, 2e6])
def test_means_of_a_signal(rng, end):
    times = np.sort(rng.uniform(0, 1e6, 20))
    values = rng.normal(size=(20, 2))
    signal = Signal(times, values, end)
    t0, t1 = times[[3, 0, 7]] + 11.0, times[[15, 1, 8]] + 7.0
    fine = np.linspace(t0, t1, 20_001)
    piece = np.clip(np.searchsorted(times, fine, "right") - 1, 0, None)
    for axis in (0, 1):
        exact = np.interp(fine, times, values[:, axis]) if end is None else values[piece, axis]
        np.testing.assert_allclose(signal.mean(t0, t1)[:, axis], exact.mean(axis=0), atol=2e-3)
    assert signal.covers(np.array([times[0], times[0] - 1]), np.array([1e5, 1e5])).tolist() == [True, False]
