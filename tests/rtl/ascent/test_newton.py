"""Newton ascent against its model: any gradients of a round, any entry, v in its cycle."""

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.config.schedule import DISTANCES, Round
from cmfpga.protocol.confidence import curvature
from cmfpga.protocol.settings import table_entry
from cmfpga.reference.integer.ascent import newton, solve
from cmfpga.rtl.ascent import newton as module
from cmfpga.rtl.ascent.newton import NewtonAscent
from support.ascents import Player
from support.configs import ROUNDS
from support.mutation import break_blocks

#: G of few bits that are not 0, and of many.
SHAPES = {**ROUNDS, "64×64": preset("fast").replace(ascent="newton", evaluators=4)}


def random_round(config, rng):
    """Gradients of a peak, or anything; sizes from the least to the bound."""
    zeros, bound = config.widths.g_zeros, config.widths.g_max >> config.widths.g_zeros
    size = int(2.0 ** rng.uniform(0, np.log2(bound)))
    if rng.random() < 0.6:  # a peak, sharp or flat, often near: G falls from one side of it to the other
        a, c, b = size, max(1, int(size * rng.uniform(0.01, 1))), int(size * rng.uniform(-0.3, 0.3))
        at = rng.uniform(-2, 2, 2) * rng.choice([1, 0.1])
        places = [(at[0] + x, at[1] + y) for x, y in ((-1, 0), (1, 0), (0, -1), (0, 1))]
        found = [(-int(a * x + b * y), -int(b * x + c * y)) for x, y in places]
    elif rng.random() < 0.1:
        found = [(0, 0)] * 4
    elif rng.random() < 0.3:
        found = [tuple(row) for row in (bound * rng.choice([-1, 0, 1], (4, 2))).tolist()]
    else:
        found = [tuple(row) for row in rng.integers(-size, size + 1, (4, 2)).tolist()]
    return [tuple(max(-bound, min(bound, one)) << zeros for one in pair) for pair in found]


def random_entry(config, rng):
    v = config.formats.v
    limit = 2.0 ** int(rng.integers(1 - v.f, v.i - 1)) * float(rng.choice([1, 1.5]))
    return Round(int(rng.integers(config.max_level + 1)), int(rng.choice(DISTANCES)), limit)


def check(config, rng, count=8, rounds=12):
    """Batches of rounds; v, the curvature and what is flagged, in every cycle. Returns what the model solved."""
    # Noise of its own, so that the rounds do not depend on how many cycles they take.
    player, fmt = Player(NewtonAscent(config), np.random.default_rng(1)), config.formats.v
    falls, solved = {}, []
    for _ in range(count):
        plan = [random_entry(config, rng) for _ in range(rounds)]
        for k, entry in enumerate(plan):
            values = dict(zip(("level", "distance", "limit"), table_entry(config, entry), strict=True))
            write = {"address": k, "entry": values}
            player.cycle(**{"schedule_write.valid": 1, "schedule_write.payload": write})
        start = tuple(int(rng.integers(fmt.min, fmt.max + 1)) >> int(rng.integers(4)) for _ in "xy")
        player.begin(start, wait=3, start_last=0, cold={"first": 0, "count": rounds})
        for entry in plan:
            player.cycle(3 + int(rng.integers(8)))
            gradients = random_round(config, rng)
            player.give(*gradients)
            falls[len(player.script)] = curvature(*gradients)
            solved.append(solve(config, gradients, entry))
            player.step(*newton(config, player.v, gradients, entry))
            player.cycle(player.block.latency)
        player.cycle()
        player.cycle(**{"run.done": 1, "run.degenerate": 0})
    watch = player.check("curvature")
    for number, right in falls.items():
        assert tuple(watch["curvature"][number].values()) == tuple(right), f"cycle {number}"
    return solved


@pytest.mark.parametrize("name", SHAPES)
def test_matches_model(name, rng):
    config = SHAPES[name]
    assert NewtonAscent(config).latency == config.ascent_rule.latency(config)
    solved = check(config, rng)
    assert {one.peak for one in solved} == {one.damped for one in solved} == {False, True}
    top = (2 << config.v_frac) - 1
    assert {ratio == top for one in solved if one.peak for ratio in one.ratio} == {False, True}
    assert {step == 0 for one in solved if not one.peak for step in one.step} == {False, True}


MUTANTS = {  # old, new
    "the first gradient of y": ('(2 if name == "yy" else 0)', "0"),
    "mixed falls": ('"cross"] = other, turn[0], 1', '"cross"] = own, turn[0], 1'),
    "carries": ("+ addend + carry", "+ addend"),
    "normalised by one": ("value << by", "value << 1"),
    "normalised too far": ("shift.eq(due & fits)", "shift.eq(due)"),
    "told of the bits before": ("telling << by", "telling"),
    "one sum tells": ("[*map(_size, sums.values())]", "[_size(sums['xx'])] * 5"),
    "determinant": ("(first << 2) - second", "(first << 2)"),
    "damps": ("damps.eq((det_before << 1) < first)", "damps.eq(0)"),
    "how far": ("(first >> 4)", "(first >> 3)"),
    "damped xx": ("xx + Mux(damps, trace >> 3, 0)", "xx"),
    "damped yy": ("yy + Mux(damps, trace >> 3, 0)", "yy"),
    "no trace": ("& ~trace[-1]", ""),
    "no determinant": ("& ~det[-1]", ""),
    "determinant of nothing": ("some.any() &", ""),
    "kept y": ("kept_y.eq(cross_y)", "kept_y.eq(second)"),
    "numerators": ("(second << 1) - cross_x", "(second << 1)"),
    "size": ("rest.eq(_size(over))", "rest.eq(over)"),
    "trial": ('name=f"det_{axis}") << 1)', 'name=f"det_{axis}"))'),
    "always down": ("down = ~rest[-1]", "down = Const(1, 1)"),
    "carry of the divider": ("Cat(Const(1, 1), rest)", "Cat(Const(0, 1), rest)"),
    "limited ratio": (" & inverse[-1].replicate(bits - 1)", ""),
    "lesser": ("delay(m, lesser | (kept", "delay(m, (kept"),
    "zero": ("(kept[axis] == 0)", "0"),
    "signs": ("Mux(peak, over[axis][-1], kept[axis][-1])", "over[axis][-1]"),
    "limit": ("Mux(scaled_s2 > limit, limit, scaled_s2)", "scaled_s2"),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_what_is_broken_is_noticed(name, monkeypatch, rng):
    break_blocks(monkeypatch, module, *MUTANTS[name])
    with pytest.raises((AssertionError, KeyError)):
        check(SHAPES["64×64"], rng, count=12)
