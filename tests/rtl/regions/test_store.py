"""Store: what is read from a bin is what was put there, whatever the sizes; sizes at which a field gets narrow, too."""

import numpy as np
import pytest

from cmfpga.rtl.regions.store import Store
from support.bench import simulate
from support.regions import CONFIGS

SMALL = CONFIGS["one unit"].replace(sensor_width=21, sensor_height=10, roi_width=8, roi_height=6, max_iterations=9)


def batches(config, rng):
    """Events ``(t, x, y)`` of four batches: all over the sensor, or all in its last pixel."""
    for number in range(4):
        count = max(1, config.max_batch_events - number // 2)
        size = (config.sensor_width, config.sensor_height)
        x, y = (rng.integers(side, size=count) if number % 2 else np.full(count, side - 1) for side in size)
        yield list(zip(rng.integers(1 << config.span_bits, size=count).tolist(), x.tolist(), y.tolist(), strict=True))


def in_bins(config, events):
    found = {row << config.store.column_bits | column: []
             for row in range(config.store.rows) for column in range(config.store.columns)}  # fmt: skip
    for t, x, y in events:
        found[(y >> config.bin_bits) << config.store.column_bits | x >> config.bin_bits].append((t, x, y))
    return found


async def pulse(ctx, *signals):
    for signal in signals:
        ctx.set(signal, 1)
    await ctx.tick()
    for signal in signals:
        ctx.set(signal, 0)


async def settle(ctx, store):
    """Until all that came is stored, and nothing is being cleared."""
    for _ in range(Store.latency + 2):
        await ctx.tick()
    while not ctx.get(store.cleared):
        await ctx.tick()


async def read(ctx, store, address):
    """Events of a bin, once nothing has moved for longer than it takes to look one up."""
    found, quiet = [], 0
    ctx.set(store.read.payload, address)
    ctx.set(store.read.valid, 1)
    while quiet < 12:
        if ctx.get(store.o.valid):
            found.append(tuple(ctx.get(store.o.payload[name]) for name in "txy"))
        moves = ctx.get(store.busy) | ctx.get(store.o.valid) | ctx.get(store.read.valid)
        taken, quiet = ctx.get(store.read.ready), 0 if moves else quiet + 1
        await ctx.tick()
        if taken:
            ctx.set(store.read.valid, 0)
    return found


@pytest.mark.parametrize("bin_bits", [2, 6])
@pytest.mark.parametrize("most", [1, 2, 3, 15, 16, 31, 33])
def test_every_bin_gives_back_its_events(most, bin_bits, rng):
    config = SMALL.replace(max_batch_events=most, bin_bits=bin_bits)
    store = Store(config)

    async def bench(ctx):
        await pulse(ctx, store.reset)
        await settle(ctx, store)
        for events in batches(config, rng):
            await pulse(ctx, store.open)
            ctx.set(store.i.valid, 1)
            for t, x, y in events:
                ctx.set(store.i.payload, {"t": t, "x": x, "y": y})
                await ctx.tick()
            ctx.set(store.i.valid, 0)
            await settle(ctx, store)
            await pulse(ctx, store.take)
            for address, wanted in in_bins(config, events).items():
                assert await read(ctx, store, address) == wanted
            await pulse(ctx, store.clear)
            await settle(ctx, store)

    simulate(store, bench)
