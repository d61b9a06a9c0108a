"""Hardware with a table of regions: small configurations, random tables and batches, and how they are played."""

import dataclasses

import numpy as np

from cmfpga.config import preset
from cmfpga.engines.rtl import flat, nested
from cmfpga.protocol.regions import row_shape, tables
from cmfpga.protocol.settings import settings_values
from cmfpga.protocol.shapes import leaves
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.reference.regions import RegionSequence
from cmfpga.rtl.payloads import schedule_entry
from cmfpga.rtl.regions import payloads
from cmfpga.rtl.regions.regions import Regions
from support.bench import simulate
from support.core_batches import PLANS, ROUNDS, SIGN_PLANS, moving_points, settings

_SMALL = preset("fast").replace(
    sensor_width=40, sensor_height=30, roi_width=16, roi_height=12, buffer_events=37, max_batch_events=150,
    max_iterations=7, tag_bits=3, **ROUNDS, regions=9, units=2, bin_bits=2,
)  # fmt: skip

CONFIGS = {
    "two units": _SMALL,
    "one unit": _SMALL.replace(units=1, confidence=0, when_full="drop"),
    # More units than regions; bins as large as the sensor; a camera, a hot pixel's mask and the background's filter.
    "five units, front": _SMALL.replace(
        units=5, regions=4, bin_bits=6, undistortion="on", hot_pixels=1, background=1,
        camera="36,35,18.3,16.8,-0.3,0.1,0,0,0",
        hot_mask="20,15;3,4", background_us=1 << 22,
    ),
    # The same in front of an image of wider pixels.
    "binned": _SMALL.replace(
        sensor_width=157, sensor_height=117, binning=2, undistortion="on", hot_pixels=1, background=1,
        camera="144,140,74.7,68.7,-0.3,0.1,0,0,0", hot_mask="81,62;82,62;13,17", background_us=1 << 22,
    ),
    "overlapping windows": _SMALL.replace(slices=3, units=3, hot_pixels=1),
    "similarity": _SMALL.replace(
        motion="similarity", ascent="sign", tag_bits=4, cold="2:1 1:0 0:-1 0:-3", warm="1:0 1:-1 0:-2 0:-4"
    ),
    "four evaluators": _SMALL.replace(evaluators=4, undistortion="on"),
}  # fmt: skip


def _plans(config):
    """Schedules that the configuration may have."""
    if config.ascent == "newton":
        return PLANS
    return [plan for plan in SIGN_PLANS if not config.confidence or plan[-1].stride == 1]


def random_window(config, rng, kind="any"):
    """Events ``(t, x, y)``: of a few points that move and of noise, some with wrong times; or all in one bin."""
    count = int(rng.choice([1, 2, 30, 100, config.slice_events]))
    count = min(count, config.slice_events)
    events = np.array(moving_points(config, rng, count, bad_times=0.1), np.int64).T
    if kind == "one bin":
        events[1:] = events[1:] % 4
    return tuple(events)


def random_settings(config, rng):
    plans = _plans(config)
    cold, warm = (plans[int(rng.integers(len(plans)))] for _ in range(2))
    chosen = settings(
        config, min_roi_events=int(rng.integers(1, 4)), roi_gain=int(rng.integers(1 << 6)), cold=cold, warm=warm
    )
    if config.confidence:
        chosen = dataclasses.replace(
            chosen, judge=int(rng.random() < 0.8), confidence_limit=int(rng.choice([1, 20, 90, 1000])),
            cold_after_doubtful=int(rng.integers(2)),
        )  # fmt: skip
    if config.motion_model.basis:
        chosen = dataclasses.replace(chosen, v_start=random_start(config, rng))
    return chosen


def random_start(config, rng):
    """Raw, of every parameter, half of them anywhere in a quarter of its range."""
    limits = [parameter.fmt for parameter in config.motion_model.parameters]
    return tuple(int(rng.integers(fmt.min, fmt.max + 1) * rng.integers(2)) // 4 for fmt in limits)


def random_run(config, rng, regions):
    """A few windows, and how they are played: ``(windows, gaps or None, stalls or None)``."""
    count = int(rng.integers(1, 4))
    windows = [random_window(config, rng, rng.choice(["any", "one bin"])) for _ in range(count)]
    gaps = rng.integers(0, 3, sum(len(t) for t, _, _ in windows)) if rng.random() < 0.5 else None
    stalls = rng.integers(0, 100, len(regions) * count).tolist() if rng.random() < 0.5 else None
    return windows, gaps, stalls


def model_of(config):
    """With ``sizes``, for the events of the batches that it has run."""
    model = RegionSequence(IntegerCore(config))
    model.sizes = []
    return model


def without_clock(result):
    """A result as the model gives it: without cycles."""
    return dataclasses.replace(
        result, regions=tuple(dataclasses.replace(region, cycles=None) for region in result.regions)
    )


async def _play(ctx, block, config, writes, table, windows, values, found, stalls):
    """Fill the tables, offer windows, take results: ports by their Verilog names, in the order in which they come."""
    for name, rows in (("schedule_write", table), ("row_write", writes)):
        port = getattr(block, name)
        for row in rows:
            ctx.set(port.valid, 1)
            ctx.set(port.payload, row)
            await ctx.tick()
        ctx.set(port.valid, 0)
    ctx.set(block.settings, nested(block.settings.shape(), values))
    events = [
        (*event, number + 1 == len(window[0]))
        for window in windows
        for number, event in enumerate(zip(*window, strict=True))
    ]
    wanted, sent, waited = len(windows) * len(writes), 0, 0
    wrap = (1 << config.time_bits) - 1
    while len(found) < wanted:
        ctx.set(block.i.valid, sent < len(events))
        if sent < len(events):
            t, x, y, last = (int(part) for part in events[sent])
            ctx.set(block.i.payload, {"t": t & wrap, "x": x, "y": y, "last": last})
        ctx.set(block.o.ready, waited >= stalls)
        _, _, accepted, valid, result = await ctx.tick().sample(
            block.i.valid & block.i.ready, block.o.valid, block.o.payload
        )
        sent += accepted
        if valid and waited >= stalls:
            found.append(flat(result))
        waited = waited + 1 if valid and waited < stalls else 0
        yield


def run_amaranth(config, regions, windows, chosen, *, limit, stalls=0, check=None):
    """Results of windows by Amaranth's simulator, a dictionary each; AssertionError after ``limit`` cycles.

    ``check`` is called with those that there are, each time one comes.
    """
    block, found = Regions(config), []
    rows, table = tables(config, regions, chosen)
    names = [name.removeprefix("row_") for name in leaves("row", row_shape(config))]
    writes = [
        {"number": number, "fresh": 1, "row": nested(payloads.row(config), dict(zip(names, row, strict=True)))}
        for number, row in enumerate(rows)
    ]
    entries = [
        {"address": address, "entry": dict(zip(schedule_entry(config).members, entry, strict=True))}
        for address, entry in enumerate(table)
    ]
    values = settings_values(config, dataclasses.replace(chosen, rows=len(regions)))

    async def bench(ctx):
        cycles = seen = 0
        async for _ in _play(ctx, block, config, writes, entries, windows, values, found, stalls):
            cycles += 1
            if check and len(found) > seen:
                check(found)
            seen = len(found)
            assert cycles < limit, f"{len(found)} results after {limit} cycles"

    simulate(block, bench)
    return found
