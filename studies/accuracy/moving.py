"""Scenes in which v changes: the newest published v and the ROI against the truth, by sliding windows and by batches.

A result is published when it would be there: at the time of the event that ends it, and the cycles after that, at
:data:`CLOCK_MHZ`. Each window has as many events as the object emits on :data:`WAY` px; so has each batch. No motion,
0 px/s, is what a degenerate window or batch says.
"""

import dataclasses
import math
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cmfpga.engines import batches_of, make_engine
from cmfpga.events import BatchCutter, MemoryRecording, generate
from cmfpga.imaging.iwe import events_in_roi
from cmfpga.protocol.confidence import confidence, is_sure
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.settings import BatchSettings
from cmfpga.reference.global_search import search, translation
from cmfpga.reference.integer.sliding import Sliding
from cmfpga.rtl.core import Core
from cmfpga.rtl.sliding.core import SlidingCore
from cmfpga.tracking.loop import track

from .judged import judgement
from .known import by_file, read
from .table import decimal, percent
from .yardstick import ROI

CLOCK_MHZ = 100.0
WAY = 6.0  # px that the object moves in a window
SLICES = 16  # hops in a window's length
HOP_US, FEWEST_US, LONGER = 4000, 60_000, 1.75  # longest hop; window_us, and the same in usual ranges of a window
FEWEST = 4  # a window has so many times fewer events at least
FIRST_US, STEP_US = 150_000, 500  # from where on, and how densely, v is compared with the truth
PIECE_US = 2000

#: Rounds of a hop: those that follow the writes and give v, and the one after the result that judges.
PLANS = {
    "a search, then a judging round": ("1:3/4:1", "0:3/4:1/16"),
    "a search": ("1:3/4:1", ""),
    "a judging round": ("0:3/4:1/16", ""),
    "a judging round that moves v": ("0:3/4:1", ""),
}
BUILT = "a search, then a judging round"


@dataclass(frozen=True)
class Moving:
    """A scene: velocity in px/s at a time in s, its length in s, where the object starts, and the largest rms, px/s."""

    name: str
    velocity: object
    seconds: float
    bar: float
    start: tuple = (119.5, 89.5)

    def made(self, seed):
        """The :class:`~cmfpga.events.Synthetic` recording."""
        pieces = [(PIECE_US, *self.velocity((k + 0.5) * PIECE_US * 1e-6)) for k in range(self.pieces)]
        return generate(
            seed=seed, texture="lines", size=(40, 40), contrast=0.4, noise=0.1, position=self.start, velocity=pieces,
            duration_us=PIECE_US * self.pieces,
        )  # fmt: skip

    @property
    def pieces(self):
        return round(self.seconds * 1e6 / PIECE_US)


def _angle(s):
    return 2 * math.pi * s / 0.8


SCENES = (
    Moving("constant", lambda s: (120, 0), 0.8, 6, (70, 89.5)),
    Moving("sinusoid", lambda s: (150 * math.sin(_angle(s) + 0.3), 40 * math.cos(_angle(s) + 0.3)), 1.2, 42),
    Moving("fast sinusoid", lambda s: (300 * math.sin(2 * math.pi * s / 0.3 + 0.8), 0), 0.9, 135),
    Moving("circle", lambda s: (150 * math.cos(_angle(s)), 150 * math.sin(_angle(s))), 1.2, 30, (120, 70)),
    Moving("corner", lambda s: (120, 0) if s < 0.4 else (0, 120), 0.8, 38, (90, 60)),
    Moving("reversal", lambda s: (150 if s < 0.4 else -150, 0), 0.8, 56, (80, 90)),
    Moving("ramp", lambda s: (40 + 500 * s, 0), 0.6, 16, (60, 90)),
    Moving("stop and go", lambda s: (0 if 0.3 <= s < 0.6 else 120, 0), 0.9, 48, (60, 90)),
)
#: Where the ROI is after a long way counts.
LONG = dataclasses.replace(SCENES[1], name="sinusoid, 6 s", seconds=6.0)

REAL, REAL_ROI, REAL_EVENTS, REAL_BAR = "davis240c_shapes_rotation_0.0s.h5", (100, 30), 1000, 40.0
REAL_FROM_TO, REAL_WINDOW = (550_000, 1_430_000), 3000  # µs, events

#: Of recordings of known motion: every so many of the ROIs, how long each, and the fewest events that make a window.
KNOWN_ROIS, KNOWN_US, KNOWN_FEWEST = slice(4, None, 9), 1_500_000, 100


