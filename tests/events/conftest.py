"""Events, and files of them in every format, written without the code under test."""

import zipfile

import h5py
import numpy as np
import pytest

from cmfpga.events import Events


def make_events(rng, count=1000, width=240, height=180, step=20):
    """Random events; many time stamps are equal, as in recordings."""
    t = 5_000 + np.cumsum(rng.integers(0, step, count) * rng.integers(0, 2, count))
    return Events(t, rng.integers(width, size=count), rng.integers(height, size=count), rng.integers(2, size=count))


def seconds(t):
    """Times in µs as exact decimals in seconds, with nine decimals as in the DAVIS 240C data set."""
    sign = "-" if t < 0 else ""
    return f"{sign}{abs(t) // 10**6}.{abs(t) % 10**6:06d}000"


def text_lines(t, x, y, p):
    return "".join(f"{seconds(int(a))} {b} {c} {int(d)}\n" for a, b, c, d in zip(t, x, y, p, strict=True))


def write_text(path, t, x, y, p):
    path = path.with_suffix(".txt")
    path.write_text(text_lines(t, x, y, p))
    return path


def write_zip(path, t, x, y, p):
    path = path.with_suffix(".zip")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("images.txt", "0.0 images/frame_00000000.png\n")
        archive.writestr("slider/events.txt", text_lines(t, x, y, p))
    return path


def write_h5(path, t, x, y, p):
    path = path.with_suffix(".h5")
    with h5py.File(path, "w") as file:
        for name, values in zip("txyp", (t, x, y, p), strict=True):
            file[f"events/{name}"] = values
    return path


def structured(t, x, y, p):
    array = np.zeros(len(t), [("x", "<i2"), ("y", "<i2"), ("t", "<i8"), ("p", "i1")])
    for name, values in zip("txyp", (t, x, y, p), strict=True):
        array[name] = values
    return array


def write_npy(path, t, x, y, p):
    path = path.with_suffix(".npy")
    np.save(path, structured(t, x, y, p))
    return path


def write_npz(path, t, x, y, p):
    path = path.with_suffix(".npz")
    np.savez_compressed(path, t=t, x=x, y=y, p=p)
    return path


WRITERS = {"hdf5": write_h5, "text": write_text, "zip": write_zip, "npy": write_npy, "npz": write_npz}


@pytest.fixture(params=WRITERS)
def write(request, tmp_path):
    """``write(t, x, y, p)``: the path of a file of these columns; the test runs once per format."""

    def write(t, x, y, p):
        return WRITERS[request.param](tmp_path / "recording", *map(np.asarray, (t, x, y, p)))

    return write


def read_all(recording, **options):
    return Events.concatenate(recording.chunks(**options))


def assert_same(a, b):
    for name in "txyp":
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


class Helpers:
    """The functions above, for tests: test folders are no packages."""

    make_events = staticmethod(make_events)
    read_all = staticmethod(read_all)
    assert_same = staticmethod(assert_same)
    structured = staticmethod(structured)
    text_lines = staticmethod(text_lines)


@pytest.fixture
def helpers():
    return Helpers
