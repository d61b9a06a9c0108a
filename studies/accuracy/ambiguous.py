"""Scenes whose v may be wrong though the contrast has a sharp peak: how many batches are trusted and wrong.

Gratings, straight edges, two motions in one ROI, a motion that changes; and single motions, which are to stay trusted.
Wrong is off by more than :data:`~studies.accuracy.default_use.WRONG` from every motion in the ROI, and from the mean of
one that changes. Each batch starts at v = 0; the buffer is that of windows that slide.
"""

import math
from contextlib import closing

import numpy as np

from cmfpga.config import preset
from cmfpga.engines import make_engine
from cmfpga.events import Events, generate
from cmfpga.protocol.confidence import is_trustworthy
from cmfpga.tracking.ambiguity import UNTRUSTED, WORDS, Ambiguity, ambiguity

from .default_use import WRONG
from .table import percent, run_case
from .yardstick import ROI, Case

SENSOR, PLACE, MIDDLE = (240, 180), (88, 58), np.array([119.5, 89.5])
DURATION_US = 40_000
SPEED = (1.6, 4.5)  # px per half batch
APART = (1.0, 3.5)  # of two motions, px per half batch
FASTER = (1.3, 2.2)  # of two depths
CONTRAST = (0.7, 4.0)
PERIOD, ANGLE = (5.0, 20.0), math.radians(70)  # of gratings, px
LATE_US = (200.0, 1500.0)  # standard deviation of time errors
HEADS = (
    "scene", "batches", "by the confidence alone: trusted, %", "of all, trusted and wrong, %", "trusted, %",
    "of all, trusted and wrong, %", "right ones that stay trusted, %", "told",
)  # fmt: skip


def _late(events, rng):
    """The same events with errors of their times."""
    late = np.rint(rng.normal(0, rng.uniform(*LATE_US), len(events))).astype(np.int64)
    return Events.merge([Events(np.maximum(events.t + late, 0), events.x, events.y, events.p)])


def _object(rng, v, texture, size, contrast, off=0, velocity=None, **fields):
    """An object that is ``off`` the ROI's middle, px, in the batch's middle; ``v`` is the mean of ``velocity``."""
    return generate(
        seed=int(rng.integers(1 << 30)), texture=texture, size=size, velocity=velocity or tuple(2e6 * v / DURATION_US),
        position=tuple(MIDDLE + off - v), duration_us=DURATION_US, contrast=contrast, **fields,
    ).events  # fmt: skip


def _straight(rng, v, normal, edges, half):
    """Straight edges, at so many px along ``normal``, that cover ``half`` px on each side of the ROI's middle."""
    along = np.arange(-1.5 * half, 1.5 * half)
    normal = np.array([math.cos(normal), math.sin(normal)])
    points = np.concatenate([at * normal + np.outer(along + rng.random(), normal[::-1] * (-1, 1)) for at in edges])
    points = points[(np.abs(points) <= half).all(axis=1)]
    rate = rng.uniform(1, CONTRAST[1]) * abs(normal @ v)  # events of a point in half a batch
    count = math.ceil(2 * rate) + 1
    times = (rng.random((len(points), 1)) + np.arange(count)) / max(rate, 1e-9) - 1
    point, kept = np.nonzero(times < 1)
    times = times[point, kept]
    x, y = np.rint(points[point] + MIDDLE + times[:, None] * v).astype(np.int64).T
    t, order = ((times + 1) * (DURATION_US / 2)).astype(np.int64), np.argsort(times, kind="stable")
    return Events(t[order], x[order], y[order], np.zeros(len(t), np.uint8))


def _velocity(rng, angle=None, speed=SPEED):
    angle = rng.uniform(0, 2 * math.pi) if angle is None else angle
    return rng.uniform(*speed) * np.array([math.cos(angle), math.sin(angle)])


def single(rng, k):
    """One object, every second with errors of its times."""
    v, size = _velocity(rng), tuple(int(side) for side in rng.integers(16, 60, 2))
    noise, contrast = rng.uniform(0, 0.25), rng.uniform(*CONTRAST)
    events = _object(rng, v, ("lines", "dense")[k % 2], size, contrast, noise=noise)
    return (_late(events, rng) if k % 4 > 1 else events), (v,)


def grating(rng, k):
    """Stripes that fill the ROI, or a patch of them; every third moves anywhere, every fourth too slowly."""
    angle, period, half = rng.uniform(0, ANGLE), rng.uniform(*PERIOD), (26, 45)[k % 2]
    v = _velocity(rng, angle + math.pi * rng.integers(2) if k % 3 else None)
    v *= rng.uniform(0.05, 0.5) if k % 4 == 0 else 1
    return _straight(rng, v, angle, np.arange(-1.5 * half, 1.5 * half, period / 2), half), (v,)


def late_grating(rng, k):
    """The same with errors of its times."""
    events, motions = grating(rng, k)
    return _late(events, rng), motions


