"""``python -m cmfpga.accuracy``: how well the motion is found, on batches whose motion is known and on real ones.

The suites are made by rules that look at events, never at results; docs/accuracy.md tells what they show.

*Synthetic* (:func:`synthetic_cases`). An object moves at a constant, known velocity. For each batch these are drawn:
its texture (sparse line segments, or dense), speed 0 to 9 px per half batch, direction, share of noise events 0 to
30 %, and a number of ROI events to aim at, 200 to 2000. The events are not thinned out: what an edge emits is what it
crosses. An edge is strong enough to emit :data:`EVENTS_PER_EDGE` events on average during the batch, so a slow object
has edges of several contrast thresholds per pixel, up to :data:`MAX_CONTRAST`; and the object is as large as the number
of events asks for, within limits: large enough to have a shape, small enough to stay in the ROI. A scene that gives
fewer than 200 or more than 2000 events all the same is drawn anew with the same velocity.

*Real* (:func:`real_cases`). :data:`WINDOWS` of recordings of DAVIS cameras, in each of which the image moves by 3 to
5 px per half batch, and in each window the ROIs with most events. The motion is not known, so the yardstick is the
contrast at the v found, as a share of the best that a fine search finds (:func:`contrasts` tells which contrast). They
run with the configuration as it is: where its buffer is too small for a batch, events are dropped, and that is counted.

*Track* (:func:`track_checkerboard`). A real recording of a camera that is tilted at a constant speed, tracked batch by
batch with a moving ROI.
"""

import argparse
import dataclasses
import json
import math
import os
import sys
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from tqdm import tqdm

from .. import cli
from ..config import preset
from ..config.schedule import AUTO, MEASURED
from ..engines import ENGINES, make_engine
from ..errors import ConfigError, RecordingError
from ..events import BatchCutter, Events, generate, open_recording
from ..imaging.iwe import scaled_roi_events
from ..protocol.settings import BatchSettings
from ..tracking.loop import track

EXAMPLES = (
    "python -m cmfpga.accuracy                                # 300 synthetic batches, by the integer model",
    "python -m cmfpga.accuracy --data recordings --engine all # all suites, by Verilog, model and float",
    "python -m cmfpga.accuracy --set weight_frac=3 --batches 100 --json scores.json",
    "python -m cmfpga.accuracy --seeds 1-3                    # 900 synthetic batches",
    "python -m cmfpga.accuracy --study widths --data recordings",
)

ROI = 64  # columns and rows of the ROI of all suites, px

# -------------------------------------------------------------------- synthetic batches

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


@dataclass(frozen=True, eq=False)
class Case:
    """A batch, and what is known about it.

    Parameters
    ----------
    events : Events
        All events of the batch.
    roi : pair of int
        Left column and top row, px.
    truth : (float, float) or None
        True velocity, px per half batch.
    start : (float, float) or None
        Where the warm suite starts, px per half batch.
    facts : dict
        What the batch is made of, by name.
    """

    events: Events
    roi: tuple[int, int]
    truth: tuple[float, float] | None
    start: tuple[float, float] | None
    facts: dict

    @cached_property
    def scaled(self):
        """Columns and rows in the ROI, and dt, of the ROI's events."""
        return scaled_roi_events(_suite_config(), self.events, self.roi)

    @cached_property
    def best(self):
        """``(v, contrast)`` of a fine search, events spread over their pixels."""
        return best_contrast(*self.scaled)

    @cached_property
    def best_unspread(self):
        """The same of the article's objective."""
        return best_contrast(*self.scaled, spread=False)


def _suite_config():
    """Geometry and limits for what is computed in float64 here: nothing is dropped."""
    return preset("paper").replace(buffer_events=1 << 14)


def synthetic_cases(count=BATCHES, *, seeds=SEEDS, events_per_edge=EVENTS_PER_EDGE):
    """The first ``count`` synthetic batches of each of ``seeds``, a list of :class:`Case`.

    0 ``events_per_edge``: all edges are weak.
    """
    return [_synthetic_case(seed, index, events_per_edge) for seed in seeds for index in range(count)]


