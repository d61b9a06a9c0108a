"""Batches of synthetic events with exactly N events, n of them in the ROI."""

from dataclasses import dataclass

import numpy as np

from cmfpga.events import Events, generate
from cmfpga.imaging.iwe import events_in_roi

#: How far the object moves in half a batch, px; the middle of where batches are measured best.
MOTION_PX = (3.0, -2.0)
DURATION_US = 50_000
#: Share of the ROI's events that are noise.
NOISE = 0.05


@dataclass(frozen=True, kw_only=True)
class Workload:
    """A batch.

    Parameters
    ----------
    name : str
        For the table.
    events : Events
        N of them.
    roi : (int, int)
        Left column and top row, px.
    width, height : int
        Size of the ROI, px.
    roi_events : int
        n.
    v : (float, float)
        True motion, px per half batch.
    """

    name: str
    events: Events
    roi: tuple[int, int]
    width: int
    height: int
    roi_events: int
    v: tuple[float, float]


def make_workload(name, *, events, roi_events, width=64, height=64, sensor=(240, 180), seed=1):
    """An object that fills 60 % of the ROI's width and height and moves by :data:`MOTION_PX` in half a batch.

    A longer and denser recording than is needed is thinned evenly to ``roi_events``; events outside the ROI are noise,
    uniform over the rest of the sensor and over time.
    """
    roi = ((sensor[0] - width) // 2, (sensor[1] - height) // 2)
    rng = np.random.default_rng(seed)
    half = DURATION_US / 2e6
    scene = generate(
        seed=seed, width=sensor[0], height=sensor[1], size=(round(0.6 * width), round(0.6 * height)),
        velocity=tuple(axis / half for axis in MOTION_PX),
        position=tuple(
            corner + (size - 1) / 2 - move for corner, size, move in zip(roi, (width, height), MOTION_PX, strict=True)
        ),
        duration_us=DURATION_US, noise=NOISE,
    )  # fmt: skip
    inside = scene.events[events_in_roi(scene.events, roi, width, height)[0]]
    while len(inside) < roi_events:  # too sparse: the same object with more events a pixel
        scene = generate(**{**vars(scene.scene), "contrast": 2 * scene.scene.contrast})
        inside = scene.events[events_in_roi(scene.events, roi, width, height)[0]]
    inside = inside[np.sort(rng.choice(len(inside), roi_events, replace=False))]
    outside = _outside(events - roi_events, roi, width, height, sensor, rng)
    batch = Events.merge([inside, outside])
    return Workload(name=name, events=batch, roi=roi, width=width, height=height, roi_events=roi_events, v=MOTION_PX)


def _outside(count, roi, width, height, sensor, rng):
    parts = []
    while (missing := count - sum(map(len, parts))) > 0:
        t = rng.integers(DURATION_US, size=2 * missing)
        x, y = (rng.integers(size, size=2 * missing) for size in sensor)
        made = Events(t, x, y, np.zeros(len(t)))
        parts.append(made[np.delete(np.arange(len(t)), events_in_roi(made, roi, width, height)[0])][:missing])
    return Events.concatenate(parts)
