"""Whether the halves of an ROI move alike, of points that do, and of points that are the nearer the lower they are."""

from types import SimpleNamespace

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.events import Events
from cmfpga.imaging.survey.proposal import _apart, _measure


@pytest.mark.parametrize("slope, alike", [(0.0, True), (0.15, False)])
def test_depths_are_seen(rng, slope, alike):
    """Points move along x by 4 px per half window, and by so much more for each row."""
    config, count = preset("fast"), 60
    t = np.sort(rng.integers(0, 20_001, 6000))
    t[[0, -1]] = 0, 20_000
    point = rng.integers(count, size=len(t))
    x, y = rng.uniform(12, 52, count), rng.integers(4, 60, count)
    moved = (4 + slope * (y - 32))[point] * (t - 10_000) / 10_000
    events = Events(t, np.round(x[point] + moved), y[point], t % 2)
    window = SimpleNamespace(during=lambda begin, duration: events)
    v, *_ = _measure(window, (0, 0), 0, 20_000, config)
    assert (_apart(window, (0, 0), 20_000, v, config) <= 0.6) == alike