def _synthetic_case(seed, index, events_per_edge):
    rng = np.random.default_rng([seed, index])
    texture = ("lines", "dense")[index % 2]
    speed, angle, noise = rng.uniform(0, MAX_SPEED), rng.uniform(0, 2 * math.pi), rng.uniform(0, MAX_NOISE)
    wanted = rng.uniform(*ROI_EVENTS)
    start = _in_circle(rng)
    v = speed * np.array([math.cos(angle), math.sin(angle)])
    swept = 2 * speed * 2 / math.pi  # px across an edge, on average over the edge's directions
    contrast = min(max(events_per_edge / swept, 1.0), MAX_CONTRAST)
    room = ROI - 2 * MARGIN - 2 * np.abs(v)
    smallest, largest = SIZES[texture]
    sizes = np.arange(smallest, int(min(largest, *room)) + 1)
    points = np.array([_edge_points(texture, size) for size in sizes])
    size = int(sizes[np.abs(points * contrast * swept - wanted * (1 - noise)).argmin()])
    for _ in range(100):
        centre = (ROI - 1) / 2 + rng.uniform(-0.5, 0.5, 2) * (room - size)
        made = generate(
            seed=int(rng.integers(1 << 31)),
            width=ROI,
            height=ROI,
            texture=texture,
            size=(size, size),
            position=tuple(centre - v),
            velocity=tuple(2 * v / (DURATION_US * 1e-6)),
            duration_us=DURATION_US,
            contrast=contrast,
            noise=noise,
        )
        if ROI_EVENTS[0] <= len(made.events) <= ROI_EVENTS[1]:
            break
    events = made.events
    truth = made.motion.per_half_batch(events.t[0], events.t[-1])
    facts = {
        "seed": seed,
        "index": index,
        "texture": texture,
        "speed": speed,
        "noise": noise,
        "roi_events": len(events),
        "size": size,
        "contrast": contrast,
    }
    return Case(events, (0, 0), tuple(truth.tolist()), tuple((truth + start).tolist()), facts)


def _in_circle(rng):
    angle, radius = rng.uniform(0, 2 * math.pi), WARM_RADIUS * math.sqrt(rng.uniform())
    return radius * np.array([math.cos(angle), math.sin(angle)])


def _edge_points(texture, size):
    """Expected edge points of an object of ``size`` × ``size`` px (see :mod:`cmfpga.events.synthetic`)."""
    if texture == "dense":
        return size * size
    return max(1, round(size * size / 100)) * 2 * 0.52 * size  # mean distance of two points in a square


# -------------------------------------------------------------------- real batches


@dataclass(frozen=True)
class Windows:
    """Consecutive windows of a recording: begin and length in µs from the recording's first event, and ROIs of each."""

    file: str
    begin: int
    length: int
    count: int
    rois: int
    hot: tuple[int, int] | None = None  # a pixel that emits by itself, px


# Lengths from the speeds that are known of each recording: about 4 px per half window.
WINDOWS = (
    Windows("davis240c_shapes_rotation_0.0s.h5", 760_000, 65_000, 6, 4),  # 120 px/s
    Windows("davis240c_shapes_rotation_2.1s_gtflow.h5", 0, 66_000, 1, 5),  # 120 px/s
    Windows("davis240c_shapes_translation_52.0s.h5", 0, 14_000, 3, 4),  # 560 px/s
    Windows("davis240c_slider_depth_0.0s.h5", 10_000, 80_000, 2, 4),  # 40 to 150 px/s
    Windows("davis240c_translboxes_imu.h5", 0, 300_000, 6, 2),  # 19 to 31 px/s
    Windows("davis240b_evbench_seq0002.h5", 0, 240_000, 8, 2, hot=(27, 70)),  # 32 px/s
)
REAL_ROI_EVENTS = (500, 4096)
ROI_STEP = 8  # px; ROIs are looked for at multiples of this


def real_cases(folder, *, every=1):
    """The real batches, a list of :class:`Case`; with ``every`` = k each k-th of them.

    In each window the ROI with most events is taken first, then the one with most events of those that do not overlap
    it, and so on; ROIs with fewer than 500 or more than 4096 events, or with a hot pixel, are not taken.

    Raises :exc:`RecordingError` where a recording is missing.
    """
    return [case for windows in WINDOWS for case in _real_cases(Path(folder), windows)][::every]


def _real_cases(folder, windows):
    with open_recording(folder / windows.file) as recording:
        events = Events.concatenate(recording.chunks())
        sensor = recording.width, recording.height
    begins = events.t[0] + windows.begin + windows.length * np.arange(windows.count + 1)
    cuts = np.searchsorted(events.t, begins)
    for index, (first, last) in enumerate(pairwise(cuts)):
        batch = events[first:last]
        for roi, count in _busiest_rois(batch, sensor, windows):
            facts = {"file": windows.file, "window": index, "roi": roi, "roi_events": count}
            yield Case(batch, roi, None, None, facts)


