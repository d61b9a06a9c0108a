"""Dense flow on large sensors, in the windows that ``flow`` chooses: how many trusted tiles are right.

Objects of short bars lie all over the sensor, and move as one field says: they slide, turn, come nearer, or a part of
them moves on its own. Before: what each tile says of itself; after: what the tiles around bear out, too.
"""

import warnings
from contextlib import closing

import numpy as np

from cmfpga.api.flow import configure
from cmfpga.dense.window import Run
from cmfpga.engines import make_engine
from cmfpga.events import Events, MemoryRecording, generate

from .default_use import WRONG, held, in_ellipses, sizes
from .table import percent

#: Width and height, and the share that objects cover. Of more events the largest window is too short for 3 px.
SENSORS = ((1280, 720, 0.55), (1280, 720, 0.25), (640, 480, 0.55))
OBJECT, BARS = 110, 10  # px, and bars, of an object
PIECE_US, DURATION_US = 5_000, 120_000
#: Velocity of the middle of a sensor of 1280 px, px/s, growth, 1/s, and roll, rad/s; of all, or of both parts.
FIELDS = {
    "translation": [((380.0, -170.0), 0.0, 0.0)],
    "turn": [((60.0, -40.0), 0.0, 1.2)],
    "zoom": [((60.0, -40.0), 1.2, 0.0)],
    "zoom and turn": [((-120.0, 90.0), -0.7, 0.8)],
    "two motions": [((250.0, 60.0), 0.0, 0.0), ((-180.0, -220.0), 0.0, 0.0)],
}
HEADS = (
    "scene", "sensor", "covered, %", "tiles", "before: trusted", "within 0.6 px, %", "after: trusted",
    "within 0.6 px, %", "right ones kept, %", "in the 50, 68, 95 % ellipse, %",
)  # fmt: skip


def _at(field, off):
    """Velocity at so many px from the sensor's middle, px/s."""
    v, growth, roll = field
    x, y = off[..., 0], off[..., 1]
    return np.stack([v[0] + growth * x - roll * y, v[1] + growth * y + roll * x], axis=-1)


def scene(name, width, height, share, seed):
    """Events, and the fields of the scene, scaled to the sensor."""
    sensor = width, height
    rng, middle = np.random.default_rng([seed, *name.encode(), *sensor]), (np.array(sensor) - 1) / 2
    scale = width / 1280
    fields = [((vx * scale, vy * scale), growth, roll) for (vx, vy), growth, roll in FIELDS[name]]
    parts = []
    for _ in range(round(share * width * height / OBJECT**2)):
        at = rng.uniform(0, sensor)
        inner = len(fields) > 1 and (np.abs(at - middle) < np.array(sensor) / 4).all()
        field, place, velocity = fields[-1 if inner else 0], at, []
        for _ in range(DURATION_US // PIECE_US):
            v = _at(field, place - middle)
            velocity.append((PIECE_US, *v))
            place = place + v * PIECE_US * 1e-6
        parts.append(generate(
            seed=int(rng.integers(1 << 30)), width=width, height=height, size=(OBJECT, OBJECT), bars=BARS,
            position=tuple(at), velocity=velocity, zoom=field[1], roll=field[2], duration_us=DURATION_US, noise=0.05,
        ).events)  # fmt: skip
    return Events.merge(parts), fields


def measured(name, width, height, share, seed, engine="model"):
    """The first window of a scene; each tile's error, px per half window, and that in deviations, squared; or NaN."""
    events, fields = scene(name, width, height, share, seed)
    recording = MemoryRecording(events, width, height, name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        config, tiles, _ = configure(recording, "flow", {}, None, None, str)
    with closing(make_engine(engine, config)) as opened:
        (window,) = Run(recording, opened, tiles, windows=1)
    middle = (np.array([width, height]) - 1) / 2
    off = np.array([(window.v - _at(one, window.centres - middle) * window.half_s).T for one in fields])
    off = np.moveaxis(off, 1, 0)
    errors, squares = np.hypot(*off), sizes(off, tuple(window.covariance.T * window.half_s**2))
    return window, np.min(errors, axis=0), np.min(squares, axis=0)


def study_large(config, engine, cases, real_, report, *, seeds, **_):
    """Print how many trusted tiles are within :data:`~.default_use.WRONG`, before and after they were compared."""
    rows = []
    for sensor in SENSORS:
        found = {}
        for name in report.progress(FIELDS, "scene"):
            counts, inside = np.zeros(5, int), []
            for seed in seeds:
                window, errors, squares = measured(name, *sensor, seed, engine)
                right, before = errors <= WRONG, window.sure & ~window.short
                sets = np.isfinite(errors), before, before & right, window.trusted, window.trusted & right
                counts += [int(one.sum()) for one in sets]
                inside.append(squares[window.trusted])
            found[name] = counts, np.concatenate(inside)
        counts, inside = zip(*found.values(), strict=True)
        found["sum"] = sum(counts), np.concatenate(inside)
        rows += [_row(report, name, sensor, *of_it) for name, of_it in found.items()]
    report.table("Dense flow on large sensors, windows as chosen: of the trusted tiles", HEADS, rows)


def _row(report, name, sensor, found, squares):
    tiles, before, right, after, still = map(int, found)
    size = f"{sensor[0]}×{sensor[1]}"
    scores = {"tiles": tiles, "before": before, "right_before": right, "after": after, "right_after": still}
    scores["in_ellipses"] = in_ellipses(squares)
    report.keep(f"large, {name}, {size}, {sensor[2]}", found, scores)
    covered, one, two = f"{100 * sensor[2]:.0f}", percent(right, before), percent(still, after)
    return name, size, covered, tiles, before, one, after, two, percent(still, right), held(scores)
