"""Vote queue against a list: votes come out in order, each once, and what comes until it is heeded still fits."""

import pytest

from cmfpga.config import Config
from cmfpga.rtl.image.lanes.vote_queue import VoteQueue
from support.bench import simulate
from support.values import Port, random_values


@pytest.mark.parametrize("lanes", [2, 4, 8])
@pytest.mark.parametrize("stall", [0.0, 0.5, 0.9])
def test_votes_come_out_in_order(lanes, stall, rng):
    """Pushed as the lanes do: what comes when it is full first, and in two cycles more, is taken as well."""
    config = Config(gradient="one_pass", lanes=lanes)
    block = VoteQueue(config)
    noise = random_values(block.i.payload.shape(), rng)
    valid, payload, head = Port(block.i.valid), Port(block.i.payload), Port(block.head)
    pushed, taken, levels = [], [], []

    async def bench(ctx):
        soon, room, waits = 1, 1, []  # cycles in which the votes that are there came
        for cycle in range(900):
            comes = room and cycle < 500 and rng.random() < (0.8 if cycle % 100 < 60 else 0.1)
            vote = next(noise)
            valid.set(ctx, int(comes))
            payload.set(ctx, vote)
            # The head is there two cycles after it came, or one after that before it has gone.
            wants = ctx.get(block.wants)
            assert bool(wants) == bool(waits and waits[0] <= cycle - 2)
            assert ctx.get(block.empty) == (not waits)
            takes = wants and rng.random() >= stall
            ctx.set(block.taken, int(takes))
            if takes:
                taken.append((wants.bit_length() - 1, head.get(ctx)))
                waits.pop(0)
            if comes:
                pushed.append((vote.get("bank", 0), vote["operation"]))
                waits.append(cycle)
            assert not wants & (wants - 1)
            levels.append(len(waits))
            soon, room = not ctx.get(block.full), soon
            await ctx.tick()

    simulate(block, bench)
    assert taken == pushed and len(pushed) > 50 and levels[-1] == 0
    assert max(levels) <= block.depth
    if stall == 0.9:
        assert max(levels) == block.depth  # every word, the head among them