def _busiest_rois(batch, sensor, windows):
    """``[((x, y), events)]`` of one window."""
    at = [
        (x, y)
        for y in range(0, sensor[1] - ROI + 1, ROI_STEP)
        for x in range(0, sensor[0] - ROI + 1, ROI_STEP)
        if not windows.hot or not (0 <= windows.hot[0] - x < ROI and 0 <= windows.hot[1] - y < ROI)
    ]
    pixels = np.zeros((sensor[1] + 1, sensor[0] + 1), np.int64)
    np.add.at(pixels, (batch.y + 1, batch.x + 1), 1)
    total = pixels.cumsum(0).cumsum(1)
    found = []
    counts = {(x, y): total[y + ROI, x + ROI] - total[y, x + ROI] - total[y + ROI, x] + total[y, x] for x, y in at}
    counts = {roi: int(n) for roi, n in counts.items() if REAL_ROI_EVENTS[0] <= n <= REAL_ROI_EVENTS[1]}
    while counts and len(found) < windows.rois:
        x, y = best = max(counts, key=counts.get)
        found.append((best, counts[best]))
        counts = {(a, b): n for (a, b), n in counts.items() if abs(a - x) >= ROI or abs(b - y) >= ROI}
    return found


# -------------------------------------------------------------------- contrast


def _bilinear(position):
    """First pixel and weights of the two pixels along one axis."""
    first = np.floor(position)
    after = position - first
    return first.astype(np.int64), (1 - after, after)


def _spread(position):
    """First pixel and weights of the three pixels along one axis: :func:`_bilinear`, averaged over a pixel's width."""
    middle = np.floor(position + 0.5)
    u = position - middle
    return middle.astype(np.int64) - 1, (0.5 * (0.5 - u) ** 2, 0.75 - u**2, 0.5 * (0.5 + u) ** 2)


def contrasts(x, y, dt, velocities, *, spread=True):
    """Contrast (population variance of the image of warped events) at each of ``velocities`` [k, 2]: float64 [k].

    Without ``spread`` this is the article's contrast, that of :func:`cmfpga.imaging.iwe.contrast`. It is no fair
    yardstick: events lie on whole pixels, so the image is sharper wherever vx or vy is zero, whatever the motion is.
    With ``spread`` each event is spread evenly over its pixel before it votes, as it may have come from anywhere in it.
    image is then the mean over all dithers; no particular dither is favoured.
    """
    kernel = _spread if spread else _bilinear
    values = np.empty(len(velocities))
    rim = 3  # px; takes what falls outside
    stride = ROI + 2 * rim
    for k, (vx, vy) in enumerate(velocities):
        left, across = kernel(np.clip(x - dt * vx, 1.0 - rim, ROI + 0.5))
        top, down = kernel(np.clip(y - dt * vy, 1.0 - rim, ROI + 0.5))
        first = (top + rim) * stride + left + rim
        pixel = np.concatenate([first + j * stride + i for j in range(len(down)) for i in range(len(across))])
        weight = np.concatenate([wy * wx for wy in down for wx in across])
        image = np.bincount(pixel, weight, stride * stride).reshape(stride, stride)
        values[k] = image[rim : rim + ROI, rim : rim + ROI].var()
    return values


def best_contrast(x, y, dt, *, centre=(0.0, 0.0), radius=8.0, step=0.5, rounds=3, spread=True):
    """``(v, contrast)`` of a search on a grid of ``step`` px around ``centre``, refined ``rounds`` times by 4."""
    axis = np.arange(-radius, radius + step / 2, step)
    best, highest = np.asarray(centre, float), -1.0
    for _ in range(rounds + 1):
        grid = best + np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
        values = contrasts(x, y, dt, grid, spread=spread)
        if values.max() > highest:
            best, highest = grid[values.argmax()], float(values.max())
        axis = np.arange(-4, 5) * step / 4
        step /= 4
    return tuple(best.tolist()), highest


def peak_error(case, radius=1.5):
    """How far, in px per half batch, the dithered objective's own best v lies from the truth, within ``radius`` px.

    An ascent that found the peak exactly would err by this much. Peaks farther away are not looked for.
    """
    from ..reference.floating import dither

    x, y, dt = case.scaled
    offset_x, offset_y = (offset.numpy() for offset in dither(len(x)))
    events = x + offset_x, y + offset_y, dt
    found, _ = best_contrast(*events, centre=case.truth, radius=radius, step=0.25, spread=False)
    return math.dist(found, case.truth)


# -------------------------------------------------------------------- running


def run_case(engine, case, *, warm=False):
    """Result of ``engine`` for ``case``: from v = 0 by the cold schedule, or from ``case.start`` by the warm one."""
    config = engine.config
    settings = BatchSettings.from_config(config, case.roi)
    start = case.start if warm else (0.0, 0.0)
    settings = dataclasses.replace(
        settings,
        start_last=False,
        v_start=tuple(config.formats.v.raw(axis) for axis in start),
        cold=settings.warm if warm else settings.cold,
    )
    return engine.run(case.events, settings)


