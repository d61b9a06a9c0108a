"""Settings of a batch."""

import numpy as np
import pytest

from cmfpga.config import Config, preset
from cmfpga.protocol.settings import BatchSettings, clamp_roi
from cmfpga.reference.sequence import RoiFollower


@pytest.mark.parametrize(
    "start, start_last, v_start",
    [("last", True, (0, 0)), ("zero", False, (0, 0)), ("given", False, (1 << 12, -(3 << 11)))],
)
def test_settings_of_a_configuration(start, start_last, v_start):
    config = Config(start=start, v_start_x=1.0, v_start_y=-1.5, eta=0.75, roi_gain=1.5, iterations=7, min_roi_events=9)
    assert BatchSettings.from_config(config, (3, 4)) == BatchSettings(
        roi=(3, 4), iterations=7, eta=768, roi_gain=24, start_last=start_last, v_start=v_start, min_roi_events=9
    )
    assert BatchSettings.from_config(config).roi is None
    thin = BatchSettings.from_config(config.replace(thinning=5, thin_target=700))
    assert (thin.thinning, thin.thin_target) == (5, 700)


def test_lengths_of_windows():
    config = preset("sliding")
    given = BatchSettings.from_config(config)
    assert (given.window_events, given.hop_events, given.window_us, given.hop_us) == (1000, 62, 0, 4000)
    assert (len(given.follow), len(given.after)) == (1, 1)
    given = BatchSettings.from_config(config.replace(window_events=320, follow="", after=""))
    assert (given.window_events, given.hop_events, given.follow, given.after) == (320, 20, (), ())
    assert BatchSettings.from_config(preset("quad")).hop_us == 0


def test_settings_are_rounded_to_the_nearest():
    config = Config(eta=1.0 + 0.6 / 1024, roi_gain=1.0 + 0.4 / 16)
    assert (BatchSettings.from_config(config).eta, BatchSettings.from_config(config).roi_gain) == (1025, 16)


def crop_position(config, raw):
    follower = RoiFollower(config, 1 << config.formats.roi_x.f)
    follower.position = (raw, 0)
    return follower.next_corner[0]


def test_crop_position_rounds_half_up():
    config = Config(v_frac=3, roi_gain_frac=1)  # sixteenths of a pixel
    assert [crop_position(config, raw) for raw in (0, 7, 8, 9, 16, 23, 24, 31, 40)] == [0, 0, 1, 1, 1, 1, 2, 2, 3]


@pytest.mark.parametrize("roi, clamped", [
    ((0, 0), (0, 0)), ((176, 116), (176, 116)), ((177, 0), (176, 0)), ((0, 117), (0, 116)), ((-1, 5), (0, 5)),
    ((5, -1), (5, 0)), ((10**30, -(10**30)), (176, 0)), ((np.int64(200), np.int64(3)), (176, 3)),
])  # fmt: skip
def test_clamp_roi(roi, clamped):
    found, changed = clamp_roi(Config(), roi)
    assert (found, changed) == (clamped, clamped != roi) and {*map(type, found)} == {int}


def test_a_position_can_hold_every_roi():
    config = Config(sensor_width=239, roi_width=2)
    last = config.geometry.roi_x_max << config.formats.roi_x.f
    assert crop_position(config, last) == config.geometry.roi_x_max == 237 and config.formats.roi_x.max >= last
