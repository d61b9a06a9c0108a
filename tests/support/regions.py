"""Hardware with a table of regions: small configurations, random tables and batches, and how they are played."""

import dataclasses

import numpy as np

from cmfpga.config import preset
from cmfpga.engines.rtl import flat, nested
from cmfpga.protocol.regions import row_shape, tables
from cmfpga.protocol.results import decode
from cmfpga.protocol.settings import settings_values
from cmfpga.protocol.shapes import leaves
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.reference.regions import RegionSequence
from cmfpga.rtl.payloads import schedule_entry
from cmfpga.rtl.regions import payloads
from cmfpga.rtl.regions.regions import Regions
from support.bench import simulate
from support.core_batches import PLANS, ROUNDS, SIGN_PLANS, STEPS, moving_points, settings

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
        camera="36,35,18.3,16.8,-0.3,0.1,0,0,0", hot_mask="20,15;3,4", background_us=1 << 22,
    ),
    # The same in front of an image of wider pixels.
    "binned": _SMALL.replace(
        sensor_width=157, sensor_height=117, binning=2, undistortion="on", hot_pixels=1, background=1,
        camera="144,140,74.7,68.7,-0.3,0.1,0,0,0", hot_mask="81,62;82,62;13,17", background_us=1 << 22,
    ),
    "overlapping windows": _SMALL.replace(slices=3, units=3, hot_pixels=1),
    "similarity": _SMALL.replace(motion="similarity", ascent="sign", tag_bits=4, **STEPS),
    "four evaluators": _SMALL.replace(evaluators=4, undistortion="on"),
}  # fmt: skip


def random_window(config, rng, kind="any"):
    """Events ``(t, x, y)``: of a few points that move and of noise, some with wrong times; or all in one bin."""
    count = min(int(rng.choice([1, 2, 30, 100, config.slice_events])), config.slice_events)
    events = np.array(moving_points(config, rng, count, bad_times=0.1), np.int64).T
    if kind == "one bin":
        events[1:] = events[1:] % 4
    return tuple(events)


def random_settings(config, rng):
    plans = PLANS
    if config.ascent != "newton":
        plans = [plan for plan in SIGN_PLANS if not config.confidence or plan[-1].stride == 1]
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
        # Half of the parameters anywhere in a quarter of their range.
        limits = [parameter.fmt for parameter in config.motion_model.parameters]
        v_start = tuple(int(rng.integers(fmt.min, fmt.max + 1) * rng.integers(2)) // 4 for fmt in limits)
        chosen = dataclasses.replace(chosen, v_start=v_start)
    return chosen


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
    return dataclasses.replace(
        result, regions=tuple(dataclasses.replace(region, cycles=None) for region in result.regions)
    )


def check_amaranth(config, regions, windows, chosen, wanted, *, names, limit, stalls=0):
    """Windows in Amaranth's simulator: AssertionError at the first result that is not right, or after ``limit`` cycles.

    ``wanted``: of each window the model's results of its regions, of which the fields ``names`` are compared.
    """
    block, missing = Regions(config), set()
    rows, table = tables(config, regions, chosen)
    keys = [name.removeprefix("row_") for name in leaves("row", row_shape(config))]
    rows = [
        {"number": number, "fresh": 1, "row": nested(payloads.row(config), dict(zip(keys, row, strict=True)))}
        for number, row in enumerate(rows)
    ]
    entries = [
        {"address": address, "entry": dict(zip(schedule_entry(config).members, entry, strict=True))}
        for address, entry in enumerate(table)
    ]
    values = settings_values(config, dataclasses.replace(chosen, rows=len(regions)))
    wrap = (1 << config.time_bits) - 1
    events = [
        {"t": int(t) & wrap, "x": int(x), "y": int(y), "last": number + 1 == len(window[0])}
        for window in windows
        for number, (t, x, y) in enumerate(zip(*window, strict=True))
    ]

    def compare(row, number):
        missing.update(() if missing else range(len(regions)))
        assert row["region"] in missing
        missing.remove(row["region"])
        assert row["last"] == (not missing)
        one, right = decode(config, row), wanted[number][row["region"]]
        assert {name: one[name] for name in names} == {name: getattr(right, name) for name in names}

    async def bench(ctx):
        for port, writes in ((block.schedule_write, entries), (block.row_write, rows)):
            ctx.set(port.valid, 1)
            for write in writes:
                ctx.set(port.payload, write)
                await ctx.tick()
            ctx.set(port.valid, 0)
        ctx.set(block.settings, nested(block.settings.shape(), values))
        sent = waited = results = 0
        for _ in range(limit):
            ctx.set(block.i.valid, sent < len(events))
            if sent < len(events):
                ctx.set(block.i.payload, events[sent])
            taken = waited >= stalls
            ctx.set(block.o.ready, taken)
            _, _, accepted, valid, result = await ctx.tick().sample(
                block.i.valid & block.i.ready, block.o.valid, block.o.payload
            )
            sent += accepted
            waited = waited + 1 if valid and not taken else 0
            if valid and taken:
                compare(flat(result), results // len(regions))
                results += 1
                if results == len(windows) * len(regions):
                    return
        raise AssertionError(f"{results} results after {limit} cycles")

    simulate(block, bench)