def errors(engine, cases, *, warm=False, progress=iter):
    """Euclidean distance of the v found from the truth, px per half batch: float64 [cases]."""
    return np.array([math.dist(run_case(engine, case, warm=warm).v, case.truth) for case in progress(cases)])


def contrast_shares(engine, cases, *, progress=iter):
    """Contrast at the v found as a share of the best, with events spread and as in the article: float64 [cases, 3].

    The contrast is of all events of the batch's ROI. The last column counts those that did not fit into the buffer.
    """
    shares = []
    for case in progress(cases):
        result = run_case(engine, case)
        spread, plain = (contrasts(*case.scaled, [result.v], spread=spread)[0] for spread in (True, False))
        shares.append((spread / case.best[1], plain / case.best_unspread[1], result.overflow))
    return np.array(shares)


def error_scores(values):
    """``errors`` as scores: shares of the batches that err by less than 0.3 and 0.6 px, median and largest error."""
    return {
        "batches": len(values),
        "below_0.3_px": float(np.mean(values < 0.3)),
        "below_0.6_px": float(np.mean(values < 0.6)),
        "median_px": float(np.median(values)),
        "largest_px": float(np.max(values)),
    }


def share_scores(values):
    """``contrast_shares`` as scores: shares of the batches that reach 97 % and 99 % of the best contrast, and so on."""
    spread, plain, dropped = values.T
    return {
        "batches": len(values),
        "at_least_97_percent": float(np.mean(spread >= 0.97)),
        "at_least_99_percent": float(np.mean(spread >= 0.99)),
        "median": float(np.median(spread)),
        "smallest": float(np.min(spread)),
        "articles_at_least_97_percent": float(np.mean(plain >= 0.97)),
        "batches_that_drop_events": int(np.count_nonzero(dropped)),
    }


TRACK_FILE = "davis240b_evbench_seq0002.h5"
TRACK_ROI = (92, 66)
TRACK_EVENTS = 20_000
TRACK_BATCHES = 10
#: Tracks: with a buffer that holds the ROI's 11,000 events; as the configuration is; thinned out to fewer than 1,024.
TRACKS = {"track": {"buffer_events": 1 << 14}, "track as it is": {}, "thinned track": {"thinning": 12}}
#: px/s, along x and y; fewer events are a noisier velocity.
TRACK_BOUNDS = dict.fromkeys(TRACKS, ((-7.0, 7.0), (-34.0, -28.0))) | {"track": ((-4.0, 4.0), (-34.0, -29.0))}


def track_config(config, what):
    """``config`` for one of :data:`TRACKS`, started from the last batch's v."""
    return config.replace(start="last", **TRACKS[what])


def track_checkerboard(engine, folder, *, batches=TRACK_BATCHES):
    """(vx, vy) of each batch in px/s; (nan, nan) of a degenerate one: float64 [batches, 2]."""
    with open_recording(Path(folder) / TRACK_FILE) as recording:
        cutter = BatchCutter(recording, events=TRACK_EVENTS, max_events=engine.config.max_batch_events)
        speeds = [batch.v_px_per_s for batch in track(engine, cutter, roi=TRACK_ROI, batches=batches)]
    return np.array([speed or (math.nan, math.nan) for speed in speeds])


def track_scores(speeds, what):
    """``track_checkerboard`` as scores."""
    (left, right), (top, bottom) = TRACK_BOUNDS[what]
    vx, vy = speeds.T
    good = (vx >= left) & (vx <= right) & (vy >= top) & (vy <= bottom)  # no NaN is
    return {
        "batches": len(speeds),
        "within_bounds": int(good.sum()),
        "vx_px_per_s": [float(np.fmin.reduce(vx)), float(np.fmax.reduce(vx))],
        "vy_px_per_s": [float(np.fmin.reduce(vy)), float(np.fmax.reduce(vy))],
    }


# -------------------------------------------------------------------- studies

#: The default schedules before there were strides.
BEFORE = {
    "cold": "2:2 2:1*2 2:0*2 1:0 1:-1*2 1:-2*2 1:-3*2 0:-3 0:-4 0:-5",
    "warm": "1:0 1:-1 1:-2 1:-3*2 0:-3 0:-4 0:-5",
}

