"""``cmfpga track`` on real recordings."""

import json

import numpy as np
import pytest

from cmfpga.cli import track
from cmfpga.config import Config
from cmfpga.engines import make_engine
from cmfpga.events import BatchCutter, open_recording
from cmfpga.protocol.flags import Flag
from cmfpga.tracking import loop
from support.tracks import but_cycles, flags, floats, looks_like_a_track


@pytest.fixture(scope="module")
def star(compiler, data_dir, tmp_path_factory, command, rows):
    """The recording in which a star moves to the right, its track by the Verilog, and the folder."""
    folder = tmp_path_factory.mktemp("star")
    recording = data_dir / "davis240c_shapes_rotation_0.0s.h5"
    options = ["--start-event", 15000, "--roi", "100,30", "--batches", 20, "--batch-events", 5000]
    options += ["--hot-pixels", "none"]
    done = command(track, recording, *options, "--preset", "paper", "--out", folder)
    assert (done.status, done.err) == (0, "")
    assert done.out.startswith("20 batches tracked (rtl engine), 0 with warnings, 0 events left over\n")
    return recording, options, rows(folder), folder


def test_the_roi_follows_the_star_to_the_right(star):
    _, _, found, folder = star
    assert len(found) == 20 and flags(found) == [""] * 20 and {row["events"] for row in found} == {"5000"}
    x, y, vx, vy = (floats(found, name) for name in ("roi_x", "roi_y", "vx", "vy"))
    assert (x[0], y[0]) == (100, 30)
    moving = slice(0, 17)  # it stops after batch 16
    assert (vx[moving] > 1).all() and (vx[moving] < 2).all() and (np.abs(vy) < 0.35).all()
    assert (np.diff(x[:18]) >= 0).all() and (np.abs(np.diff(x)) <= 4).all() and (np.abs(np.diff(y)) <= 1).all()
    assert x[17] - x[0] > 45 and np.abs(y - 30).max() <= 2
    assert (vx[-2:] < -1).all()  # it has turned
    # The speed in px/s, as it was measured by others for this stretch.
    speed = floats(found, "vx_px_per_s")
    assert 90 < np.median(speed[3:16]) < 140
    # ROI by twice v, up to the rounding of the position.
    np.testing.assert_allclose(np.diff(x), 2 * vx[:-1], atol=1)
    assert (floats(found, "contrast") > 0.5).all()
    looks_like_a_track(folder / "track.png")


def test_the_model_follows_the_star_alike_and_the_float_engine_nearly(star, command, rows, tmp_path):
    recording, options, found, _ = star
    paper = ["--preset", "paper", "--no-picture", "--out", tmp_path]
    assert command(track, recording, *options, *paper, "--engine", "model").status == 0
    assert rows(tmp_path) == but_cycles(found)
    assert command(track, recording, *options, *paper, "--engine", "float").status == 0
    other = rows(tmp_path)
    np.testing.assert_allclose(floats(other, "roi_x"), floats(found, "roi_x"), atol=1)
    np.testing.assert_allclose(floats(other, "vx"), floats(found, "vx"), atol=0.15)
    np.testing.assert_allclose(floats(other, "contrast"), floats(found, "contrast"), rtol=0.15)


def test_the_fast_hardware_follows_the_star(star, command, rows, tmp_path):
    """The default preset, in a tenth of the cycles, Verilog and model alike."""
    recording, options, slow, _ = star
    for engine in ("rtl", "model"):
        done = command(track, recording, *options, "--engine", engine, "--no-picture", "--out", tmp_path / engine)
        assert (done.status, done.complaints) == (0, [])
    found = rows(tmp_path / "rtl")
    assert rows(tmp_path / "model") == but_cycles(found) and flags(found) == [""] * 20
    assert [row["iterations"] for row in found] == ["5"] + ["3"] * 19
    x, vx = floats(found, "roi_x"), floats(found, "vx")
    assert (np.diff(x[:18]) >= 0).all() and (np.abs(np.diff(x)) <= 4).all() and (vx[:17] > 0.8).all()
    np.testing.assert_allclose(x[:18], floats(slow, "roi_x")[:18], atol=2)
    # Where it turns, the ROI goes on for a batch: with two buffers a move shows a batch later.
    np.testing.assert_allclose(x[18:], floats(slow, "roi_x")[18:], atol=5)
    assert floats(found, "cycles").sum() < floats(slow, "cycles").sum() / 10


