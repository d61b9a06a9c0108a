"""What is found behind a binning is told in the sensor's pixels; and a rotation bins what would not fit."""

from types import SimpleNamespace

import numpy as np
import pytest

import cmfpga
from cmfpga.api.track_result import _Again
from cmfpga.config import preset
from cmfpga.config.checks import binned_camera, parse_camera
from cmfpga.errors import ConfigError
from cmfpga.events import Events, MemoryRecording, generate
from cmfpga.imaging.camera import Camera
from cmfpga.show.export import _Viewer
from cmfpga.tracking.source import binning_note

CAMERA = "420,415,161.5,118.25,-0.2,0.05,0.001,-0.001,0"
SENSOR = 319, 239  # of an odd number of pixels
SCENE = {"width": 319, "height": 239, "seed": 4, "duration_us": 200_000, "size": (90, 90)}
FLAT = {"velocity": (400, -240), "bars": 10}
QUAD = {"preset": "quad", "batch_events": 6000, "buffer_events": 4095}
CASES = {
    "sliding": ({"preset": "sliding"}, FLAT),
    "batches": (QUAD, FLAT),
    "undistorted": (QUAD | {"undistortion": "on", "camera": CAMERA}, FLAT),
    "similarity": ({"preset": "similarity", "batch_events": 15_000, "roi_width": 64, "roi_height": 64},
                   {"velocity": (0, 0), "zoom": 1.2, "roll": 1.5, "duration_us": 300_000}),
    "rotation": ({"preset": "rotation", "batch_events": 50_000, "camera": CAMERA},
                 {"rotation": (0.4, -0.7, 0.5), "camera": Camera(*parse_camera(CAMERA)), "size": (500, 400),
                  "bars": 40}),
}  # fmt: skip
#: Columns in pixels, with their power of a pixel's width.
IN_PIXELS = {
    "roi_x": 1, "roi_y": 1, "vx": 1, "vy": 1, "vx_px_per_s": 1, "vy_px_per_s": 1, "vx_px_per_s_sd": 1,
    "vy_px_per_s_sd": 1, "confidence": -2,
}  # fmt: skip


@pytest.fixture(scope="module")
def flat():
    return generate(**SCENE | FLAT)


@pytest.mark.parametrize("name", CASES)
def test_all_columns_are_those_of_a_coarser_sensor_in_the_finer_ones_pixels(name):
    """Bit for bit, for a pixel's width is a power of two."""
    options, changes = CASES[name]
    events = generate(**SCENE | changes).events
    place = None if name == "rotation" else (98, 76)
    size = {"roi_width": 160, "roi_height": 120} if name == "rotation" else {}
    if "camera" in options:
        camera = ",".join(map(repr, binned_camera(parse_camera(options["camera"]), 1)))
    halved = options | ({"camera": camera} if "camera" in options else {})
    wide = MemoryRecording(Events(events.t, events.x >> 1, events.y >> 1, events.p), 160, 120)
    fine = cmfpga.track(MemoryRecording(events, *SENSOR), roi=place, engine="model", binning=1, **size, **options)
    coarse = cmfpga.track(wide, roi=place and tuple(at >> 1 for at in place), engine="model", **size, **halved)
    assert len(fine) == len(coarse) > 3 and fine.trusted.mean() > 0.6
    wanted, found = coarse.to_arrays(), fine.to_arrays()
    assert set(IN_PIXELS) <= set(found)
    for column, values in found.items():
        one = wanted[column] * 2.0 ** IN_PIXELS[column] if column in IN_PIXELS else wanted[column]
        np.testing.assert_array_equal(values, one, err_msg=column)
    for array, power in (("covariance", 4), ("covariance_px_per_s", 4)):
        np.testing.assert_array_equal(getattr(fine, array), getattr(coarse, array) * power)
    assert fine.verdict.px == 2 * coarse.verdict.px


