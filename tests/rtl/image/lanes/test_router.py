"""Router: every bank that is wanted gets one head, of the lane whose turn it is or the next; none is given twice."""

import pytest

from cmfpga.config import Config
from cmfpga.rtl.image.lanes.router import Router
from support.bench import simulate
from support.values import Port, random_values


@pytest.mark.parametrize("lanes", [2, 4, 8])
def test_heads_go_where_they_are_wanted(lanes, rng):
    block = Router(Config(gradient="one_pass", lanes=lanes))
    noise = random_values(block.heads.shape(), rng)
    script, expected, taken, nothing = [], [], [], {"address": 0, "add": {"i": 0, "dx": 0, "dy": 0}}
    for cycle in range(300):
        heads, turn = next(noise), int(rng.integers(lanes))
        share = (0.1, 0.5, 1.0)[cycle % 3]  # few, many, all; often for one bank
        few = int(rng.integers(1, lanes // 2 + 1))
        banks = [[int(rng.integers(few)) if rng.random() < share else None for _ in range(2)] for _ in range(lanes)]
        given, out = [[0, 0] for _ in range(lanes)], []
        for bank in range(lanes):
            order = [(turn + k) % lanes for k in range(lanes)]
            lane = next((lane for lane in order if banks[lane][bank & 1] == bank >> 1), None)
            out.append((int(lane is not None), nothing if lane is None else heads[lane][bank & 1]))
            if lane is not None:
                given[lane][bank & 1] = 1
        wants = [[0 if bank is None else 1 << bank for bank in lane] for lane in banks]
        script.append({"turn": [turn] * 2, "wants": wants, "heads": heads})
        taken.append([first | second << 1 for first, second in given])
        expected.append(out)
    for address in range(8):
        script.append({"wants": [[0, 0]] * lanes, "valid": 1, "address": address})
        expected.append([(1, nothing | {"address": address})] * lanes)
    found = outputs(block, script)
    assert [row for row, _ in found[: len(taken)]] == taken
    for row, (_, got) in zip(expected, found[block.latency :], strict=True):
        for (given, operation), out in zip(row, got, strict=True):
            assert out == (operation if given else operation | {"address": out["address"]})  # else it adds 0, anywhere


def outputs(block, script):
    """(taken, what each bank gets) in every cycle of the script, and in :attr:`Router.latency` more."""
    names = ("turn", "wants", "heads", "taken")
    ports = {name: Port(getattr(block, name)) for name in names}
    ports |= {"valid": Port(block.sweep.valid), "address": Port(block.sweep.payload)}
    out = Port(block.o)
    found = []

    async def bench(ctx):
        for line in [*script, *[{}] * block.latency]:
            for name, value in {"valid": 0, **line}.items():
                ports[name].set(ctx, value)
            found.append((ports["taken"].get(ctx), out.get(ctx)))
            await ctx.tick()

    simulate(block, bench)
    return found
