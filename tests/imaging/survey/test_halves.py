"""Whether the halves of an ROI move alike, of points that do and of points that do not."""

from types import SimpleNamespace

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.events import Events
from cmfpga.imaging.survey.proposal import _apart


@pytest.mark.parametrize("speeds, alike", [((4.0, 4.0), True), ((4.0, -4.0), False)])
def test_two_motions_are_seen(rng, speeds, alike):
    """Upper and lower rows of points move along x, px per half window."""
    config, count = preset("fast"), 40
    t = np.sort(rng.integers(0, 20_001, 4000))
    t[[0, -1]] = 0, 20_000
    point = rng.integers(count, size=len(t))
    x, y = rng.uniform(8, 56, count), np.where(np.arange(count) % 2, 48, 16) + rng.integers(-8, 8, count)
    moved = np.array(speeds)[np.arange(count) % 2][point] * (t - 10_000) / 10_000
    events = Events(t, np.round(x[point] + moved), y[point], t % 2)
    window = SimpleNamespace(during=lambda begin, duration: events)
    assert (_apart(window, (0, 0), 20_000, (4.0, 0.0), config) <= 0.6) == alike