#: Cold schedules to compare.
SCHEDULES = (
    MEASURED["cold"],
    "2:2/4 2:1/4*2 2:0/4*3 1:0/2 1:-1/2*2 1:-2/2 1:-2*2 1:-3*2 0:-3 0:-4",  # an iteration more at full resolution
    BEFORE["cold"],
    "2:1*4 2:0*2 1:0 1:-1*2 1:-2*2 1:-3*2 0:-3 0:-4 0:-5",  # the same reach, a step more
    "2:1*4 2:0*2 1:0 1:-1*2 1:-2*2 0:-2 0:-3*2 0:-4 0:-5",  # small steps at full resolution
    "2:1*5 2:0*2 1:0 1:-1*2 1:-2*2 0:-2 0:-3*2 0:-4 0:-5",  # and a coarse step more
    "2:2 2:1*2 2:0*2 1:0 1:-1*2 1:-2*2 0:-2 0:-3*2 0:-4 0:-5",  # the same reach, a step less
    "2:2 2:1*2 2:0*2 1:0 1:-1*2 1:-2*2 1:-3 0:-3*2 0:-4 0:-5",  # in between
    "2:2 2:1*2 2:0*2 1:0 1:-1*2 1:-2*2 1:-3*2 1:-4 0:-4 0:-5",  # level 1 for longer
    "2:1*4 2:0*2 1:0 1:-1*2 1:-2*2 0:-2*2 0:-3*2 0:-4*2 0:-5",  # a longer fine tail
    "2:1*4 2:0*2 1:0 1:-1*2 1:-2 0:-1 0:-2 0:-3*2 0:-4 0:-5",  # full resolution earlier
    "2:1*4 2:0*2 2:-1*2 2:-2*2 0:-1 0:-2 0:-3*2 0:-4 0:-5",  # no level 1
    "1:1*4 1:0*3 1:-1*2 1:-2*2 0:-2 0:-3*2 0:-4 0:-5",  # no level 2
    "0:1*4 0:0*3 0:-1*2 0:-2*3 0:-3*2 0:-4 0:-5",  # full resolution only
    "2:1*4 2:0 1:0 1:-1 1:-2 0:-2 0:-3 0:-4 0:-5",  # short
    "2:1*5 2:0*3 1:0*2 1:-1*3 1:-2*2 0:-2*2 0:-3*2 0:-4*2 0:-5*2",  # long
)

#: Warm schedules to compare.
WARM_SCHEDULES = (
    MEASURED["warm"],
    "1:-1 1:-2 1:-3*2 0:-4",  # as many events, without strides
    BEFORE["warm"],
    "1:0 1:-1*2 1:-2 0:-2 0:-3 0:-4 0:-5",
    "1:0 1:-1 1:-2*2 1:-3 0:-3 0:-4 0:-5",
    "1:-1*3 1:-2 1:-3 0:-3 0:-4 0:-5",
    "1:0 1:-1 1:-2 1:-3 0:-4 0:-5",
    "1:0 1:-1*2 1:-2*2 1:-3*2 0:-3 0:-4 0:-5",
)

#: Fraction bits of dt, v, position, weight, derivative, dither.
WIDTHS = (
    (12, 12, 8, 8, 8, 4),
    (8, 8, 6, 6, 6, 4),
    (8, 6, 4, 4, 4, 4),
    (6, 5, 4, 4, 4, 3),
    (6, 5, 3, 3, 3, 3),
    (5, 5, 3, 2, 2, 2),
    (4, 5, 2, 2, 2, 2),
    (4, 5, 2, 1, 1, 1),
)
WIDTH_FIELDS = ("dt_frac", "v_frac", "position_frac", "weight_frac", "derivative_frac", "dither_frac")

WITHOUT_STRIDES = "schedules without strides"

#: η of the article's ascent to choose the best of.
PLAIN_ETAS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)

STUDIES = ("plain", "peaks", "edges", "schedules", "widths")


class _Report:
    """Prints tables, and keeps what ``--json`` writes."""

    def __init__(self):
        self.results = {}

    def progress(self, cases):
        return tqdm(cases, unit="batch", disable=None, leave=False)

    def keep(self, name, values, scores):
        values = np.asarray(values).astype(object)
        values[values != values] = None  # JSON has no NaN
        self.results[name] = {"scores": scores, "values": values.tolist()}
        return scores

    def table(self, title, heads, rows):
        """A Markdown table, so that it can go into a page as it is."""
        lines = [heads, *rows]
        widths = [max(len(line[column]) for line in lines) for column in range(len(heads))]
        rule = ["-" * width for width in widths]
        print(f"{title}\n")
        for line in (heads, rule, *rows):
            print("| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |")
        print()


def _percent(share):
    return f"{100 * share:.1f}"


ERROR_HEADS = ("batches", "< 0.3 px, %", "< 0.6 px, %", "median error, px", "largest error, px")
SHARE_HEADS = (
    "batches",
    "≥ 97 % of the best, %",
    "≥ 99 % of the best, %",
    "median share, %",
    "smallest share, %",
    "≥ 97 % of the article's best, %",
    "batches that drop events",
)


