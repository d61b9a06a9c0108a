"""The NumPy image of warped events, compared with the torch reference and with what the hardware stores."""

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.events import Events
from cmfpga.imaging.iwe import contrast, image_of_warped_events, scaled_roi_events
from cmfpga.reference import floating
from cmfpga.reference.integer.roi_filter import roi_filter

CONFIG = Config(sensor_width=40, sensor_height=30, roi_width=12, roi_height=8, buffer_events=64)
SIZE = {"width": 12, "height": 8}
ROI = (9, 5)


def random_events(rng, count=300, span=5000):
    t = 10**15 + np.sort(rng.integers(0, span, count))
    return Events(t, rng.integers(40, size=count), rng.integers(30, size=count), rng.integers(2, size=count))


@pytest.mark.parametrize("v", [(0, 0), (1.5, -0.75), (-3, 2), (30.0, 0.0), (0.1, 1e6)], ids=str)
def test_image_equals_the_reference(rng, v):
    count = 200
    x, y, dt = rng.integers(-2, 14, count), rng.integers(-2, 10, count), rng.uniform(-1, 1, count)
    dt[:4] = -1, 0, 1, 0.5
    image = image_of_warped_events(x, y, dt, v, **SIZE)
    expected = floating.iwe(*floating.warp(x, y, dt, v), **SIZE).numpy()
    assert image.shape == (8, 12) and image.dtype == np.float64
    np.testing.assert_allclose(image, expected, rtol=0, atol=1e-12)


def test_contrast_equals_the_reference(rng):
    events = random_events(rng)
    x, y, dt = scaled_roi_events(CONFIG, events, ROI)
    assert 20 < len(x) < CONFIG.buffer_events
    for v in ((0, 0), (0.7, -1.3)):
        expected = floating.evaluate(x, y, dt, v, **SIZE).contrast
        assert contrast(CONFIG, events, ROI, v) == pytest.approx(float(expected), abs=1e-12)
    assert type(contrast(CONFIG, events, ROI, (0, 0))) is float


@pytest.mark.parametrize("count, span, changes", [
    (300, 5000, {}),
    (3000, 5000, {"buffer_events": 50}),  # overflow
    (300, 5000, {"span_bits": 11}),  # events beyond the span, so t_N is another event's
    (40, 3, {}),
    (1, 100, {}),
])  # fmt: skip
def test_events_are_those_that_the_hardware_stores(rng, count, span, changes):
    config = CONFIG.replace(**changes)
    events = random_events(rng, count, span)
    stored = roi_filter(config, events.t, events.x, events.y, roi=ROI)
    limit = config.buffer_events
    x, y, dt = scaled_roi_events(config, events, ROI)
    if not stored.counts["span"]:
        assert len(x) == 0
        return
    np.testing.assert_array_equal(x, stored.x[:limit])
    np.testing.assert_array_equal(y, stored.y[:limit])
    np.testing.assert_array_equal(dt, floating.scaled_times(stored.t[:limit], 0, stored.counts["span"]))
    if changes:
        assert len(stored.x) > limit or stored.counts["time_span"]


def test_time_is_scaled_by_the_whole_batch():
    """t_1 and t_N may be of events outside the ROI."""
    events = Events([100, 150, 175, 200], [0, 10, 11, 39], [0, 6, 7, 29], [0, 0, 0, 0])
    np.testing.assert_array_equal(scaled_roi_events(CONFIG, events, ROI), [[1, 2], [1, 2], [0, 0.5]])


@pytest.mark.parametrize("count", [0, 1, 20])
def test_a_batch_without_a_range_of_time_is_empty(count):
    events = Events(np.full(count, 77), np.full(count, 10), np.full(count, 6), np.zeros(count))
    assert scaled_roi_events(CONFIG, events, ROI).shape == (3, 0)
    assert contrast(CONFIG, events, ROI, (1.0, 1.0)) == 0.0
