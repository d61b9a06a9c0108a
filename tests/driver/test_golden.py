"""The golden batch of the self-test: kept results are the integer model's, and nothing of it depends on the machine."""

import sys

import numpy as np
import pytest

from cmfpga.config import Config, preset
from cmfpga.driver import golden
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.results import RESULTS
from cmfpga.protocol.settings import clamp_roi
from support.configs import WRAPPED
from support.driving import CONFIG


def test_kept_results_are_current():
    kept = golden.json.loads(golden.Path(golden.__file__).with_name(golden.FILE).read_text(encoding="utf-8"))
    assert kept == golden.json.loads(golden.json.dumps(golden.make())), "run python -m cmfpga.driver.golden"


@pytest.mark.parametrize("name", WRAPPED)
def test_the_batch_is_one_that_means_something(name):
    found, source = golden.expected_result(preset(name))
    assert source == "the integer model"
    slides = preset(name).slides  # the result is then of one hop
    assert found["fresh"] + found["outside"] == found["events"] < 50 if slides else found["events"] == golden.EVENTS
    whole, *quarters = found.pop("regions", [found])
    assert 300 < whole["roi_events"] and any(whole["sums"]) and len(quarters) == (4 if preset(name).regions else 0)
    assert sum(quarter["roi_events"] for quarter in quarters) in (0, whole["roi_events"])
    for region in (whole, *quarters):
        assert not region["flags"] & (Flag.DEGENERATE | Flag.OVERFLOW)
        assert {*found, *region} <= {field.name for field in RESULTS}
        if preset(name).ascent != "constant":  # the plain ascent from v = 0 does not leave it: README
            share = found["span"] / (20 * golden.EVENTS) if slides else 1  # of the time in which it moves so far
            way = np.multiply((3, -2), share)
            assert np.allclose(region["v"][:2], way, atol=0.35 if region is whole else 1)
            assert np.allclose(region["v"][2:], 0, atol=0.1)


@pytest.mark.parametrize(
    "config", [CONFIG, Config(max_batch_events=7), Config(span_bits=4), Config(roi_width=240, roi_height=180)]
)
def test_the_batch_fits_every_configuration(config):
    events, roi = golden.golden_batch(config)
    assert 0 < len(events) <= config.max_batch_events
    assert events.x.max() < config.sensor_width and events.y.max() < config.sensor_height
    assert clamp_roi(config, roi) == (roi, False)
    assert (np.diff(events.t) > 0).all()


def test_without_torch(monkeypatch):
    """Of a preset the kept result, run-time fields or not; of others none, and why."""
    expected, _ = golden.expected_result(preset("fast"))
    monkeypatch.setitem(sys.modules, "torch", None)
    for module in [name for name in sys.modules if name.startswith(("cmfpga.reference", "cmfpga.engines.model"))]:
        monkeypatch.delitem(sys.modules, module)
    assert golden.expected_result(preset("fast").replace(warm="0:1:1", start="zero")) == (expected, "golden.json")
    found, reason = golden.expected_result(CONFIG)
    assert found is None and "torch is not installed" in reason
