"""True flow of every pixel, as data sets have it: read back, and beside the tiles of flow."""

import csv
import json
import struct
import zlib

import h5py
import numpy as np
import pytest

from cmfpga.cli import accuracy, track
from cmfpga.errors import RecordingError
from cmfpga.events import write_hdf5
from cmfpga.show.export import _write_png
from cmfpga.truth import FIELD, read_known
from cmfpga.truth.fields import read_png
from support.flowing import CAMERA, OMEGA

ROWS, COLUMNS, END_US = 96, 128, 100_000


@pytest.fixture(scope="module")
def flow():
    """px/s of the turning camera at each pixel, [rows, columns, 2]; unknown in the upper third."""
    row, column = np.mgrid[:ROWS, :COLUMNS]
    found = CAMERA.speeds(OMEGA, column.ravel(), row.ravel()).T.reshape(ROWS, COLUMNS, 2)
    found[: ROWS // 3] = np.nan
    return found


def write_dsec(path, flow, times):
    (path / "forward").mkdir(parents=True)
    for k, (begin, end) in enumerate(times):
        raw = np.rint(np.nan_to_num(flow) * (end - begin) * 1e-6 * 128 + 2**15)
        image = np.concatenate([raw, np.isfinite(flow[..., :1])], axis=2)
        _write_png(path / "forward" / f"{2 * k:06}.png", image.astype(">u2"))
    text = "".join(f"{begin}, {end}\n" for begin, end in times)
    (path / "forward_timestamps.txt").write_text(f"# from_timestamp_us, to_timestamp_us\n{text}")
    return path


def written(folder, form, flow, steps=2):
    """The same flow from 0 to the end, in so many windows."""
    every = np.linspace(0, END_US, steps + 1)[:-1]
    px = np.nan_to_num(np.stack([flow] * steps)) * END_US * 1e-6 / steps
    path = folder / f"truth{form}"
    if form == "":
        return write_dsec(path, flow, [(int(t), int(t) + END_US // steps) for t in every])
    if form == ".npz":
        np.savez(path, timestamps=every * 1e-6, x_flow_dist=px[..., 0], y_flow_dist=px[..., 1])
        return path
    with h5py.File(path, "w") as file:
        file["davis/left/flow_dist"], file["davis/left/flow_dist_ts"] = np.moveaxis(px, 3, 1), every * 1e-6
    return path


@pytest.mark.parametrize("form", ["", ".npz", ".h5"])
def test_a_mean_over_time_is_that_of_what_overlaps(form, flow, tmp_path):
    known = read_known(written(tmp_path, form, flow))
    assert known.kind == FIELD and known.rows == 2 and known.signal.last == pytest.approx(END_US)
    for begin, end in ((0, END_US), (20_000, 60_000), (40_000, 104_000)):
        np.testing.assert_allclose(known.signal.mean(begin, end), flow, atol=1 / 64 / 0.05, equal_nan=True)
    assert np.isnan(known.signal.mean(95_000, 107_000)).all()


def test_two_windows_count_by_their_time(flow, tmp_path):
    path = write_dsec(tmp_path / "a", flow, [(0, 40_000), (40_000, 60_000)])
    _write_png(path / "forward" / "000002.png", np.full((ROWS, COLUMNS, 3), 2**15, ">u2"))
    known = read_known(path / "forward").signal
    np.testing.assert_allclose(known.mean(30_000, 60_000), flow / 3, atol=0.2, equal_nan=True)


@pytest.mark.parametrize("kind", range(5))
def test_every_filter_of_png(kind, rng, tmp_path):
    image = rng.integers(0, 1 << 16, (7, 5, 3)).astype(">u2")
    raw = image.view(np.uint8).reshape(7, 5, 6).astype(int)
    left, up = np.zeros_like(raw), np.zeros_like(raw)
    left[:, 1:], up[1:] = raw[:, :-1], raw[:-1]
    corner = np.zeros_like(raw)
    corner[1:, 1:] = raw[:-1, :-1]
    near = [abs(left + up - corner - one) for one in (left, up, corner)]
    paeth = np.where((near[0] <= near[1]) & (near[0] <= near[2]), left, np.where(near[1] <= near[2], up, corner))
    lines = (raw - [0 * raw, left, up, (left + up) // 2, paeth][kind]) % 256
    packed = zlib.compress(b"".join(bytes([kind]) + line.astype(np.uint8).tobytes() for line in lines))
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", 5, 7, 16, 2, 0, 0, 0)), (b"IDAT", packed[:9]), (b"IDAT", packed[9:])]
    data = (struct.pack(">I", len(body)) + name + body + bytes(4) for name, body in chunks)
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(data))
    assert (read_png(tmp_path / "a.png") == image).all()


def test_tiles_beside_a_field(command, turning, flow, tmp_path):
    """Each form tells the figures of the others, and those of the field at the tiles."""
    write_hdf5(tmp_path / "turn.h5", turning.events, COLUMNS, ROWS)
    how = ("--flow", "--camera", CAMERA.text, "--engine", "model", "--window-events", 9000, "--batches", 1)
    told = []
    for form in ("", ".npz"):
        truth = written(tmp_path, form, flow)
        done = command(accuracy, tmp_path / "turn.h5", *how, "--truth", truth, "--json", "--out", tmp_path / "out")
        assert done.status == 0, done.error
        told.append(json.loads(done.out))
    assert told[0]["trusted"]["aee_px"] == pytest.approx(told[1]["trusted"]["aee_px"], abs=0.02)
    assert told[0]["compared"] == told[1]["compared"] and told[0]["truth"]["kind"] == FIELD
    assert told[0]["trusted"]["count"] > 8 and told[0]["trusted"]["median_px"] < 0.5 and told[0]["trusted"]["fwl"] > 1
    assert {"0.6", "1", "3"} == {*told[0]["trusted"]["above"]} and not told[0]["delay_fitted"]
    rows = [*csv.DictReader((tmp_path / "out" / "accuracy.csv").read_text().splitlines())]
    tiles = [*csv.DictReader((tmp_path / "out" / "flow.csv").read_text().splitlines())]
    assert len(rows) == told[0]["compared"] and told[0]["not_covered"] > 5  # tiles of the upper third
    for row in rows:
        tile = tiles[int(row["tile"])]
        y, x = (int(tile[axis]) + int(tile[side]) // 2 for axis, side in (("y", "height"), ("x", "width")))
        assert int(tile["y"]) + int(tile["height"]) > ROWS // 3
        near = flow[max(y, ROWS // 3 + 8) - 8 : y + 8, max(x - 8, 0) : x + 8].reshape(-1, 2)
        assert (near.min(axis=0) - 12 < [float(row["true_vx"]), float(row["true_vy"])]).all()
        assert (near.max(axis=0) + 12 > [float(row["true_vx"]), float(row["true_vy"])]).all()


def test_what_is_no_field(command, turning, flow, tmp_path):
    write_hdf5(tmp_path / "turn.h5", turning.events, COLUMNS, ROWS)
    truth = written(tmp_path, "", flow)
    assert "a flow field; cmfpga accuracy --flow is needed" in command(
        track, tmp_path / "turn.h5", "--roi", "1,1", "--truth", truth).error  # fmt: skip
    small = write_dsec(tmp_path / "small", flow[:40, :30], [(0, END_US)])
    wrong = command(accuracy, tmp_path / "turn.h5", "--flow", "--truth", small, "--engine", "model")
    assert "small: flow of 30×40 px; the sensor has 128×96 px" in wrong.error and wrong.status == 2
    (truth / "forward_timestamps.txt").write_text("0, 5\n")
    np.savez(tmp_path / "a.npz", timestamps=[0.0, 1.0], x_flow_dist=np.zeros((2, 3)))
    (small / "forward" / "000000.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    for path, message in (
        (truth, "begin and end, µs, of each of 2 images"), (tmp_path / "a.npz", "no flow as MVSEC has it"),
        (small, "no flow as DSEC has it, RGB of 16 bits"), (tmp_path, "a folder without forward"),
    ):  # fmt: skip
        with pytest.raises(RecordingError, match=message) as caught:
            read_known(path)
        assert "\n" not in str(caught.value)


IMAGES, PAIR = np.zeros((2, 3, 4)), np.zeros((2, 2, 3, 4))
BAD_NPZ = {
    "lengths differ": {"timestamps": [0.0, 1.0, 2.0], "x_flow_dist": IMAGES, "y_flow_dist": IMAGES},
    "not of pixels": {"timestamps": [0.0, 1.0], "x_flow_dist": IMAGES, "y_flow_dist": IMAGES[:, :2]},
    "times that ascend": {"timestamps": [1.0, 0.0], "x_flow_dist": IMAGES, "y_flow_dist": IMAGES},
}
BAD_HDF5 = {
    "/flow: N×2×rows×columns is needed": {"flow": IMAGES[0]},
    "/flow: its times, /flow_ts, are needed": {"flow": PAIR},
    "/flow_ts: a time, or begin and end, is needed for each of 2 flows": {"flow": PAIR, "flow_ts": [1, 2, 3]},
    "windows in the order of time": {"flow": PAIR, "flow_ts": [[5, 9], [0, 4]]},
}


@pytest.mark.parametrize("wrong", [*BAD_NPZ, *BAD_HDF5])
def test_arrays_that_do_not_fit_are_named_in_a_line(wrong, tmp_path):
    path = tmp_path / ("a.npz" if wrong in BAD_NPZ else "a.h5")
    if wrong in BAD_NPZ:
        np.savez(path, **BAD_NPZ[wrong])
    else:
        with h5py.File(path, "w") as file:
            file.update(BAD_HDF5[wrong])
    with pytest.raises(RecordingError, match=rf"^{path}: .*{wrong}") as caught:
        read_known(path)
    assert "\n" not in str(caught.value)


def test_a_folder_without_times(flow, tmp_path):
    truth = written(tmp_path, "", flow)
    (truth / "forward_timestamps.txt").unlink()
    with pytest.raises(RecordingError, match=r"of each of 2 images are needed: No such file"):
        read_known(truth)