def edge(rng, k):
    """One to three straight edges that cross the ROI, every second with errors of their times."""
    v, edges = _velocity(rng), rng.uniform(-20, 20, rng.integers(1, 4))
    events = _straight(rng, v, rng.uniform(0, math.pi), edges, 45)
    return (_late(events, rng) if k % 2 else events), (v,)


def _two(rng, k, one, two, through):
    below, contrast = k // 2 % 2, rng.uniform(*CONTRAST)
    size = (44, 44) if through else ((28, 56), (56, 28))[below]
    off = np.array(((15.0, 0.0), (0.0, 15.0))[below]) * (0.3 if through else 1)
    texture = "lines" if through else ("lines", "dense")[k % 2]
    made = [_object(rng, v, texture, size, contrast, off * side) for v, side in ((one, -1), (two, 1))]
    return Events.merge(made), (one, two)


def beside(rng, k, through=False):
    """Two objects beside each other, each with a motion of its own."""
    v = _velocity(rng)
    return _two(rng, k, v, v + _velocity(rng, speed=APART), through)


def through(rng, k):
    """Two objects of lines, one before the other."""
    return beside(rng, k, through=True)


def depths(rng, k):
    """Two depths: the same direction, one faster."""
    v = 0.7 * _velocity(rng)
    return _two(rng, k, v, v * rng.uniform(*FASTER), k % 3 == 0)


def stops(rng, k, turns=False):
    """One object that stops, or starts, at some time of the batch; or has another velocity from then on."""
    v, share = _velocity(rng), rng.uniform(0.25, 0.75)
    two = (v, (-v, _velocity(rng))[k // 2 % 2] if turns else 0 * v)[:: 1 if k % 2 else -1]
    mean = share * two[0] + (1 - share) * two[1]
    pieces = zip((share, 1 - share), two, strict=True)
    pieces = [(int(part * DURATION_US), *(2e6 * one / DURATION_US)) for part, one in pieces]
    size, contrast = tuple(int(side) for side in rng.integers(16, 60, 2)), rng.uniform(*CONTRAST)
    texture, noise = ("lines", "dense")[k // 4 % 2], rng.uniform(0, 0.25)
    return _object(rng, mean, texture, size, contrast, velocity=pieces, noise=noise), (*two, mean)


def turns(rng, k):
    """The same where it turns back, or elsewhere."""
    return stops(rng, k, turns=True)


SCENES = {
    "single motion": single, "gratings": grating, "gratings, time errors": late_grating, "straight edges": edge,
    "stops or starts": stops, "turns": turns, "two motions, beside": beside, "two motions, through each other": through,
    "two depths": depths,
}  # fmt: skip


def judged(engine, scene, count, seed=1):
    """Trusted by the hardware, error in px per half batch, what is open: float64 [batches, 3]."""
    rng, found = np.random.default_rng([seed, *scene.__name__.encode()]), []
    for k in range(count):
        events, motions = scene(rng, k)
        result = run_case(engine, Case(events, PLACE, None, None, {}))
        left = ambiguity(engine.config, events, result, thinned=bool(result.thinned))
        error = min(math.dist(result.v, v * result.span / DURATION_US) for v in motions)
        found.append((is_trustworthy(engine.config, result), error, left))
    return np.array(found, float).reshape(-1, 3)


def counts(values):
    """The values as numbers of batches."""
    before, wrong, left = values[:, 0] > 0, values[:, 1] > WRONG, values[:, 2].astype(int)
    trusted = before & (left & UNTRUSTED == 0)
    which = {
        "trusted_before": before, "wrong_before": before & wrong, "trusted": trusted, "wrong": trusted & wrong,
        "right_before": before & ~wrong, **{one.name.lower(): before & (left & one > 0) for one in Ambiguity},
    }  # fmt: skip
    return {"batches": len(values), **{name: int(chosen.sum()) for name, chosen in which.items()}}


def study_ambiguous(config, engine, cases, real, report, *, count, seeds, **_):
    """Print how many batches of each scene are trusted, and wrong: by the confidence alone, and with what is open."""
    config = config.replace(buffer_events=preset("sliding").buffer_events, roi_width=ROI, roi_height=ROI)
    rows = []
    with closing(make_engine(engine, config)) as opened:
        for name, scene in SCENES.items():
            values = np.concatenate([judged(opened, scene, count, seed) for seed in seeds])
            found = report.keep(f"ambiguous, {name}", values, counts(values))
            whole = found["batches"]
            shares = (percent(found[key], whole) for key in ("trusted_before", "wrong_before", "trusted", "wrong"))
            stay = percent(found["trusted"] - found["wrong"], found["right_before"])
            told = (f"{many} {text}" for one, text in WORDS.items() if (many := found[one.name.lower()]))
            rows.append((name, whole, *shares, stay, ", ".join(told) or "–"))
    title = "What is trusted, by the confidence alone and when asked what is open"
    report.table(f"{title} (wrong: by more than {WRONG} px)", HEADS, rows)
