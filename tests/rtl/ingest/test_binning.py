"""Binning against its model, and where it stands: behind what knows the sensor's own pixels."""

import itertools

import numpy as np
import pytest
from amaranth.hdl import ClockDomain

from cmfpga.config import Config
from cmfpga.errors import ConfigError
from cmfpga.imaging.camera import Camera, undistort
from cmfpga.protocol.settings import BatchSettings
from cmfpga.reference.ingest import take_in
from cmfpga.reference.integer.filters import NoiseFilter
from cmfpga.rtl.ingest import make_front
from cmfpga.rtl.ingest.binning import Binning
from support.bench import GAPS, check_latency, flow_script, play
from support.values import random_gaps

#: No side is a multiple of the pixels that are binned.
SIZES = {"sensor_width": 39, "sensor_height": 29, "roi_width": 4, "roi_height": 2}


class Clocked(Binning):
    """Wires alone have no clock, which a script counts by."""

    def elaborate(self, platform):
        m = super().elaborate(platform)
        m.domains.sync = ClockDomain()
        return m


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("binning", [1, 2, 3])
def test_every_pixel_of_the_sensor(binning, gap, rng):
    config = Config(**SIZES, binning=binning, hot_pixels=1, background=1)
    block, places = Clocked(config), [*itertools.product(range(39), range(29))]
    order = rng.permutation(len(places))
    items = [
        {"t": k % 200, "x": places[at][0], "y": places[at][1], "last": k % 2, "hot": k % 3 == 0, "noise": k % 5 == 0}
        for k, at in enumerate(order)
    ]
    script, pushed = flow_script(block, items, random_gaps(rng, len(items), GAPS[gap]), rng)
    recording = play(block, script)
    check_latency(block, pushed, recording)
    x, y = undistort(config, (), *np.array(places)[order].T)
    wanted = [{**item, "x": a, "y": b} for item, a, b in zip(items, x.tolist(), y.tolist(), strict=True)]
    assert recording.values() == wanted
    assert (x.max(), y.max()) == (config.geometry.width - 1, config.geometry.height - 1)
    assert (config.geometry.width - 1) << binning <= 38 < config.geometry.width << binning


def test_noise_is_known_by_pixels_of_the_sensor():
    """A hot pixel costs no neighbour that is binned with it; two such neighbours support one another."""
    config = Config(**SIZES, binning=2, hot_pixels=1, hot_mask="8,8", background=1, background_us=50, undistortion="on")
    assert [*make_front(config)] == ["hot_mask", "background_filter", "binning", "undistorter"]
    t, x, y = np.array([(0, 8, 8), (10, 9, 8), (20, 10, 9), (30, 8, 8)]).T
    settings = BatchSettings.from_config(config)
    dropped = NoiseFilter(config).judge(t, x, y, settings)
    assert [axis.tolist() for axis in dropped] == [[True, False, False, True], [False, True, False, False]]
    taken = take_in(config, t, x, y, settings, roi=(1, 1), last_thinning=None, dropped=dropped)
    assert (taken.counts["hot"], taken.counts["noise"], taken.counts["roi_events"]) == (2, 1, 1)
    assert [int(axis[0]) >> config.formats.event_frac for axis in (taken.x, taken.y)] == [1, 1]


@pytest.mark.parametrize("binning", [1, 2, 3])
def test_a_binned_camera_sees_the_same_rays(binning):
    """The middle of a binned pixel is the mean of the pixels that it is made of, through any lens."""
    numbers = (150.0, 140.0, 61.5, 43.25, -0.3, 0.1, 0.001, -0.002, 0.02)
    config = Config(
        sensor_width=120, sensor_height=88, roi_width=4, roi_height=4, undistortion="on", binning=binning,
        camera=",".join(map(repr, numbers)),
    )  # fmt: skip
    side = config.pixel
    x, y = np.array([*itertools.product(range(120 // side), range(88 // side))]).T
    middle = (side - 1) / 2
    rays = Camera(*config.lens).rays(x, y)
    np.testing.assert_allclose(rays, Camera(*numbers).rays(side * x + middle, side * y + middle), rtol=0, atol=1e-9)


def test_what_is_refused():
    for fields, text in (
        ({"roi_width": 22}, "roi_width = 22: at most 20 is allowed (sensor_width = 39 by binning = 1)"),
        ({"roi_height": 16}, "roi_height = 16: at most 15 is allowed (sensor_height = 29 by binning = 1)"),
        ({"binning": 4}, "binning = 4: 0 to 3 is needed"),
    ):
        with pytest.raises(ConfigError) as caught:
            Config(**SIZES | {"binning": 1} | fields)
        assert str(caught.value) == text
