"""Counters: nothing is lost or counted twice, whatever comes in which cycle; how late they are."""

import pytest

from cmfpga.config import preset
from cmfpga.protocol.registers.contract import COUNTERS
from cmfpga.rtl.shell.counters import BY_PULSE, LONGEST, OF_FLAGS, OF_RESULTS, PULSES, Counters
from support.bench import simulate
from support.values import Port, random_values

CONFIG = preset("fast")
NAMES = [name.lower() for name in COUNTERS]
LATE = 31


class Model:
    """What every counter would show if it counted at once; of the last cycles, the newest last."""

    def __init__(self):
        self.shown = [dict.fromkeys(NAMES, 0)]

    def cycle(self, pulses, result, clear):
        now = {name: count + pulses.get(name, 0) for name, count in self.shown[-1].items()}
        now["cycles"] += 1
        for name, count in (result or {}).items():
            now[name] = max(now[name], count) if name == LONGEST else now[name] + count
        if clear:
            now = dict.fromkeys(NAMES, 0)
            self.shown = []
        self.shown = [*self.shown, now][-LATE - 1 :]


def counted(value, held):
    """What a result adds to."""
    bits = {name: value["flags"] >> flag.bit_length() - 1 & 1 for name, flag in OF_FLAGS.items()}
    of_results = {name: value[name] for name in OF_RESULTS}
    return {**of_results, **bits, "batches": 1, "results_held_back": held, LONGEST: value["cycles"]}


@pytest.mark.parametrize(("busy", "gap"), [(1.0, 32), (0.9, 32), (0.5, 60), (0.02, 200)])
def test_against_a_model(busy, gap, rng):
    """Results as often as they may come; clears in any cycle but while a result counts."""
    block, model = Counters(CONFIG), Model()
    results = random_values(block.result.shape(), rng)

    async def bench(ctx):
        ports = {name: Port(getattr(block, name)) for name in ("pulses", "begun", "held", "result", "clear", "address")}
        since, next_gap, held, value = 0, gap, 0, next(results)
        for cycle in range(1500):
            quiet = cycle % 500 > 440
            pulses = {name: int(not quiet and rng.random() < busy) for name in PULSES}
            begun = not quiet and since >= next_gap
            clear = not begun and since > block.walk and not quiet and rng.random() < 0.004
            if begun:
                since, next_gap, held, value = 0, gap + int(rng.integers(4)) * 7, int(rng.integers(2)), next(results)
            ports["pulses"].set(ctx, pulses)
            for name, what in (("begun", begun), ("held", held), ("clear", clear)):
                ports[name].set(ctx, int(what))
            ports["result"].set(ctx, value)
            number = int(rng.integers(len(NAMES)))
            ports["address"].set(ctx, number)
            seen, name = ctx.get(block.word), NAMES[number]
            if name in BY_PULSE:
                assert seen in {shown[name] % (1 << 32) for shown in model.shown}, (cycle, name)
            elif since > block.walk + 1:
                assert seen == model.shown[-1][name] % (1 << 32), (cycle, name)
            if cycle % 500 == 499:
                for number, name in enumerate(NAMES):
                    ports["address"].set(ctx, number)
                    late = model.shown[-1][name] - ctx.get(block.word)
                    assert late == 0 or (name == "cycles" and 0 < late <= LATE), (cycle, name, late)
            model.cycle(pulses, counted(value, held) if begun else None, clear)
            since += 1
            await ctx.tick()

    simulate(block, bench)


def test_beyond_the_last_is_nothing(rng):
    async def bench(ctx):
        Port(block.pulses).set(ctx, dict.fromkeys(PULSES, 1))
        await ctx.tick().repeat(80)
        for number in range(32):
            Port(block.address).set(ctx, number)
            assert (ctx.get(block.word) > 0) == (number < len(NAMES) and NAMES[number] in BY_PULSE)

    block = Counters(CONFIG)
    simulate(block, bench)
