"""Skid buffer: a stream goes through unchanged, at full rate, with no combinational path."""

import pytest

from cmfpga.rtl.shell.skid_buffer import SkidBuffer
from support.axi_streams import FLOWS, pass_through
from support.bench import simulate
from support.values import Port


@pytest.mark.parametrize("flow", FLOWS)
def test_everything_passes_in_order(flow, rng):
    items = rng.integers(0, 256, 200).tolist()
    assert pass_through(SkidBuffer(8), items, flow, rng, expect=200).values == items


def test_latency_and_throughput(rng):
    passage = pass_through(SkidBuffer(8), list(range(50)), "free", rng, expect=50)
    assert passage.taken == list(range(1, 51))  # not in the first cycle: a reset ends quietly
    assert [cycle for cycle, _ in passage.out] == [cycle + SkidBuffer.latency for cycle in passage.taken]


def test_two_items_inside_and_nothing_asked_of_the_output():
    """``i.ready`` does not depend on ``o.ready`` in the same cycle; two items fit."""
    block = SkidBuffer(8)
    valid, payload = Port(block.i.valid), Port(block.i.payload)
    taken = []

    async def bench(ctx):
        valid.set(ctx, 1)
        for k in range(8):
            payload.set(ctx, k)
            before = ctx.get(block.i.ready)
            ctx.set(block.o.ready, 1)
            assert ctx.get(block.i.ready) == before
            ctx.set(block.o.ready, 0)
            if before:
                taken.append(k)
            assert ctx.get(block.empty) == (not taken or k == taken[0])
            await ctx.tick()

    simulate(block, bench)
    assert len(taken) == 2
