"""Batches for the core under test: of any kind, or just good ones; and configurations that are small enough."""

import functools

import numpy as np

from cmfpga.config import Config, preset
from cmfpga.config.schedule import parse_schedule
from cmfpga.protocol.settings import BatchSettings
from cmfpga.rtl.core import Core
from support.bench import Repeated
from support.configs import NARROW, TINY
from support.core import Batch, check_core, drive_core
from support.values import edge_integers

SMALL = {"sensor_width": 40, "sensor_height": 30, "roi_width": 16, "roi_height": 12}
LIMITS = {"buffer_events": 48, "max_batch_events": 90, "max_iterations": 7}
ROUNDS = {"cold": "2:3:4 1:3/2:2 0:3/4:3/4", "warm": "1:1:3/2 1:3/4:1 0:3/4:1/16"}
#: Of motions beyond translation.
STEPS = {"cold": "2:1 1:0 0:-1 0:-3", "warm": "1:0 1:-1 0:-2 0:-4"}
CONFIGS = {
    "small": Config(**SMALL, **LIMITS, iterations=3),
    # P a power of two: the gradient costs no multiplication.
    "power": Config(**SMALL | {"roi_height": 8}, **LIMITS, iterations=3),
    "narrow": Config(**NARROW | SMALL | LIMITS, iterations=3),
    # A sweep of one cycle: the next replay begins before the sweep's end would allow it elsewhere.
    "tiny": Config(**TINY | LIMITS, iterations=3),
    # A division and time stamps as short as can be; v saturates soon.
    "short": Config(**SMALL, **LIMITS, iterations=3, time_bits=8, span_bits=4, reciprocal_bits=4, dt_frac=4, v_int=1),
    # The ROI is the sensor, and the buffer holds one event.
    "still": Config(**SMALL | {"sensor_width": 16, "sensor_height": 12}, **LIMITS | {"buffer_events": 1}, iterations=3),
    # Two event buffers, of a depth that is no power of two; the next batch is taken in while one is optimised.
    "two": Config(**SMALL, **LIMITS | {"buffer_events": 37}, buffers=2, iterations=3),
    "two tiny": Config(**TINY | LIMITS | {"buffer_events": 1}, buffers=2, iterations=3),
    "one pass": Config(**SMALL, **LIMITS, gradient="one_pass", iterations=3),
    "two, one pass": Config(**SMALL | {"roi_width": 15}, **LIMITS, gradient="one_pass", buffers=2, iterations=3),
    # The default preset: rounds, levels, dither, two buffers; so few tags that they come back soon.
    "fast": preset("fast").replace(**SMALL, **LIMITS, **ROUNDS, tag_bits=4),
    "four evaluators": preset("fast").replace(
        **SMALL | {"roi_height": 8}, **LIMITS, **ROUNDS, tag_bits=3, evaluators=4
    ),
    # Votes and derivatives of different fractions, one buffer, a P that is no power of two.
    "one evaluator": preset("fast").replace(
        **SMALL | {"roi_width": 15}, **LIMITS | {"buffer_events": 37}, **ROUNDS, tag_bits=4, buffers=1, weight_frac=3,
        derivative_frac=6,
    ),
    # So short a solver that the verdict is waited for.
    "three bits of v": preset("fast").replace(
        **SMALL | {"roi_height": 8}, **LIMITS, tag_bits=4, evaluators=4, v_frac=3, v_int=3, dt_frac=4,
        dither_frac=3, buffers=1, cold="2:3:4 1:3/2:2 0:3/4:3/4", warm="1:1:3/2 0:3/4:1/4",
    ),
    "rounds, no confidence": preset("fast").replace(
        **SMALL, **LIMITS, **ROUNDS, tag_bits=4, confidence=0, evaluators=4
    ),
    # Motions beyond translation: a lever arm of 8 px, which a fast zoom or roll leaves.
    "similarity": preset("similarity").replace(**SMALL | {"roi_width": 20}, **LIMITS, **STEPS, tag_bits=4),
    # An ROI smaller than the sensor, one buffer; a camera without distortion, whose table is that of a reset.
    "rotation": preset("rotation").replace(
        **SMALL | {"roi_height": 13}, **LIMITS | {"buffer_events": 37}, **STEPS, buffers=1, tag_bits=4,
        ram_style="auto", max_level=2, camera="36,35,18.3,16.8",
    ),
    # Images whose last column and row are made of fewer pixels; an undistorted one.
    "binned": preset("fast").replace(
        **SMALL | {"sensor_width": 75, "sensor_height": 53}, **LIMITS, **ROUNDS, tag_bits=4, binning=1
    ),
    "binned rotation": preset("rotation").replace(
        **SMALL | {"sensor_width": 157, "sensor_height": 117, "roi_height": 13}, **LIMITS | {"buffer_events": 37},
        **STEPS, buffers=1, tag_bits=4, ram_style="auto", max_level=2, camera="144,140,74.7,68.7", binning=2,
    ),
    # A full buffer thins out; of a depth that is odd and no power of two.
    "thin": Config(**SMALL, **LIMITS | {"buffer_events": 7}, when_full="thin", iterations=3),
    "two, thin": Config(**SMALL, **LIMITS | {"buffer_events": 20}, when_full="thin", buffers=2, iterations=3),
}  # fmt: skip

