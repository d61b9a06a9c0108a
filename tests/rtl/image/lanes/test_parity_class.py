"""Parity class: no vote is lost or counted twice, none waits for ever, and each is added to its own pixel."""

from collections import Counter, defaultdict

import pytest

from cmfpga.config import Config
from cmfpga.rtl.image.lanes.parity_class import ParityClass
from support.bench import simulate
from support.values import Port, random_values

#: Which pixels (column, row) of the class the votes are for.
PATTERNS = {
    "any": lambda rng: rng.integers(8, size=2),
    "one pixel": lambda rng: (3, 5),
    "one bank": lambda rng: (lambda row: (8 - row, row))(int(rng.integers(1, 8))),
    "two cells": lambda rng: (2, 2) if rng.random() < 0.5 else (5, 1),
}


@pytest.mark.parametrize("lanes", [2, 4, 8])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_every_vote_is_added_once(pattern, lanes, rng):
    config = Config(gradient="one_pass", lanes=lanes, roi_width=16, roi_height=16, tag_bits=8)
    block = ParityClass(config)
    noise = random_values(block.i[0].shape(), rng)
    votes, turn, tag = Port(block.i), Port(block.turn), Port(block.tag)
    steps, sweep = Port(block.o), Port(block.sweep.valid)
    sent, came, image = Counter(), Counter(), defaultdict(int)
    totals = Counter()

    async def bench(ctx):
        tag.set(ctx, 0)
        sweep.set(ctx, 1)
        for address in range(config.geometry.words):
            ctx.set(block.sweep.payload, address)
            await ctx.tick()
        sweep.set(ctx, 0)
        await ctx.tick()
        tag.set(ctx, 1)
        room, empty = 1, 0
        for cycle in range(2000):
            row = []
            for _ in range(lanes):
                column, line = (int(axis) for axis in PATTERNS[pattern](rng))
                address = line << config.geometry.bank_column_bits | column
                vote = next(noise) | {"valid": int(room and cycle < 300 and rng.random() < 0.7), "address": address}
                row.append(vote)
                add = vote["i"], vote["dx"], vote["dy"]
                if vote["valid"] and any(add):
                    sent[(column + line) % lanes, add] += 1
                    image[column, line] += vote["i"]
            votes.set(ctx, row)
            turn.set(ctx, [cycle % lanes] * 2)
            for number, step in enumerate(steps.get(ctx)):
                add = tuple(step["add"][name] for name in ("i", "dx", "dy"))
                if any(add):
                    came[number, add] += 1
                    assert step["total"]["i"] == step["i"] + add[0]
                    totals[number] += step["total"]["i"] ** 2 - step["i"] ** 2
            empty = empty + 1 if ctx.get(block.empty) else 0
            room = not ctx.get(block.full)
            if cycle > 300 and empty > 10:
                return
            await ctx.tick()
        raise AssertionError("votes wait for ever")

    simulate(block, bench)
    assert came == sent and sum(sent.values()) > 300
    assert sum(totals.values()) == sum(value**2 for value in image.values())
