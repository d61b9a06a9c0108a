"""Tracks for the reports, and the reports in a browser."""

import pytest

from cmfpga.config import Config, preset
from cmfpga.events import generate
from cmfpga.imaging.camera import Camera
from support.browser import Opened
from support.reporting import keep


@pytest.fixture(scope="session")
def turning():
    """A synthetic object that turns a corner, tracked with preset ``fast``."""
    pieces = ((250_000, 150.0, 100.0), (250_000, 120.0, -100.0))
    fields = {"texture": "lines", "position": (70.0, 90.0), "duration_us": 500_000, "noise": 0.05}
    scene = generate(seed=1, velocity=pieces, **fields)
    config = preset("fast").replace(buffer_events=4096)
    roi = scene.roi_start(config.roi_width, config.roi_height)
    return keep(config, scene.recording("turning"), roi=roi, size=3280, motion=scene.motion)


@pytest.fixture(scope="session")
def flagged():
    """A track with the article's ascent and a small buffer that runs over, of an ROI that is clamped to the sensor."""
    scene = generate(seed=3, width=64, height=48, size=(20, 20), position=(30.0, 30.0), velocity=(200.0, 0.0))
    config = Config(
        sensor_width=64, sensor_height=48, roi_width=32, roi_height=24, buffer_events=200, iterations=20, eta=1.0,
        min_roi_events=150,
    )  # fmt: skip
    recording = scene.recording("/me/<script><b>&amp; $x$")
    return keep(config, recording, roi=(14, 18), size=200, batches=12, motion=scene.motion)


@pytest.fixture(scope="session")
def panning():
    """A camera with a lens that turns, seen whole."""
    camera = Camera(80.0, 80.0, 47.0, 31.0, -0.1)
    size = {"width": 96, "height": 64}
    scene = generate(seed=2, **size, size=(140, 100), bars=12, rotation=(1.0, -2.0, 0.5), camera=camera,
                     duration_us=60_000)  # fmt: skip
    config = preset("rotation").replace(
        sensor_width=96, sensor_height=64, roi_width=96, roi_height=64, buffer_events=4095, ram_style="auto",
        camera="80,80,47,31,-0.1,0,0,0",
    )  # fmt: skip
    return keep(config, scene.recording("panning"), roi=(0, 0), size=len(scene.events) // 2, batches=2)


@pytest.fixture(scope="session")
def growing():
    """An object that comes nearer and turns."""
    scene = generate(seed=4, size=(90, 90), bars=12, velocity=(40.0, -20.0), zoom=1.5, roll=1.0, duration_us=90_000)
    config = preset("similarity").replace(buffer_events=4095, confidence_limit=10.0)
    roi = scene.roi_start(config.roi_width, config.roi_height)
    return keep(config, scene.recording("growing"), roi=roi, size=len(scene.events) // 2, batches=2)


@pytest.fixture
def opened(browser, tmp_path):
    """``opened(kept)``: its report in the browser, as :class:`Opened`, not yet shown."""
    from cmfpga.show.report import write_page

    def opened(kept, clock_mhz=210.0):
        path = tmp_path / "report.html"
        write_page(kept, path, clock_mhz=clock_mhz)
        settled = "document.body.dataset.shown === String(details[shown].batch) && !drawing"
        return Opened(browser, path, settled)

    return opened


@pytest.fixture(autouse=True)
def _no_network(no_network):
    """Nothing here may go farther than this machine."""