@dataclass(frozen=True, eq=False)
class Course:
    """What was published: times in µs, v in px/s, corners of the ROI in px; and of each window its error and trust.

    ``judged`` has the columns of :func:`~.judged.judge`: error in px per half window, κ, trusted.
    """

    t: np.ndarray
    v: np.ndarray
    corner: np.ndarray
    judged: np.ndarray

    def newest(self, times, values, first):
        """Of ``values`` that are published with the results; ``first`` before them."""
        return np.vstack([first, values])[np.searchsorted(self.t, times, side="right")]

    def rms(self, times, truth):
        """Of the newest v, px/s; before the first result v is 0."""
        return float(np.sqrt(np.mean(np.sum((self.newest(times, self.v, (0.0, 0.0)) - truth) ** 2, axis=1))))


def windows_of(config, count, span_us, plan):
    """``config`` with windows of ``count`` events, which usually take ``span_us``."""
    follow, after = PLANS[plan]
    longest = max(FEWEST_US, round(LONGER * span_us))
    return config.replace(
        windows="sliding", window_events=count, window_us=longest, hop_events=max(1, round(count / SLICES)),
        hop_us=HOP_US, follow=follow, after=after, min_roi_events=max(1, count // FEWEST),
    )  # fmt: skip


def slide(config, events, roi, truth):
    """The :class:`Course` of windows that slide; ``truth(first, last)``: mean (vx, vy) between two times."""
    settings, core = BatchSettings.from_config(config, roi=roi), SlidingCore(config)
    found, free = [], 0.0
    for hop in Sliding(config, settings).run(events.t, events.x, events.y):
        alone = core.cycles(roi_events=hop.roi_events, iterations=max(1, hop.iterations))
        # The first round may have begun long before the last event; then only the tail is left.
        if hop.iterations > len(settings.follow):
            ready = hop.t_us + alone / CLOCK_MHZ
        else:
            ready = max(hop.t_us + core.tail / CLOCK_MHZ, free + alone / CLOCK_MHZ)
        judges = len(settings.after) * core.cycles(roi_events=hop.roi_events, iterations=1) * bool(hop.iterations)
        free = ready + judges / CLOCK_MHZ
        found.append((ready, hop, hop.roi_next, (hop.t_first, hop.t_us)))
    return _course(config, found, truth)


def batches(config, events, roi, count, truth):
    """The :class:`Course` of batches of ``count`` ROI events, as ``track`` follows the object."""
    found, core = [], Core(config)
    recording = MemoryRecording(events, config.sensor_width, config.sensor_height, "events")
    cutter = BatchCutter(recording, roi_events=count, max_events=config.max_batch_events)
    with closing(make_engine("model", config)) as engine:
        for batch in track(engine, cutter, roi=roi):
            last = int(batch.events.t[-1])
            ready = last + core.iterated_cycles(batch.result.roi_events, batch.result.iterations) / CLOCK_MHZ
            found.append((ready, batch.result, batch.roi_next, (int(batch.events.t[0]), last)))
    return _course(config, found, truth)


def _course(config, found, truth):
    """The :class:`Course` of ``found``, ``[(when, result, next ROI, times of the first and last event)]``, µs."""
    rows, judged = [], []
    for ready, result, corner, times in found:
        v, half_s = (0.0, 0.0), result.span / 2e6
        if Flag.DEGENERATE not in result.flags:
            v, kappa = np.divide(result.v, half_s), confidence(config, result)
            off = math.dist(result.v, np.multiply(truth(*times), half_s))
            judged.append((off, -math.inf if kappa is None else kappa, is_sure(result)))
        rows.append((ready, *v, *corner))
    table = np.array(rows, float).reshape(-1, 5)
    return Course(table[:, 0], table[:, 1:3], table[:, 3:], np.array(judged, float).reshape(-1, 3))


def courses(config, plans, events, roi, count, span_us, truth):
    """``{who: Course}``: batches of ``count`` events, and windows by each plan, which usually take ``span_us``."""
    found = {"batches": batches(batches_of(config), events, roi, count, truth)}
    return found | {plan: slide(windows_of(config, count, span_us, plan), events, roi, truth) for plan in plans}


def usual(made):
    """How many events of the ROI around the object a window has, and how long it takes, µs."""
    t, motion = made.events.t, made.motion
    off = np.stack([made.events.x, made.events.y], 1) - motion.position(t)
    inside = int((np.abs(off) < ROI / 2).all(axis=1).sum())
    speeds = np.hypot(*motion.velocities.T)
    way, moving = float(speeds.sum()) * PIECE_US * 1e-6, float(np.count_nonzero(speeds)) * PIECE_US
    return max(1, round(inside * WAY / way)), moving * WAY / way


def follow_scene(scene, seed, config, plans):
    """``{who: (rms, ROI off at the end, farthest off, judged)}`` of a scene: batches, and windows by each plan."""
    made = scene.made(seed)
    count, span_us = usual(made)
    count = min(count, config.buffer_events)
    end = PIECE_US * scene.pieces
    times = np.arange(FIRST_US, end, STEP_US)
    roi, found = made.roi_start(ROI, ROI), {}
    for who, course in courses(config, plans, made.events, roi, count, span_us, made.motion.mean_velocity).items():
        corner = course.newest(times, course.corner, roi)
        off = np.hypot(*(corner + (ROI - 1) / 2 - made.motion.position(times)).T)
        found[who] = course.rms(times, made.motion.velocity(times)), float(off[-1]), float(off.max()), course.judged
    return found


def follow_real(folder, config, plans):
    """``{who: (rms, …)}`` of the real recording, against a search over the whole sensor; as :func:`follow_scene`."""
    events, _ = read(Path(folder) / REAL)
    begin, end = (int(events.t[0]) + at for at in REAL_FROM_TO)
    events = events[: int(np.searchsorted(events.t, end + 2 * FEWEST_US))]
    parts = [events[at : at + REAL_WINDOW] for at in range(0, len(events) - REAL_WINDOW + 1, REAL_WINDOW)]
    speeds = np.array([search(translation(part.x, part.y), part.t).at_middle for part in parts])
    middles = np.array([(int(part.t[0]) + int(part.t[-1])) / 2 for part in parts])

    def velocity(times):
        return np.stack([np.interp(times, middles, axis) for axis in speeds.T], 1)

    def mean(first, last):
        return velocity(np.linspace(first, last, 32)).mean(0)

    times = np.arange(begin, end, STEP_US)
    found = courses(config, plans, events, REAL_ROI, REAL_EVENTS, 2 * FEWEST_US / 3, mean)
    return {who: (course.rms(times, velocity(times)), None, None, course.judged) for who, course in found.items()}


def follow_known(known, config, plans):
    """``{who: judged}`` of a real recording of known motion; of windows every fourth, for they overlap."""
    config = config.replace(sensor_width=known.sensor[0], sensor_height=known.sensor[1])
    begin = int(known.events.t[0])
    events = known.events[: int(np.searchsorted(known.events.t, begin + KNOWN_US))]
    found = {who: [] for who in ("batches", *plans)}
    for roi in known.rois[KNOWN_ROIS]:
        middle = [np.array([axis + ROI / 2]) for axis in roi]

        def truth(first, last, middle=middle):
            return np.ravel(known.truth(first, last, *middle))

        span_us = WAY / np.hypot(*truth(begin, begin + FEWEST_US)) * 1e6
        ahead = events[: int(np.searchsorted(events.t, begin + span_us))]
        count = len(events_in_roi(ahead, roi, ROI, ROI)[0])
        if count >= KNOWN_FEWEST:
            count = min(count, config.buffer_events)
            for who, course in courses(config, plans, events, roi, count, span_us, truth).items():
                found[who].append(course.judged[:: 1 if who == "batches" else 4])
    return {who: np.concatenate(parts) for who, parts in found.items()}


HEADS = ("scene", "by", "rms of v, px/s", "of each seed", "at most", "ROI off at the end, px", "at most, px",
         "trusted, %", "of them wrong, %", "AUC")  # fmt: skip


def run_moving(options, config, report):
    """Print the table of all scenes; with a folder of recordings, of the real one, too."""
    plans, rows = [*PLANS] if options.moving == "plans" else [BUILT], []
    for scene in report.progress([*SCENES, LONG], "scene"):
        found = [follow_scene(scene, seed, config, plans) for seed in options.seeds]
        rows += [_row(report, scene.name, who, [one[who] for one in found], scene.bar) for who in found[0]]
    if options.data is not None:
        found = follow_real(options.data, config, plans)
        rows += [_row(report, "shapes_rotation", who, [one], REAL_BAR) for who, one in found.items()]
        known = [follow_known(one, config, plans) for one in by_file(options.data).values() if one.in_sum]
        for who in known[0]:
            judged = np.concatenate([one[who] for one in known])
            rows.append(_row(report, "known motion", who, [(math.nan, None, None, judged)], None))
    title = f"Moving scenes: newest v against the truth every {STEP_US / 1000:g} ms, results after their cycles at"
    report.table(f"{title} {CLOCK_MHZ:g} MHz", HEADS, rows)


def _row(report, name, who, found, bar):
    rms, ends, farthest, judged = zip(*found, strict=True)
    told = judgement(np.concatenate(judged))
    scores = {"rms_px_per_s": float(np.sqrt(np.mean(np.square(rms)))), "at_most_px_per_s": bar}
    scores |= {key: told[key] for key in ("results", "trusted", "wrong_of_trusted", "auc")}
    scores = report.keep(f"moving, {name}, {who}", np.array([rms, ends, farthest]).T.astype(float), scores)
    off = ("–" if None in values else decimal(max(values), 1) for values in (ends, farthest))
    rms, *each = (decimal(one, 1) for one in (scores["rms_px_per_s"], *rms))
    shares = (percent(scores[key]) for key in ("trusted", "wrong_of_trusted"))
    bar = "–" if bar is None else f"{bar:g}"
    return name, who, rms, ", ".join(each), bar, *off, *shares, decimal(scores["auc"], 3)
