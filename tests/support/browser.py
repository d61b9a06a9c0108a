"""A browser to open pages in, far from any network."""

import shutil
import socket
import time

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome")


@pytest.fixture(scope="session")
def browser():
    pytest.importorskip("selenium", reason="selenium is not installed: pip install 'cmfpga[test]'")
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
    """A page in the browser; ``settled`` is an expression that tells whether it is drawn."""

    def __init__(self, browser, path, settled):
        self.browser, self.path, self.settled = browser, path, settled

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
        return self.browser.execute_script(script, *arguments)

    def wait(self, condition, seconds=30):
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
        """Until the page shows what it was told to."""
        self.wait(self.settled)


@pytest.fixture
def no_network(monkeypatch):
    """Nothing here may go farther than this machine."""
    connect = socket.socket.connect

    def local_only(self, address):
        assert self.family == socket.AF_UNIX or address[0] in ("127.0.0.1", "::1", "localhost"), address
        return connect(self, address)

    monkeypatch.setattr(socket.socket, "connect", local_only)
