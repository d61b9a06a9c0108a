"""Counters: nothing is lost or counted twice, whatever comes in which cycle; how late they are."""

import pytest

from cmfpga.config import preset
from cmfpga.protocol.registers.contract import COUNTERS
from cmfpga.protocol.results import RESULTS
from cmfpga.rtl.shell import counters
from cmfpga.rtl.shell.counters import BITS, BY_PULSE, LONGEST, OF_BATCH, PLACES, PULSES, Counters
from support.bench import simulate
from support.mutation import break_blocks
from support.values import Port

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


def counted(result, held, last):
    """What a result adds to; ``last`` is 1, or 0 of a region's that is not its batch's last."""
    of_batch = {name: last * {**result, "batches": 1}[name] for name in OF_BATCH}
    return {**result, "results_held_back": held, **of_batch}


def results(rng):
    """Of results what counts, and the words of their packets, of which all else is at random."""
    width = CONFIG.max_batch_events.bit_length()
    while True:
        result = {name: int(rng.integers(1 << (1 if name in BITS else width))) for name in PLACES}
        result[LONGEST] = int(rng.integers(1 << 32)) >> int(rng.integers(32))
        words = [int(word) for word in rng.integers(1 << 32, size=32)]
        for name, place in PLACES.items():
            mask = 1 if name in BITS else (1 << 32) - 1
            words[place.word] = words[place.word] & ~(mask << place.lsb) | result[name] << place.lsb
        words[next(f for f in RESULTS if f.name == "cycles").places[0].word] = result[LONGEST]
        yield result, [low | high << 32 for low, high in zip(words[::2], words[1::2], strict=True)]


@pytest.mark.parametrize("regions", [0, 4])
@pytest.mark.parametrize(("busy", "gap"), [(1.0, 32), (0.9, 32), (0.5, 60), (0.02, 200)])
def test_against_a_model(busy, gap, regions, rng):
    """Results as often as they may come; clears in any cycle but while a result counts."""
    check(CONFIG.replace(regions=regions), busy, gap, rng)


MUTANTS = {
    "each region is a batch": ("value & last[name] if name in last else value", "value"),
    "times once a region": ("some.eq(last.get(name, 1))", "some.eq(1)"),
}


@pytest.mark.parametrize("mutant", MUTANTS)
def test_a_broken_counter_of_batches_is_noticed(mutant, monkeypatch, rng):
    break_blocks(monkeypatch, counters, *MUTANTS[mutant])
    with pytest.raises(AssertionError):
        check(CONFIG.replace(regions=4), 0.5, 60, rng)


def check(config, busy, gap, rng):
    block, model = Counters(config), Model()
    made = results(rng)

    async def bench(ctx):
        ports = {name: Port(getattr(block, name)) for name in ("pulses", "begun", "held", "packet", "clear", "address")}
        since, next_gap, held, last, (value, words) = 0, gap, 0, 1, next(made)
        for cycle in range(1500):
            quiet = cycle % 500 > 440
            pulses = {name: int(not quiet and rng.random() < busy) for name in PULSES}
            begun = not quiet and since >= next_gap
            clear = not begun and since > block.walk and not quiet and rng.random() < 0.004
            if begun:
                since, next_gap, held = 0, gap + int(rng.integers(4)) * 7, int(rng.integers(2))
                value, words = next(made)
                last = int(rng.integers(2)) if config.regions else 1
                if config.regions:
                    ctx.set(block.last, last)
            ports["pulses"].set(ctx, pulses)
            for name, what in (("begun", begun), ("held", held), ("clear", clear)):
                ports[name].set(ctx, int(what))
            ports["packet"].set(ctx, words[since] if since < len(words) else 0)
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
            model.cycle(pulses, counted(value, held, last) if begun else None, clear)
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
