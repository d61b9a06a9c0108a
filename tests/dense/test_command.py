"""``cmfpga flow`` and ``cmfpga.dense.flow``: files, summary, what both refuse."""

import csv
import json

import h5py
import numpy as np
import pytest

import cmfpga
from cmfpga.api.flow import configure
from cmfpga.cli import flow
from cmfpga.config import preset
from cmfpga.dense import fields
from cmfpga.dense.window import COLUMNS
from cmfpga.events import Events, MemoryRecording, write_hdf5
from support.flowing import CAMERA, OMEGA

MODEL = ("--engine", "model", "--window-events", 9000)


@pytest.fixture(scope="module")
def slide(sliding, tmp_path_factory):
    path = tmp_path_factory.mktemp("flow") / "slide.h5"
    write_hdf5(path, sliding.events, 128, 96)
    return path


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return [*csv.DictReader(file)]


def test_files_and_summary(command, slide, sliding, tmp_path):
    done = command(flow, slide, *MODEL, "--fit", "translation", "--out", tmp_path, "--every-picture", "--json")
    assert done.status == 0, done.err
    told = json.loads(done.out)
    assert told["windows"] == 2 and told["events"] + told["leftover"] == len(sliding.events) and not told["outside"]
    names = {"flow.csv", "fit.csv", "flow.npz", "flow.png", "flow.html", "flow-0.png", "flow-1.png"}
    assert {path.name for path in tmp_path.iterdir()} == names == {path.rpartition("/")[2] for path in told["files"]}
    with np.load(tmp_path / "flow.npz") as arrays:
        shapes = {name: column.shape for name, column in COLUMNS.items() if column.shape}
        assert {*arrays} == {*shapes, "head"}
        sizes = {"W": 2, "n": told["tiles"], "p": 2}
        for name, shape in shapes.items():
            wanted = [sizes.get(part) or int(part) for part in shape.strip("[]").split(", ")]
            assert [*arrays[name].shape] == wanted, name
        v, trusted = arrays["v"], arrays["trusted"]
        head = json.loads(str(arrays["head"]))
    assert head["recording"] == "slide.h5" and head["image"] == ""
    found = rows(tmp_path / "flow.csv")
    assert len(found) == 2 * told["tiles"] and trusted.sum() == told["trusted"]
    speeds = [float(np.hypot(*v[k, tile])) for k, tile in zip(*np.nonzero(trusted), strict=True)]
    assert told["speed_px_per_s"] == pytest.approx(np.percentile(speeds, (50, 95)), abs=0.01) and len(speeds) > 9
    for k, row in enumerate(found):
        if row["vx_px_per_s"]:
            assert float(row["vx_px_per_s"]) == pytest.approx(v.reshape(-1, 2)[k, 0], abs=1e-3)
        flags = {*row["flags"].split("|")}
        assert trusted.ravel()[k] == int(row["trusted"]) <= (not flags & {"degenerate", "doubtful", "short"})
    fits = rows(tmp_path / "fit.csv")
    assert [float(fit["vx_px_per_s"]) for fit in fits] == [fit["vx_px_per_s"] for fit in told["fits"]]
    assert float(fits[0]["vx_px_per_s"]) == pytest.approx(90, abs=10)


def test_slices_without_events_are_told(command, sliding, tmp_path):
    events, late = sliding.events[:6000], sliding.events.t[:6000].copy()
    late[3000:] += 60_000
    write_hdf5(tmp_path / "pause.h5", Events(late, events.x, events.y, events.p), 128, 96)
    how = ("--engine", "model", "--slices", 2, "--window-us", 16_000, "--windows", 2)
    done = command(flow, tmp_path / "pause.h5", *how, "--out", tmp_path, "--no-picture")
    assert done.status == 0 and "\n7 slices without events, passed over\n" in done.out, done


@pytest.mark.usefixtures("long_tools")
def test_a_recording_is_undistorted_by_its_own_calibration(command, turning, tmp_path):
    turn = tmp_path / "turn.h5"
    write_hdf5(turn, turning.events, 128, 96)
    with h5py.File(turn, "r+") as file:
        file["camera_calibration"] = [*map(float, CAMERA.text.split(","))]
    done = command(flow, turn, *MODEL, "--fit", "rotation", "--out", tmp_path, "--no-picture")
    assert done.status == 0, done.err
    assert {row["image"] for row in rows(tmp_path / "flow.csv")} == {"undistorted"}
    for fit in rows(tmp_path / "fit.csv"):
        found = np.array([float(fit[f"w{axis}_rad_per_s"]) for axis in "xyz"])
        assert np.linalg.norm(found - OMEGA) < np.radians(2) + 0.07 * np.linalg.norm(OMEGA)
    assert "± " in done.out and not (tmp_path / "flow.png").exists()
    # Not where it is switched off; then there is no camera to turn.
    off = command(flow, turn, *MODEL, "--set", "undistortion=off", "--out", tmp_path, "--no-picture")
    assert off.status == 0 and "image" not in rows(tmp_path / "flow.csv")[0]
    refused = command(flow, turn, *MODEL, "--set", "undistortion=off", "--fit", "rotation", "--out", tmp_path)
    assert "a calibration is needed" in refused.error