def _error_cells(scores):
    return (
        str(scores["batches"]),
        _percent(scores["below_0.3_px"]),
        _percent(scores["below_0.6_px"]),
        f"{scores['median_px']:.3f}",
        f"{scores['largest_px']:.2f}",
    )


def _share_cells(scores):
    names = ("at_least_97_percent", "at_least_99_percent", "median", "smallest", "articles_at_least_97_percent")
    dropping = str(scores["batches_that_drop_events"])
    return str(scores["batches"]), *(_percent(scores[name]) for name in names), dropping


BINS = (
    ("speed", "speed, px per half batch", ((0, 1), (1, 3), (3, 6), (6, 9), (1, 9))),
    ("roi_events", "n, events", ((200, 600), (600, 1200), (1200, 2001))),
    ("noise", "noise, share of n", ((0, 0.1), (0.1, 0.2), (0.2, 0.3))),
)


def _binned(cases, values):
    """Rows of errors by what the batches are made of."""
    groups = []
    for name, title, bins in BINS:
        facts = np.array([case.facts[name] for case in cases])
        for low, high in bins:
            last = high - 1 if name == "roi_events" else high  # whole numbers
            groups.append((f"{title}: {low} to {last}", (facts >= low) & (facts < high)))
    textures = np.array([case.facts["texture"] for case in cases])
    groups += [(f"texture: {texture}", textures == texture) for texture in SIZES]
    return [(title, *_error_cells(error_scores(values[chosen]))) for title, chosen in groups if chosen.any()]


# -------------------------------------------------------------------- command


def _parser():
    made = cli.parser("accuracy", "How well the motion is found: suites of batches, and studies.", EXAMPLES)
    made.add_argument(
        "--batches", type=cli.positive, default=BATCHES, metavar="N", help="synthetic batches of each seed (300)"
    )
    made.add_argument(
        "--seeds", type=_seeds, default=SEEDS, metavar="A-B", help="seeds of the synthetic batches, or one (1)"
    )
    made.add_argument(
        "--engine",
        default="model",
        choices=(*ENGINES, "all"),
        help="model: the hardware's arithmetic in integers; rtl: the emitted Verilog; float: nothing rounded "
        "(default: model)",
    )
    made.add_argument(
        "--data",
        default=os.environ.get("CMFPGA_DATA"),
        metavar="DIR",
        help="folder of the real recordings (default: $CMFPGA_DATA); without one those suites are left out",
    )
    made.add_argument(
        "--study",
        choices=STUDIES,
        help="instead of the suites: plain, the article's ascent; peaks, where the objective's own peak lies; "
        "edges, edges of other strengths; schedules; widths of words",
    )
    made.add_argument("--json", metavar="FILE", help="write all scores, and those of each batch")
    cli.add_config_options(made)
    return made


def _seeds(text):
    """``A-B`` or ``A``, for argparse."""
    first, dash, last = text.partition("-")
    if not (first.isdecimal() and (last.isdecimal() or not dash)) or int(last or first) < int(first):
        raise argparse.ArgumentTypeError(f"{text!r}: one seed, or the first and the last as in 1-3, is needed")
    return range(int(first), int(last or first) + 1)


def main(arguments=None):
    """Run the command; returns the exit status."""
    options = _parser().parse_args(arguments)
    config = cli.make_config(options)
    if (config.roi_width, config.roi_height) != (ROI, ROI):
        raise ConfigError(f"ROI of {config.roi_width}×{config.roi_height} px: the suites are for {ROI}×{ROI} px")
    if options.data is not None and not Path(options.data).is_dir():
        raise RecordingError(f"--data {options.data}: no such folder")
    if options.json:
        Path(options.json).touch()  # say that it cannot be written before the work, not after it
    report = _Report()
    if options.data is None:
        print("note: no folder of recordings (--data, $CMFPGA_DATA): synthetic batches only", file=sys.stderr)
    try:
        (_run_study if options.study else _run_suites)(options, config, report)
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise ConfigError(
            "torch is not installed, which all but --engine rtl need; pip install 'cmfpga[reference]'"
        ) from None
    if options.json:
        text = json.dumps({"config": config.to_dict(), "results": report.results}, indent=1)
        Path(options.json).write_text(text + "\n", encoding="utf-8")
        print(f"wrote {options.json}")
    return 0


def _engine(name, config):
    return closing(make_engine(name, config))