@pytest.mark.parametrize("name, engine, options, vx, vy", [
    # Up at 500 to 620 px/s, and slowing.
    ("davis240c_shapes_translation_52.0s.h5", "rtl",
     ["--roi", "100,60", "--batch-events", 4000, "--preset", "paper"], (-30, 30), (-700, -420)),
    # To the left at about 120 px/s (ground truth from the gyroscope).
    ("davis240c_shapes_rotation_2.1s_gtflow.h5", "rtl",
     ["--roi", "100,60", "--batch-us", 20000], (-150, -110), (-30, 0)),
    # Up, measured at 30 to 33 px/s over the whole image.
    ("davis240b_evbench_seq0002.h5", "model",
     ["--roi", "60,100", "--batch-roi-events", 2000, "--batches", 5], (-10, 10), (-50, -28)),
])  # fmt: skip
def test_other_recordings_and_other_batches(request, data_dir, command, rows, tmp_path, name, engine, options, vx, vy):
    if engine == "rtl":
        request.getfixturevalue("compiler")
    done = command(track, data_dir / name, *options, "--engine", engine, "--out", tmp_path, "--no-picture")
    assert (done.status, done.complaints) == (0, [])
    found = rows(tmp_path)
    assert len(found) >= 4 and flags(found) == [""] * len(found)
    for axis, (low, high) in (("vx_px_per_s", vx), ("vy_px_per_s", vy)):
        assert low < np.median(floats(found, axis)) < high
    if "--batch-roi-events" in options:
        assert {row["roi_events"] for row in found} == {"2000"}


def test_a_real_overflow(data_dir, command, rows, tmp_path):
    """A bright dot with more events than the buffer holds, on another sensor than the default's."""
    how = "--roi 216,85 --batches 2 --engine model --set cold=0:1:1 --set when_full=drop --json".split()
    done = command(track, data_dir / "prophesee_spinner_640x480.h5", *how, "--out", tmp_path)
    assert (done.status, done.complaints) == (0, [])
    assert json.loads(done.out)["config"]["sensor_width"] == 640 and json.loads(done.out)["batches_with_warnings"] == 2
    assert flags(rows(tmp_path)) == ["overflow", "overflow|doubtful"]
    looks_like_a_track(tmp_path / "track.png", moves=False)


@pytest.mark.parametrize("name, roi, changes, expected", [
    ("davis240c_shapes_rotation_0.0s.h5", (100, 30), {"buffer_events": 64}, Flag.OVERFLOW),
    ("davis240c_shapes_translation_52.0s.h5", (0, 0), {"span_bits": 10}, Flag.TIME_SPAN),
    ("davis240c_translboxes_imu.h5", (176, 116), {"time_bits": 14, "span_bits": 13}, Flag.TIME_BACK),
    ("prophesee_spinner_640x480.h5", (210, 80), {"buffer_events": 100, "span_bits": 8}, Flag.OVERFLOW),
])  # fmt: skip
def test_no_event_of_a_real_recording_is_lost_uncounted(data_dir, name, roi, changes, expected):
    """Even with hardware that is far too small for it."""
    with open_recording(data_dir / name) as recording:
        sensor = {"sensor_width": recording.width, "sensor_height": recording.height}
        config = Config(**sensor, iterations=1, roi_width=32, roi_height=32, **changes)
        cutter = BatchCutter(recording, events=4000, max_events=4000)
        seen = Flag(0)
        for batch in loop.track(make_engine("model", config), cutter, roi=roi, batches=6):
            result = batch.result
            assert result.events == len(batch.events) == 4000
            counts = [result.roi_events, result.outside, result.overflow, result.time_back, result.time_span]
            assert sum(counts) == 4000 and min(counts) >= 0
            for count, flag in zip(counts[2:], (Flag.OVERFLOW, Flag.TIME_BACK, Flag.TIME_SPAN), strict=True):
                assert bool(count) == (flag in batch.flags)
            seen |= batch.flags
        assert expected in seen
