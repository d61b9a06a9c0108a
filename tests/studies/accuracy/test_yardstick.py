"""The contrast that real batches are judged by, and the search for the best."""

import math

import numpy as np
import pytest
from studies.accuracy.yardstick import best_contrast, contrasts, peak_error

from cmfpga.imaging.iwe import image_of_warped_events


def test_contrast_is_the_articles(synthetic, rng):
    x, y, dt = synthetic[0].scaled
    velocities = rng.uniform(-12, 12, (20, 2))
    expected = [image_of_warped_events(x, y, dt, v, width=64, height=64).var() for v in velocities]
    np.testing.assert_allclose(contrasts(x, y, dt, velocities, spread=False), expected, rtol=1e-12)


def test_spread_is_the_mean_over_all_dithers(rng):
    x, y, dt = rng.integers(0, 64, 30).astype(float), rng.integers(0, 64, 30).astype(float), rng.uniform(-1, 1, 30)
    v, size = (2.3, -1.4), {"width": 64, "height": 64}
    offsets = (np.arange(24) + 0.5) / 24 - 0.5
    images = [image_of_warped_events(x + a, y + b, dt, v, **size) for a in offsets for b in offsets]
    assert contrasts(x, y, dt, [v])[0] == pytest.approx(np.mean(images, axis=0).var(), rel=2e-3)


def test_the_search_finds_the_best(synthetic):
    case = synthetic[1]
    v, best = best_contrast(*case.scaled)
    assert math.dist(v, case.truth) < 0.3
    assert contrasts(*case.scaled, [v])[0] == best == case.best[1]
    near = np.add(v, np.random.default_rng(1).normal(0, 0.5, (200, 2)))
    far = np.random.default_rng(2).uniform(-8, 8, (200, 2))
    assert contrasts(*case.scaled, near).max() <= best * 1.001
    assert contrasts(*case.scaled, far).max() <= best


def test_the_articles_contrast_prefers_an_axis(real):
    """Why it is no yardstick: its best v has vx = 0 or vy = 0 exactly, whatever the motion is."""
    part = real[::6]
    on_axis = [
        sum(min(map(abs, v)) < 1e-9 for v in (best[0] for best in bests))
        for bests in ([case.best_unspread for case in part], [case.best for case in part])
    ]
    assert on_axis[0] >= len(part) - 2 and on_axis[1] <= 2


def test_peak_error(synthetic):
    assert peak_error(synthetic[1]) < 0.3