FLOWS = {"free": {}, "gaps": {"gap": 0.4}, "stalls": {"stall": 0.8}, "both": {"gap": 0.4, "stall": 0.8}}


def moving_points(config, rng, count, *, bad_times=0.0, span=None, around=None):
    """Events of a few points that move across the sensor, and noise; times anywhere on the camera's counter."""
    wrap = 1 << config.time_bits
    longest = min(1 << config.span_bits, wrap // 2) - 1
    span = int(rng.integers(1, longest + 1)) if span is None else span
    t = np.sort(rng.integers(0, span + 1, count))
    t[0], t[-1] = 0, span
    phase = t / max(1, span) - 0.5
    center = (config.sensor_width // 2, config.sensor_height // 2) if around is None else around
    limits = config.sensor_width, config.sensor_height
    v = rng.uniform(-4, 4, 2)
    columns = []
    for axis, limit in enumerate(limits):
        offsets = rng.integers(-4 * config.pixel, 4 * config.pixel + 1, 3)
        points = center[axis] + offsets[rng.integers(0, 3, count)] + phase * v[axis] * config.pixel
        anywhere = rng.integers(0, limit, count)
        column = np.where(rng.random(count) < 0.3, anywhere, np.round(points))
        columns.append(np.clip(column, 0, limit - 1).astype(int).tolist())
    wrong = rng.random(count) < bad_times
    wrong[0] = False
    t = np.where(wrong, t + rng.integers(-longest, 2 * longest, count), t) + rng.integers(wrap)
    return list(zip((t % wrap).tolist(), *columns, strict=True))


def plans(motion, *texts):
    v = CONFIGS["fast"].formats.v
    return tuple(parse_schedule(text, name="plan", max_level=2, v=v, entries=4, motion=motion) for text in texts)


#: Schedules of random batches: all distances, the largest and the smallest limit.
PLANS = plans(
    "translation", "0:3/4:1/16", "2:3:16 0:2:1/64", "1:1:1*2 0:3/2:3/2", "2:2:4 1:3/2:2 0:1:3/4 0:3/4:1/16",
    "1:3/4:3/32*2",
)  # fmt: skip
#: The same of steps, some of them part of another; steps so large that v saturates, and v's unit.
SIGN_PLANS = plans("similarity", "0:-2", "2:2/4 0:-6", "1:0*2 0:4/2", "2:1 1:-1/2 0:-3/4 0:-5", "0:-3 0:-5", "1:4*2")


def settings(config, **changes):
    """The configuration's settings, some of them changed; ``iterations`` is also the length of schedules."""
    chosen = vars(BatchSettings.from_config(config))
    if "iterations" in changes:
        chosen |= {name: chosen[name][: changes["iterations"]] for name in ("cold", "warm")}
    return BatchSettings(**chosen | changes)


def random_batch(config, rng, *, bad_times=0.15):
    """Any size, any settings, any way to end but "roi", which needs to know where the ROI is."""
    end = str(rng.choice(["last", "last", "count", "cut"]))
    count = config.max_batch_events if end == "cut" else int(rng.choice([1, 2, 3, 8, 20, 40, 60, 85]))
    roi = None
    if rng.random() < 0.6:
        roi = int(rng.integers(config.geometry.width)), int(rng.integers(config.geometry.height))
        if rng.random() < 0.7:
            roi = min(roi[0], config.geometry.roi_x_max), min(roi[1], config.geometry.roi_y_max)
    eta = int(rng.choice([0, 1, config.formats.eta.raw(1.0), config.formats.eta.raw(8.0), config.formats.eta.max]))
    slow = 3 << config.v_frac
    size = config.roi_width, config.roi_height
    around = tuple((c + s // 2) * config.pixel for c, s in zip(roi, size, strict=True)) if roi else None
    span = 0 if rng.random() < 0.1 else None
    plans = {}
    if config.ascent_rule.has_table:
        known = PLANS if config.ascent == "newton" else SIGN_PLANS
        if config.formats.v != CONFIGS["fast"].formats.v:  # which has those limits
            known = [config.schedules.cold, config.schedules.warm]
        plans = {name: ((), *known)[int(rng.integers(len(known) + 1))] for name in ("cold", "warm")}
    return Batch(
        events=moving_points(config, rng, count, bad_times=bad_times, span=span, around=around),
        settings=settings(
            config,
            roi=roi,
            iterations=int(rng.choice([0, 1, 2, 3, 4])),
            eta=eta,
            roi_gain=int(edge_integers(rng, 0, config.formats.roi_gain.max, 1)[0]),
            start_last=bool(rng.integers(2)),
            v_start=tuple(
                int(edge_integers(rng, max(parameter.fmt.min, -slow), min(parameter.fmt.max, slow), 1)[0])
                for parameter in config.motion_model.parameters
            ),
            min_roi_events=int(rng.choice([0, 1, min(2, config.buffer_events), config.buffer_events])),
            thinning=int(rng.choice([1, 1, 1, 2, 3, 7, 255])),
            judge=int(rng.integers(5) > 0),
            cold_after_doubtful=int(rng.integers(3) > 0),
            confidence_limit=int(rng.choice([1, 5, 90, 1023])),
            thin_target=min(config.buffer_events, int(rng.choice([0, 0, 0, 1, 5, 20, 48]))),
            **plans,
        ),
        end=end,
    )


@functools.cache
def core_of(config):
    """The core, elaborated: several seconds' work for thousands of cycles."""
    return Repeated(Core(config))


def run(config, batches, rng, *, gap=0.0, stall=0.0, eager=True, free=True, core=None):
    """Simulate from reset and compare; returns (the model's results, outcomes).

    Not ``free``: acceptance waits until it is known what was stored, and no formula holds. A ``core`` of its own may be
    broken: its first results are compared as soon as they are there.
    """
    compared = set()

    def compare(ctx, cycle):
        done = sum(outcome.result is not None for outcome in outcomes)
        if done in (1, 2, 4) and done not in compared:
            compared.add(done)
            check_core(config, batches[:done], outcomes[:done])

    flow = {"gap": gap, "stall": stall, "eager": eager, "before_tick": compare if core else None}
    core = core or core_of(config)
    bench, outcomes = drive_core(core.top, batches, rng=rng, **flow)
    core.simulate(bench)
    # With two buffers the cycles of a batch depend on the one before, if it is offered while that is under way.
    alone = config.buffers == 1 or not eager
    return check_core(config, batches, outcomes, free=free and not gap and alone), outcomes


CENTER = (20, 15)


def centered(config, times, **changes):
    roi = CENTER[0] - config.roi_width // 2, CENTER[1] - config.roi_height // 2
    x, y = (at * config.pixel for at in CENTER)
    return Batch(events=[(t, x, y) for t in times], settings=settings(config, **{"roi": roi} | changes))


def spread(config, rng, count=20, **changes):
    batch = centered(config, range(100, 100 + 10 * count, 10), **changes)
    offsets = rng.integers(-4 * config.pixel, 4 * config.pixel + 1, (count, 2)).tolist()
    return Batch(events=[(t, x + dx, y + dy) for (t, x, y), (dx, dy) in zip(batch.events, offsets, strict=True)],
                 settings=batch.settings)  # fmt: skip
