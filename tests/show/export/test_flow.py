"""Flow as data sets have it, read back: the flow of each window's tiles at each pixel, bit for bit."""

import re
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from cmfpga.cli import flow as command_module
from cmfpga.dense import Tiles
from cmfpga.errors import ConfigError
from cmfpga.events import write_hdf5
from cmfpga.show.export import export_flow

#: Of a sensor of 20×12 px two by three tiles of 8 px, every 6 and 4 px: a border of 2 columns is in none.
X, Y = [0, 5, 10], [0, 4]


@pytest.fixture
def flow():
    """Three windows, the second without events; in the last one a tile is too fast for 16 bits."""
    v = np.random.default_rng(4).normal(0, 300, (3, 6, 2))
    v[2, 4] = 30_000, 0
    trusted = np.array([[1, 1, 0, 1, 1, 1], [0] * 6, [1, 0, 1, 1, 1, 1]])
    v[trusted == 0] = np.nan
    times = np.array([[1000, 21_000], [-1, -1], [41_500, 61_500]])
    arrays = {"v": v, "trusted": trusted, "window_events": np.array([9, 0, 7]), "t": times}
    sensor = SimpleNamespace(sensor_width=20, sensor_height=12)
    return SimpleNamespace(arrays=arrays, config=sensor, tiles=Tiles(X, Y, 8, 8, ()))


def expected(flow, window, seconds):
    """Pixel by pixel: the motion of the nearest tile; 0, and False, where there is none that is trusted."""
    moved, there = np.zeros((12, 20, 2)), np.zeros((12, 20), bool)
    for y in range(12):
        for x in range(20):
            away = [abs(x - left - 3.5) for left in X], [abs(y - top - 3.5) for top in Y]
            column, row = (int(np.argmin(one)) for one in away)
            if max(away[0][column], away[1][row]) < 4 and flow.arrays["trusted"][window, 3 * row + column]:
                moved[y, x], there[y, x] = flow.arrays["v"][window, 3 * row + column] * seconds, True
    return moved, there


def png(path):
    """The pixels of an RGB image with 16 bits each."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image.dtype == np.uint16 and image.shape[2] == 3
    return image[..., ::-1]


def test_dsec(flow, tmp_path):
    export_flow(flow, tmp_path / "out")
    names = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file())
    assert names == ["out/forward/000000.png", "out/forward/000001.png", "out/forward_timestamps.txt"]
    lines = (tmp_path / "out" / "forward_timestamps.txt").read_text().splitlines()
    assert lines == ["# from_timestamp_us, to_timestamp_us", "1000, 21000", "41500, 61500"]
    for k, window in enumerate((0, 2)):
        image = png(tmp_path / "out" / "forward" / f"{k:06}.png")
        moved, there = expected(flow, window, 0.02)
        fits = there & (np.abs(moved) < 255.9).all(axis=2)
        assert (image[..., 2] == fits).all() and 0 < fits.sum() < fits.size
        assert (image[..., :2] == np.where(fits[..., None], np.rint(moved * 128) + 2**15, 2**15)).all()
    assert (fits != there).any()  # what is too fast


def test_mvsec(flow, tmp_path):
    """Flow k is over the time to the next one, of the last window over its own."""
    export_flow(flow, tmp_path / "out.npz")
    with np.load(tmp_path / "out.npz") as found:
        assert {*found} == {"timestamps", "x_flow_dist", "y_flow_dist"}
        assert found["timestamps"].tolist() == [1000 * 1e-6, 41_500 * 1e-6]
        for k, (window, us) in enumerate(((0, 40_500), (2, 20_000))):
            moved, _ = expected(flow, window, us * 1e-6)
            for axis in (0, 1):
                assert (found[f"{'xy'[axis]}_flow_dist"][k] == moved[..., axis]).all()


def test_the_command(command, sliding, tmp_path):
    write_hdf5(tmp_path / "slide.h5", sliding.events, 128, 96)
    options = ["--engine", "model", "--window-events", 9000, "--windows", 1, "--no-picture", "--out", tmp_path / "out"]
    export = ["--export", tmp_path / "a.npz", "--export", tmp_path / "a"]
    done = command(command_module, tmp_path / "slide.h5", *options, *export)
    assert done.status == 0 and f"wrote {tmp_path / 'a.npz'}\nwrote {tmp_path / 'a'}\n" in done.out, done.err
    image = png(tmp_path / "a" / "forward" / "000000.png")
    with np.load(tmp_path / "a.npz") as found, np.load(tmp_path / "out" / "flow.npz") as arrays:
        there = image[..., 2] == 1
        tiles = (arrays["v"][0] * ((arrays["t"][0, 1] - arrays["t"][0, 0]) * 1e-6))[arrays["trusted"][0] == 1]
        assert {*found["x_flow_dist"][0][there].tolist()} <= {*tiles[:, 0].tolist()} and there.any()
        assert (image[there, 0] == np.rint(found["x_flow_dist"][0][there] * 128) + 2**15).all()


@pytest.mark.parametrize("name, message", [
    ("x.png", "a name that ends in .npz, or a folder's without an ending, is needed"),
    ("none/x.npz", "no such folder"),
    ("there", "exists already; another name is needed"),
])  # fmt: skip
def test_names_that_cannot_be_written(command, flow, tmp_path, name, message):
    (tmp_path / "there").mkdir()
    done = command(command_module, "--out", tmp_path / "out", "--export", tmp_path / name)
    assert done.error.startswith(f"argument --export: export {tmp_path / name}: ") and message in done.error
    with pytest.raises(ConfigError, match=re.escape(message)):
        export_flow(flow, tmp_path / name)
    assert not (tmp_path / "out").exists()
