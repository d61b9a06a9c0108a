"""Tracks for the reports, and a browser to open them in."""

import shutil
import socket
import time

import pytest

from cmfpga.config import Config, preset
from cmfpga.events import generate
from support.reporting import keep

BROWSERS = ("chromium", "chromium-browser", "google-chrome")


@pytest.fixture(scope="session")
def turning():
    """A synthetic object that turns a corner, tracked with preset ``fast``."""
    pieces = ((250_000, 150.0, 100.0), (250_000, 120.0, -100.0))
    scene = generate(
        seed=1, texture="lines", position=(70.0, 90.0), velocity=pieces, duration_us=500_000, noise=0.05,
    )  # fmt: skip
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
def browser():
    """Headless Chromium."""
    selenium = pytest.importorskip("selenium", reason="selenium is not installed: pip install 'cmfpga[test]'")
    assert selenium
    from selenium import webdriver

    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    driver = shutil.which("chromedriver")
    if not program or not driver:
        pytest.skip("no Chromium and its driver: apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    made = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    yield made
    made.quit()


class Opened:
    """A report in the browser."""

    def __init__(self, browser, path):
        self.browser, self.path = browser, path

    def show(self, *, width=1280, theme="light"):
        """Load it in a window of this width (px); waits until it is drawn."""
        self.browser.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 700},
        )
        media = {"features": [{"name": "prefers-color-scheme", "value": theme}]}
        self.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
        self.browser.get_log("browser")
        self.browser.get(self.path.as_uri())
        self.wait("document.body.dataset.ready === 'yes'")
        return self

    def do(self, script, *arguments):
        """What a piece of JavaScript returns."""
        return self.browser.execute_script(script, *arguments)

    def wait(self, condition, seconds=30):
        """Until a JavaScript expression is true."""
        end = time.monotonic() + seconds
        while not self.do(f"return Boolean({condition})"):
            assert time.monotonic() < end, f"not within {seconds} s: {condition}; {self.errors()}"
            time.sleep(0.02)

    def errors(self):
        """Messages on the console since the page was loaded."""
        return [entry["message"] for entry in self.browser.get_log("browser")]

    def press(self, key):
        """Press a key where the focus is; waits for the drawing."""
        from selenium.webdriver.common.action_chains import ActionChains

        ActionChains(self.browser).send_keys(key).perform()
        self.settle()

    def settle(self):
        self.wait("document.body.dataset.shown === String(details[shown].batch) && !drawing")


@pytest.fixture
def opened(browser, tmp_path):
    """``opened(kept)``: its report in the browser, as :class:`Opened`, not yet shown."""
    from cmfpga.report.page import write_page

    def opened(kept, clock_mhz=210.0):
        path = tmp_path / "report.html"
        write_page(kept, path, clock_mhz=clock_mhz)
        return Opened(browser, path)

    return opened


@pytest.fixture(autouse=True)
def _no_network(monkeypatch):
    """Nothing here may go farther than this machine."""
    connect = socket.socket.connect

    def local_only(self, address):
        assert self.family == socket.AF_UNIX or address[0] in ("127.0.0.1", "::1", "localhost"), address
        return connect(self, address)

    monkeypatch.setattr(socket.socket, "connect", local_only)