def test_velocity_and_place_are_the_scenes(flat):
    """The same motion with and without; an ROI as large in the scene follows the object as well."""
    roi = flat.roi_start(128, 128)
    for binning, side in ((0, 128), (1, 64)):
        size = {"roi_width": side, "roi_height": side, "tag_bits": 9}
        found = cmfpga.track(flat, engine="model", binning=binning, **size, **QUAD)
        assert tuple(at & -2 for at in roi) == (found.roi_x[0] & -2, found.roi_y[0] & -2)
        assert found.trusted.mean() > 0.9
        assert np.median(found.vx_px_per_s) == pytest.approx(400, rel=0.04)
        assert np.median(found.vy_px_per_s) == pytest.approx(-240, rel=0.04)
        moved = found.roi_x[-1] - found.roi_x[0], found.roi_y[-1] - found.roi_y[0]
        seconds = (found.t_ref_us[-1] - found.t_ref_us[0]) / 1e6
        np.testing.assert_allclose(moved, (400 * seconds, -240 * seconds), atol=6)


def test_several_objects_and_pieces(flat):
    """A table of regions, and events as they come, from the same places."""
    options = {"roi": (98, 76), "engine": "model", "batch_events": 6000, "binning": 1}
    whole = cmfpga.track(flat.recording("scene"), preset="quad", **options)
    with cmfpga.Tracker(sensor=SENSOR, preset="quad", **options) as tracker:
        for part in np.array_split(np.arange(len(flat.events)), 7):
            tracker.push(flat.events[part[0] : part[-1] + 1])
    for name in ("roi_x", "vx"):
        np.testing.assert_array_equal(getattr(tracker.tracking, name), getattr(whole, name))
    rows = cmfpga.track(flat.recording("scene"), preset="objects", **options)
    assert np.median(rows.vx_px_per_s) == pytest.approx(400, rel=0.05) and rows.roi_x[0] == 98


def test_pictures_and_exports_are_in_the_sensors_pixels(flat):
    found = cmfpga.track(flat, preset="quad", engine="model", batch_events=6000, binning=1)
    figure = found.plot()
    frame = figure.axes[0]
    assert frame.get_images()[0].get_extent() == [-0.5, 319.5, 239.5, -0.5]
    (roi, *_) = frame.patches
    assert (roi.get_width(), roi.get_height()) == (128, 128)
    assert roi.get_xy() == (found.roi_x[0] - 0.5, found.roi_y[0] - 0.5)
    written = []
    stream = SimpleNamespace(log=lambda *told: written.append(told), set_time=lambda *_, **__: None)
    kinds = dict.fromkeys(("Points2D", "Boxes2D", "Arrows2D", "Scalars"), lambda *args, **how: (args, how))
    _Viewer(SimpleNamespace(**kinds), stream, found.config).add(_Again(found, 0))
    told = dict(written)
    places = told["sensor/events"][0][0]
    events = found._events(0)
    np.testing.assert_array_equal(places, np.stack([events.x // 2 * 2, events.y // 2 * 2], axis=1) + 0.5)
    assert told["sensor/roi"][1]["sizes"][0].tolist() == [128, 128]


def test_what_does_not_know_a_binning_says_so(flat, tmp_path):
    recording = flat.recording("scene")
    found = cmfpga.track(recording, roi=(98, 76), preset="quad", engine="model", batch_events=6000, binning=1)
    for call, text in (
        (lambda: found.report(tmp_path / "a.html"), "report: binning = 1: its pictures are of the sensor's pixels: 0"),
        (lambda: cmfpga.flow(recording, engine="model", binning=1), "binning = 1: flow is in the sensor's pixels: 0"),
        (lambda: cmfpga.track(recording, roi="auto", engine="model", binning=1), "binning = 1: an ROI is proposed in"),
        (lambda: cmfpga.track(recording, roi=(194, 5), preset="quad", engine="model", binning=1),
         "ROI at 194,5: 0,0 to 192,112 is needed for 128×128 px on a sensor of 319×239 px"),
    ):  # fmt: skip
        with pytest.raises(ConfigError) as caught:
            call()
        assert str(caught.value).startswith(text) and "\n" not in str(caught.value)


def test_the_note_of_a_binning_that_nobody_asked_for():
    config = preset("rotation").replace(sensor_width=640, sensor_height=480, binning=1)
    assert binning_note(config, {"binning": 1}) is None and binning_note(preset("rotation"), {}) is None
    assert binning_note(config, {}) == (
        "the image of 640×480 px does not fit a KV260: pixels are binned 2×2, to 320×240 (binning = 1); places and "
        "velocities are in the sensor's pixels"
    )