def _run_suites(options, config, report):
    names = ENGINES if options.engine == "all" else (options.engine,)
    cases = synthetic_cases(options.batches, seeds=options.seeds)
    runs = [(name, name, config) for name in names]
    if (config.ascent, config.cold, config.warm) == ("sign", AUTO, AUTO):
        runs.append((f"{names[0]}, {WITHOUT_STRIDES}", names[0], config.replace(**BEFORE)))
    rows, found = [], {}
    for what, name, chosen in runs:
        with _engine(name, chosen) as engine:
            for start, warm in (("cold", False), ("warm", True)):
                values = found[what, start] = errors(engine, cases, warm=warm, progress=report.progress)
                scores = report.keep(f"synthetic, {start}, {what}", values, error_scores(values))
                rows.append((what, start, *_error_cells(scores)))
    report.table("Synthetic batches: error of v, px per half batch", ("engine", "start", *ERROR_HEADS), rows)
    binned = _binned(cases, found[names[0], "cold"])
    report.table(f"The same by kind of batch (cold start, {names[0]})", ("batches with", *ERROR_HEADS), binned)
    if options.data is None:
        _compare_with_model(found)
        return
    real, rows = real_cases(options.data), []
    for what, name, chosen in runs:
        with _engine(name, chosen) as engine:
            values = found[what, "real"] = contrast_shares(engine, real, progress=report.progress)
        rows.append((what, *_share_cells(report.keep(f"real, {what}", values, share_scores(values)))))
    report.table("Real batches: contrast at the v found, cold start", ("engine", *SHARE_HEADS), rows)
    rows = []
    for what, bounds in TRACK_BOUNDS.items():
        bounds = ", ".join(f"{low:.0f} … {high:.0f}" for low, high in bounds).replace("-", "−")
        for run, name, chosen in runs:
            with _engine(name, track_config(chosen, what)) as engine:
                speeds = found[run, what] = track_checkerboard(engine, options.data)
            scores = report.keep(f"{what}, {run}", speeds, track_scores(speeds, what))
            spans = ("{:.1f} to {:.1f}".format(*scores[axis]) for axis in ("vx_px_per_s", "vy_px_per_s"))
            rows.append((what, run, str(scores["batches"]), bounds, str(scores["within_bounds"]), *spans))
    heads = ("", "engine", "batches", "bounds of vx, vy, px/s", "within", "vx, px/s", "vy, px/s")
    report.table("Checkerboard, tracked", heads, rows)
    _compare_with_model(found)


def brief(engine, *, data=None, batches=BATCHES):
    """The suites' scores for preset ``fast``, and a line of text on each: ``{"scores": …, "text": […]}``, JSON-ready.

    Parameters
    ----------
    engine : str
        Name of the engine.
    data : path or None
        Folder of the real recordings; None leaves them out.
    batches : int
        Of the synthetic suite, the first so many.
    """
    config = preset("fast")
    cases, scores, text = synthetic_cases(batches), {}, []
    with _engine(engine, config) as runner:
        for start, warm in (("cold", False), ("warm", True)):
            found = scores[f"synthetic, {start}"] = error_scores(errors(runner, cases, warm=warm))
            shares = (_percent(found[f"below_{limit}_px"]) for limit in ("0.6", "0.3"))
            text.append(
                "preset fast, {}, {} synthetic batches, {}: {} % within 0.6 px, {} % within 0.3 px".format(
                    engine, found["batches"], start, *shares
                )
            )
    if data is not None:
        real = real_cases(data)
        with _engine(engine, config) as runner:
            found = scores["real, cold"] = share_scores(contrast_shares(runner, real))
        shares = (_percent(found[f"at_least_{least}_percent"]) for least in (97, 99))
        text.append(
            "preset fast, {}, {} real batches, cold: {} % reach 97 % of the best contrast, {} % reach 99 %; "
            "{} drop events".format(engine, found["batches"], *shares, found["batches_that_drop_events"])
        )
    return {"scores": scores, "text": text}


def _compare_with_model(found):
    """Say whether Verilog and model, which must not differ, did the same."""
    for (name, suite), values in found.items():
        model = found.get(("model", suite))
        if name == "rtl" and model is not None:
            same = np.all(np.asarray(values) == model, axis=tuple(range(1, np.ndim(values))))
            print(f"{suite}: rtl and model agree exactly in {same.sum()} of {len(same)} batches")


def _run_study(options, config, report):
    cases = synthetic_cases(options.batches, seeds=options.seeds)
    real = real_cases(options.data) if options.data else []
    engine = "model" if options.engine == "all" else options.engine
    {
        "plain": _study_plain,
        "peaks": _study_peaks,
        "edges": _study_edges,
        "schedules": _study_schedules,
        "widths": _study_widths,
    }[options.study](config, engine, cases, real, report)


