"""Why v is too small or too large in a slow dense scene: the ROI's border, dither and camera, one at a time.

All scenes are synthetic, and their motion is constant. The warm ascent starts at the truth, so that no batch is lost.
"""

import functools
import math

import numpy as np

from cmfpga.events import Events, generate

from .table import measure, run_case
from .yardstick import ROI, Case

SPEEDS = (0.5, 0.75, 1.1, 1.5, 2.2, 4.0)  # px per half batch
BATCHES = 12  # of each speed
EVENTS = 1500  # of an object of OBJECT² px², about
OBJECT = 40  # px, of what stays inside the ROI
DURATION_US = 40_000
_SIDE = 80  # of the sensor: what enters the ROI exists before it does
_FINE = 8  # places per px of a pixel camera's texture
_BLUR_PX = 1.5
_STEPS = 100  # of a pixel camera in one batch


def edges(rng, v, size):
    """Events of edges, wherever they are, by :func:`cmfpga.events.generate`; ``size`` of the object in px."""
    contrast = EVENTS / (OBJECT**2 * 2 * math.hypot(*v) * 2 / math.pi)
    middle = np.full(2, (_SIDE - 1) / 2) + rng.uniform(-0.5, 0.5, 2)
    return generate(
        seed=int(rng.integers(1 << 31)), width=_SIDE, height=_SIDE, texture="dense", size=(size, size),
        position=tuple(middle - v), velocity=tuple(2e6 * v / DURATION_US), duration_us=DURATION_US, contrast=contrast,
    ).events  # fmt: skip


def pixels(rng, v, size, mismatch=0.0, refractory=0.0):
    """Events of pixels that each compare their brightness with the one at their last event.

    ``size`` of the object in px, which fades out towards its border; 0: the scene has no end. ``mismatch``: standard
    deviation of a pixel's threshold, as a share. ``refractory``: half batches for which it sees nothing after an event.
    """
    pattern = _texture(rng, size)
    crossed = 2 * math.hypot(*v) * 2 / math.pi * OBJECT**2 / 2  # half of it is turned back
    threshold = crossed / EVENTS * np.maximum(1 + mismatch * rng.standard_normal((_SIDE, _SIDE)), 0.2)
    row, column = np.mgrid[:_SIDE, :_SIDE] * 1.0
    step = 2 / _STEPS
    last = _seen(pattern, column, row, v, -3.0)
    reference, asleep = last + threshold * rng.uniform(-1, 1, last.shape), np.full(last.shape, -9.0)
    found = []
    for k in range(2 * _STEPS):  # the first half settles the references
        begin, end = -3 + k * step, -3 + (k + 1) * step
        now = _seen(pattern, column, row, v, end)
        reference = np.where((asleep > begin) & (asleep <= end), now, reference)
        while (fires := (np.abs(now - reference) >= threshold) & (asleep <= end)).any():
            y, x = np.nonzero(fires)
            sign = np.sign((now - reference)[y, x])
            reference[y, x] += sign * threshold[y, x]
            change = now[y, x] - last[y, x]
            share = np.clip((reference[y, x] - last[y, x]) / np.where(change == 0, 1, change), 0, 1)
            if refractory:
                asleep[y, x] = begin + share * step + refractory
            if begin >= -1:
                found.append(np.stack([begin + share * step, x, y, sign > 0]))
        last = now
    t, x, y, p = np.concatenate(found, axis=1)
    t = np.floor((t + 1) / 2 * (DURATION_US - 1))
    return Events.merge([Events(*(part.astype(np.int64) for part in (t, x, y, p)))])


def _texture(rng, size):
    """A smooth random pattern, periodic, whose gradient is 1 per px on average; of ``size`` px, if not 0."""
    places = _SIDE * _FINE
    wave = np.fft.fftfreq(places) * _FINE
    blur = np.exp(-2 * (np.pi * _BLUR_PX) ** 2 * (wave[:, None] ** 2 + wave**2))
    blur = blur * np.sinc(wave[:, None]) * np.sinc(wave)  # the pixel's own area
    pattern = np.fft.ifft2(np.fft.fft2(rng.standard_normal((places, places))) * blur).real
    pattern = pattern / np.hypot(*np.gradient(pattern, 1 / _FINE)).mean()
    if size:
        off = np.abs(np.arange(places) / _FINE - (_SIDE - 1) / 2)
        fade = np.clip((size / 2 - off) / 4, 0, 1)
        pattern = pattern * fade * fade[:, None]
    return pattern


def _seen(pattern, column, row, v, t):
    """Brightness at pixels at the time ``t``, half batches from the middle; bilinear between the pattern's places."""
    parts = []
    for at, axis in ((row, v[1]), (column, v[0])):
        place = (at - axis * t) * _FINE
        first = np.floor(place).astype(np.int64)
        parts.append((first % len(pattern), (first + 1) % len(pattern), place - first))
    (top, bottom, down), (left, right, across) = parts
    upper = pattern[top, left] * (1 - across) + pattern[top, right] * across
    lower = pattern[bottom, left] * (1 - across) + pattern[bottom, right] * across
    return upper * (1 - down) + lower * down


ROOMY = {"buffer_events": 8191}  # what holds the events of a scene that fills the ROI

#: What is seen, by whom, and fields of the configuration.
CAUSES = (
    ("edges, object inside the ROI", (edges, OBJECT), {}),
    ("edges, object inside, no dither", (edges, OBJECT), {"dither_frac": 0}),
    ("edges, scene beyond the ROI", (edges, _SIDE), ROOMY),
    ("pixels, object inside the ROI", (pixels, OBJECT), {}),
    ("pixels, object inside, no dither", (pixels, OBJECT), {"dither_frac": 0}),
    ("pixels, thresholds differ by 15 %", (pixels, OBJECT, 0.15), {}),
    ("pixels, blind for 0.2 half batches", (pixels, OBJECT, 0.0, 0.2), {}),
    ("pixels, scene beyond the ROI", (pixels, 0), ROOMY),
)


def cases(speed, camera, *how):
    """Batches of one speed as ``camera(rng, v, *how)`` sees them; directions are spread evenly."""
    made = []
    for index in range(BATCHES):
        angle = 2 * math.pi * (index + 0.37) / BATCHES
        v = speed * np.array([math.cos(angle), math.sin(angle)])
        events = camera(np.random.default_rng([7, index]), v, *how)
        truth = tuple(v * (int(events.t[-1]) - int(events.t[0])) / DURATION_US)
        made.append(Case(events, ((_SIDE - ROI) // 2,) * 2, truth, truth, {}))
    return made


def _shares(engine, batches):
    """v along the truth, as a share of it."""
    found = ((np.array(run_case(engine, case, warm=True).v), np.array(case.truth)) for case in batches)
    return np.array([v @ truth / (truth @ truth) for v, truth in found])


def study_bias(config, engine, cases_, real, report, **_):
    """Print v over the true v by cause and speed."""
    make, rows = functools.cache(cases), []
    for name, camera, fields in report.progress(CAUSES, "row"):
        cells = []
        for speed in SPEEDS:
            shares = measure(engine, config.replace(**fields), _shares, make(speed, *camera))
            report.keep(f"bias, {name}, {speed}", shares, {"median": float(np.median(shares))})
            cells.append(f"{np.median(shares):.2f}")
        rows.append((name, *cells))
    heads = ("v found / true v, at px per half batch:", *map(str, SPEEDS))
    report.table(f"Bias in dense scenes, warm from the truth: median of {BATCHES} batches", heads, rows)
