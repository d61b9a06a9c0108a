"""Batches of exactly the size that is asked for."""

import numpy as np
import pytest
from studies.bench.cases import make_workload

SIZES = {
    "the article's": {"events": 5000, "roi_events": 800},
    "the whole sensor": {"events": 5000, "roi_events": 5000, "width": 240, "height": 180},
    "128×128": {"events": 20000, "roi_events": 3200, "width": 128, "height": 128},
    "small": {"events": 120, "roi_events": 100, "width": 16, "height": 12, "sensor": (40, 30)},
}


@pytest.mark.parametrize("name", SIZES)
def test_size(name):
    size = SIZES[name]
    batch = make_workload(name, **size)
    events = batch.events
    x, y = events.x.astype(int) - batch.roi[0], events.y.astype(int) - batch.roi[1]
    inside = (x >= 0) & (x < batch.width) & (y >= 0) & (y < batch.height)
    assert len(events) == size["events"] and inside.sum() == size["roi_events"] == batch.roi_events
    assert (np.diff(events.t) >= 0).all() and events.t[-1] > events.t[0]
    width, height = size.get("sensor", (240, 180))
    assert events.x.max() < width and events.y.max() < height


def test_the_same_seed_gives_the_same_events():
    first, again, other = (make_workload("w", events=300, roi_events=200, seed=seed) for seed in (5, 5, 6))
    for name in "txyp":
        np.testing.assert_array_equal(getattr(first.events, name), getattr(again.events, name))
    assert not np.array_equal(first.events.x, other.events.x)