@pytest.mark.parametrize(("verilog", "slices"), [("rtl", 1), ("rtl", 2), ("axi", 2)])
def test_the_verilog_finds_the_same_as_the_model(command, compiler, slide, tmp_path, verilog, slices):
    files, length = [], ("--window-events", 4000, "--windows", 2, "--slices", slices)
    for engine in (verilog, "model"):
        folder = ("--out", tmp_path / engine, "--no-picture")
        done = command(flow, slide, "--engine", engine, *length, *folder, "--set", "units=2", "--json")
        assert done.status == 0, done.err
        files.append((tmp_path / engine / "flow.csv").read_bytes())
        told = json.loads(done.out)
        assert told["events"] == 8000 and told["config"]["slices"] == slices
        assert told["cycles"] is None if engine == "model" else told["cycles"] > 2 * 4000
    assert files[0] == files[1] and len(files[0]) > 1000
    found, times = rows(tmp_path / "model" / "flow.csv"), np.load(tmp_path / "model" / "flow.npz")["t"]
    assert [row["t_ref_us"] for row in found[:: len(found) // 2]] == [f"{t.mean():.1f}" for t in times]
    assert [row["window"] for row in found[:: len(found) // 2]] == ["0", "1"]
    assert (times[1, 0] < times[0, 1]) == (slices > 1)


def test_from_python_it_is_the_same(command, slide, tmp_path):
    """What is left over is known although the file is closed at the end."""
    assert command(flow, slide, *MODEL, "--out", tmp_path, "--no-picture").status == 0
    found = cmfpga.flow(slide, engine="model", window_events=9000)
    with np.load(tmp_path / "flow.npz") as arrays:
        for name, values in found.arrays.items():
            assert np.array_equal(arrays[name], values, equal_nan=True), name
    assert len(found) == 2 and "fit" not in found.arrays
    found = cmfpga.flow(slide, engine="model", window_events=6000, windows=1)
    assert len(found) == 1 and found.leftover == 24_233 - 6000


@pytest.mark.usefixtures("long_tools")
def test_without_a_recording_the_error_to_the_truth_is_told(command, tmp_path):
    done = command(flow, "--engine", "model", "--windows", 1, "--out", tmp_path, "--no-picture", "--json")
    error = json.loads(done.out)["error_px"]
    assert error["median"] < 0.35 and error["within_0.5"] > 0.7
    assert np.linalg.norm(fields.ROTATION) > 0.5  # or it would be easy


def test_the_page_holds_the_windows(command, slide, tmp_path):
    command(flow, slide, *MODEL, "--out", tmp_path)
    text = (tmp_path / "flow.html").read_text(encoding="utf-8")
    assert "http://" not in text and "https://" not in text and "{{" not in text
    head = json.loads(text.partition('<script type="application/json" id="head">')[2].partition("</script>")[0])
    found = rows(tmp_path / "flow.csv")
    shown = [[tile[1], tile[2]] for window in head["windows"] for tile in window["tiles"]]
    assert shown == [[row["vx_px_per_s"], row["vy_px_per_s"]] for row in found]


@pytest.mark.parametrize("told, why", [
    (["--tile", 4, "--step", 1], "at most 1024 are allowed (regions)"),
    (["--tile", 4, "--set", "regions=99"], "every 4 px: 772 regions on 128×96 px; at most 99 are"),
    (["--set", "regions=3"], "at most 3 are allowed (regions)"),
    (["--preset", "fast"], "preset 'fast' has no regions"),
    (["--fit", "shear"], "invalid choice: 'shear'"), (["--engine", "jtag"], "invalid choice: 'jtag'"),
    (["--start-event", 1_000_000], "0 to 24232 is allowed"), (["--window-us", 10_000_000], "too few events"),
    (["--picture", "x.gif"], "a name that ends in .png, .pdf, .svg"),
    (["--window-events", 5, "--window-us", 5], "not allowed with"),
    (["--slices", 3], "windows of 3 slices: a length (window_events, window_us) is needed"),
    (["--slices", 0], "a whole number of 1 or more is needed"),
    (["--slices", 2, "--window-us", 8000, "--background-us", 99], "background = 0 is needed"),
])  # fmt: skip
def test_what_is_refused(command, slide, tmp_path, told, why):
    assert why in command(flow, slide, "--engine", "model", *told, "--out", tmp_path).error


@pytest.mark.parametrize("sensor, tile, step, regions, events, bins", [
    ((240, 180), 32, 16, 192, 32_767, 4),
    ((320, 320), 32, 16, 386, 65_535, 4),
    ((346, 260), 32, 16, 366, 65_535, 4),
    ((640, 480), 32, 24, 620, 98_303, 5),
    ((1280, 720), 48, 36, 960, 98_303, 5),
    ((1280, 800), 48, 48, 719, 98_303, 5),
])  # fmt: skip
def test_tiles_and_store_by_sensor(sensor, tile, step, regions, events, bins):
    """What a table of 1024 regions and the 64 UltraRAMs of a KV260 hold; larger than the preset's: how it is built."""
    source = MemoryRecording(Events([0, 9], [1, 200], [1, 150], [0, 1]), *sensor)
    config, tiles, notes = configure(source, "flow", {}, None, None, str)
    assert (tiles.width, tiles.columns[1]) == (tile, step) and len(tiles.regions) <= config.regions == regions
    assert (config.max_batch_events, config.bin_bits) == (events, bins)
    readers = config.store.readers
    assert readers * 2 * -(-config.store.pages * 32 // 4096) + 2 * config.units * (readers > 1) <= 64
    assert len(notes) == (sensor != (240, 180))
    for built in notes:
        words = built.partition("the hardware: cmfpga build --preset flow ")[2].split()[1::2]
        assert preset("flow").replace(**config.parse(words)) == config
    given = {"max_batch_events": 4095, "bin_bits": 4}
    config, *_ = configure(source, "flow", given, None, None, str)
    assert (config.max_batch_events, config.bin_bits) == (4095, 4)


def test_refusals_without_a_usable_recording(command, tmp_path):
    assert "no such file" in command(flow, tmp_path / "none.h5").error.lower()
    assert "a RECORDING is needed" in command(flow, "--sensor", "64,48").error
    assert command(flow, "tcp://localhost:1").status == 2
