"""Synthetic batches: an object moves at a constant, known velocity.

Of each batch texture, speed, direction, noise and a number of ROI events to aim at are drawn. An edge is strong enough
to emit :data:`EVENTS_PER_EDGE` events on average during the batch, so edges of a slow object have several contrast
thresholds per pixel. The object is as large as the number of events asks for: it has a shape, and stays in the ROI. A
scene with fewer or more events than :data:`ROI_EVENTS` is drawn anew with the same velocity.
"""

import math

import numpy as np

from cmfpga.events import generate

from .yardstick import ROI, Case

SEEDS = (1,)
BATCHES = 300
MAX_SPEED = 9.0  # px per half batch
MAX_NOISE = 0.3  # of the ROI's events
ROI_EVENTS = (200, 2000)
EVENTS_PER_EDGE = 4.0  # of an edge point during the batch, on average over the edge's directions
MAX_CONTRAST = 8.0  # thresholds per px: black on white, blurred over 2 px, to a camera with thresholds of 15 %
SIZES = {"lines": (20, 44), "dense": (8, 44)}  # px; smaller ones have too few edges to be a shape
MARGIN = 1.0  # px between the object's way and the ROI's border
DURATION_US = 20_000
WARM_RADIUS = 1.0  # px per half batch; how far from the truth the warm suite starts at most


def synthetic_cases(count=BATCHES, *, seeds=SEEDS, events_per_edge=EVENTS_PER_EDGE):
    """The first ``count`` synthetic batches of each of ``seeds``; 0 ``events_per_edge``: all edges are weak."""
    return [_synthetic_case(seed, index, events_per_edge) for seed in seeds for index in range(count)]


def _synthetic_case(seed, index, events_per_edge):
    rng = np.random.default_rng([seed, index])
    texture = ("lines", "dense")[index % 2]
    speed, angle, noise = rng.uniform(0, MAX_SPEED), rng.uniform(0, 2 * math.pi), rng.uniform(0, MAX_NOISE)
    wanted = rng.uniform(*ROI_EVENTS)
    way, off = rng.uniform(0, 2 * math.pi), WARM_RADIUS * math.sqrt(rng.uniform())
    start = off * np.array([math.cos(way), math.sin(way)])
    v = speed * np.array([math.cos(angle), math.sin(angle)])
    swept = 2 * speed * 2 / math.pi  # px across an edge, on average over the edge's directions
    contrast = min(max(events_per_edge / swept, 1.0), MAX_CONTRAST)
    room = ROI - 2 * MARGIN - 2 * np.abs(v)
    smallest, largest = SIZES[texture]
    sizes = np.arange(smallest, int(min(largest, *room)) + 1)
    # Expected edge points; of lines with the mean distance of two points in a square (cmfpga.events.synthetic).
    points = sizes**2 if texture == "dense" else np.maximum(1, np.round(sizes**2 / 100)) * 2 * 0.52 * sizes
    size = int(sizes[np.abs(points * contrast * swept - wanted * (1 - noise)).argmin()])
    for _ in range(100):
        centre = (ROI - 1) / 2 + rng.uniform(-0.5, 0.5, 2) * (room - size)
        made = generate(
            seed=int(rng.integers(1 << 31)), width=ROI, height=ROI, texture=texture, size=(size, size),
            position=tuple(centre - v), velocity=tuple(2 * v / (DURATION_US * 1e-6)), duration_us=DURATION_US,
            contrast=contrast, noise=noise,
        )  # fmt: skip
        if ROI_EVENTS[0] <= len(made.events) <= ROI_EVENTS[1]:
            break
    events = made.events
    truth = made.motion.per_half_batch(events.t[0], events.t[-1])
    facts = {"texture": texture, "speed": speed, "noise": noise, "roi_events": len(events)}
    facts |= {"size": size, "contrast": contrast}
    return Case(events, (0, 0), tuple(truth.tolist()), tuple((truth + start).tolist()), facts)