def _row(report, name, engine, config, cases, real):
    """Cells of both suites for one configuration."""
    with _engine(engine, config) as runner:
        values = errors(runner, cases, progress=report.progress)
        cells = _error_cells(report.keep(f"synthetic, {name}", values, error_scores(values)))[1:4]
        if not real:
            return cells
        values = contrast_shares(runner, real, progress=report.progress)
    return *cells, *_share_cells(report.keep(f"real, {name}", values, share_scores(values)))[1:3]


def _row_heads(real):
    return (*ERROR_HEADS[1:4], *(SHARE_HEADS[1:3] if real else ()))


def _study_plain(config, engine, cases, real, report):
    plain = preset("paper").replace(buffer_events=config.buffer_events)
    rows = [
        (f"{eta:g}", *_row(report, f"eta {eta:g}", "float", plain.replace(eta=eta), cases, real)) for eta in PLAIN_ETAS
    ]
    title = f"The article's ascent in float64: constant η, T = {plain.iterations}, from v = 0"
    report.table(title, ("η, (px/half batch)² per (events/px)²", *_row_heads(real)), rows)


def _study_peaks(config, engine, cases, real, report):
    values = np.array([peak_error(case) for case in report.progress(cases)])
    row = ("synthetic", *_error_cells(report.keep("peaks", values, error_scores(values))))
    report.table("Distance of the dithered objective's peak (float64) from the truth", ("suite", *ERROR_HEADS), [row])


def _study_edges(config, engine, cases, real, report):
    rows = []
    for strength in (0.0, 1.0, 2.0, EVENTS_PER_EDGE, 8.0):
        cases = [_synthetic_case(case.facts["seed"], case.facts["index"], strength) for case in cases]
        slow = [case.facts["speed"] < 1 for case in cases]
        with _engine(engine, config) as runner:
            values = errors(runner, cases, progress=report.progress)
        report.keep(f"events per edge {strength:g}", values, error_scores(values))
        peaks = np.array([peak_error(case) for case in report.progress(cases)])
        name = f"{strength:g}" if strength else "1 threshold per px"
        for which, chosen in (("all", np.ones(len(cases), bool)), ("below 1", np.array(slow))):
            if chosen.any():
                cells = _error_cells(error_scores(values[chosen]))[:4]
                rows.append((name, which, *cells, *_error_cells(error_scores(peaks[chosen]))[1:3]))
    heads = ("events per edge", "speed, px per half batch", *ERROR_HEADS[:4], "peak < 0.3 px, %", "peak < 0.6 px, %")
    report.table("Edges of other strengths, cold start", heads, rows)


def _study_schedules(config, engine, cases, real, report):
    if config.ascent != "sign":
        raise ConfigError(f"ascent = {config.ascent!r}: schedules belong to ascent = sign")
    entries = max(config.schedule_entries, 64)
    rows = []
    for cold in SCHEDULES:
        changed = config.replace(cold=cold, schedule_entries=entries)
        cells = _row(report, f"cold {cold}", engine, changed, cases, real)
        rows.append((f"`{cold}`", *_lengths(changed.cold_schedule), *cells))
    title = f"Cold schedules, entries LEVEL:LOG2STEP/STRIDE*COUNT ({engine} engine)"
    report.table(title, ("schedule", "T", "Σ n_k", *_row_heads(real)), rows)
    rows = []
    for warm in WARM_SCHEDULES:
        changed = config.replace(warm=warm, schedule_entries=entries)
        with _engine(engine, changed) as runner:
            values = errors(runner, cases, warm=True, progress=report.progress)
        cells = _error_cells(report.keep(f"warm {warm}", values, error_scores(values)))[1:4]
        rows.append((f"`{warm}`", *_lengths(changed.warm_schedule), *cells))
    title = f"Warm schedules, from up to {WARM_RADIUS:g} px off ({engine} engine)"
    report.table(title, ("schedule", "T", "Σ n_k", *_row_heads([])), rows)


def _lengths(schedule):
    """Iterations of a schedule, and the events that they use, where there are enough of them for its strides."""
    return str(len(schedule)), f"{sum(1 / entry.stride for entry in schedule):g}·n"


def _study_widths(config, engine, cases, real, report):
    rows = []
    for widths in WIDTHS:
        changed = config.replace(**dict(zip(WIDTH_FIELDS, widths, strict=True)))
        name = ", ".join(map(str, widths))
        rows.append((name, *_row(report, f"widths {name}", engine, changed, cases, real)))
    heads = ("fraction bits: dt, v, position, weight, derivative, dither", *_row_heads(real))
    report.table(f"Word widths ({engine} engine)", heads, rows)
