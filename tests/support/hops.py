"""Small hardware whose windows slide, and events of an object for it."""

import numpy as np

SMALL = {
    "windows": "sliding", "roi_width": 16, "roi_height": 12, "sensor_width": 32, "sensor_height": 24,
    "buffer_events": 200, "time_bits": 18, "span_bits": 16, "tag_bits": 5, "confidence_limit": 1.0,
    "min_roi_events": 6, "window_events": 120, "hop_events": 10, "window_us": 0, "hop_us": 0,
}  # fmt: skip
CORNER = (7, 5)


def drawn(rng, count, *, wrap=1 << 18):
    """Events of a dot that moves, some of them elsewhere; with ties, bursts, gaps and steps back; times wrap."""
    steps = rng.exponential(40, count) * rng.choice([0, 0.1, 1, 3], count)
    pauses = rng.random(count) < 0.006
    steps[pauses] += rng.choice([2000, 2400, 4400], pauses.sum())
    t = np.cumsum(steps).astype(np.int64)
    side = 5 * np.sin(t / t[-1] * 9)
    x = (CORNER[0] + 8 + side + rng.normal(0, 2, count)).astype(np.int64).clip(0, 31)
    y = (CORNER[1] + 6 + side / 2 + rng.normal(0, 2, count)).astype(np.int64).clip(0, 23)
    away = rng.random(count) < 0.2
    x[away], y[away] = rng.integers(0, 32, away.sum()), rng.integers(0, 24, away.sum())
    t[rng.random(count) < 0.01] -= 100
    return (t + (1 << 18) - 9000) % wrap, x, y
