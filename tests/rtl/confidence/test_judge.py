"""The judge against the comparison that it makes, in its cycle; and its two parts by themselves."""

import inspect

import numpy as np
import pytest
from amaranth.sim import Simulator

from cmfpga.config import preset
from cmfpga.protocol.confidence import contrast, curvature, is_trusted
from cmfpga.rtl.confidence import curvature as curvature_block
from cmfpga.rtl.confidence import judge, verdict
from cmfpga.rtl.confidence.judge import Judge
from support.bench import play
from support.mutation import break_blocks, mutated

CONFIG = preset("fast").replace(
    sensor_width=40, sensor_height=30, roi_width=16, roi_height=12, buffer_events=48, tag_bits=5
)


def cases(config, rng, count):
    """``(n, limit, ΣI, squares, gradients of the four probes)``: any verdict."""
    widths, pixels = config.widths, config.geometry.pixels
    for _ in range(count):
        n, limit = int(rng.integers(1, config.buffer_events + 1)), int(rng.choice([0, 1, 90, 1023]))
        sum_i = int(rng.integers(widths.sum_i_max + 1) >> rng.integers(4))
        squares = sum_i**2 // pixels + int(rng.integers(1, 2 ** int(rng.integers(1, 12))))
        by_n, by_limit = widths.judge_scales
        size = by_limit * limit * (pixels * squares - sum_i**2) // (by_n * n) + int(rng.integers(0, 9))
        xx, yy = (int(size * rng.uniform(0.8, 3)) for _ in "xy")
        mixed = int(rng.uniform(-0.7, 0.7) * size)
        if rng.random() < 0.3:  # anything
            xx, yy, mixed = (int(rng.integers(-widths.g_max // 4, widths.g_max // 4)) for _ in range(3))
        below = rng.integers(-1000, 1000, (2, 2)).tolist()
        above = [[below[0][0] - xx, below[0][1] - mixed], [below[1][0] - mixed // 2, below[1][1] - yy]]
        if rng.random() < 0.1:  # as large as can be
            below, above = (widths.g_max * rng.choice([-1, 1], (2, 2, 2))).tolist()
        # Of whole cells G is P·S: its lowest bits are those of P.
        gradients = (np.array([below[0], above[0], below[1], above[1]]) >> widths.g_zeros << widths.g_zeros).tolist()
        yield n, limit, sum_i, squares, gradients


def verdicts(judge, many):
    """``(doubtful, curvature, cycles from the last gradient to done)`` of each case."""
    results = []

    async def bench(ctx):
        for n, limit, sum_i, squares, gradients in many:
            ctx.set(judge.new_batch, 1)
            await ctx.tick()
            ctx.set(judge.new_batch, 0)
            ctx.set(judge.sum_i, sum_i)
            ctx.set(judge.squares, squares)
            ctx.set(judge.events, n)
            ctx.set(judge.limit, limit)
            ctx.set(judge.begin, 1)
            await ctx.tick()
            ctx.set(judge.begin, 0)
            for x, y in gradients:
                for _ in range(judge.config.one_pass.latency):
                    await ctx.tick()
                ctx.set(judge.i.payload, {"x": x, "y": y})
                ctx.set(judge.i.valid, 1)
                await ctx.tick()
                ctx.set(judge.i.valid, 0)
            cycles = 1
            while not ctx.get(judge.done) and cycles < 2 * judge.latency:
                await ctx.tick()
                cycles += 1
            await ctx.tick()
            shape = ctx.get(judge.curvature)
            results.append((ctx.get(judge.doubtful), (shape["xx"], shape["yy"], shape["cross"]), cycles))

    simulator = Simulator(judge)
    simulator.add_clock(1e-6)
    simulator.add_testbench(bench)
    simulator.run()
    return results


def expected(config, many):
    for n, limit, sum_i, squares, gradients in many:
        shape = curvature(*gradients)
        trusted = is_trusted(config, n, limit, shape, contrast(config.geometry.pixels, (sum_i,), squares))
        yield int(not trusted), tuple(shape)


@pytest.mark.parametrize(
    "changes",
    [{}, {"weight_frac": 3, "derivative_frac": 6}, {"weight_frac": 6}, {"border": "corners"}],
    ids=str,
)
def test_the_verdict_is_the_models(changes, rng):
    config = CONFIG.replace(**changes)
    block, many = Judge(config), list(cases(config, rng, 120))
    wanted = [*expected(config, many)]
    assert 0.2 < np.mean([doubtful for doubtful, _ in wanted]) < 0.8
    assert verdicts(block, many) == [(*one, block.latency) for one in wanted]


@pytest.mark.parametrize(
    "old, new",
    [
        ("difference.eq(Mux(side[-1], b, 0))", "difference.eq(0)"), ("Mux(turn == 3, scaled, 0)", "0"),
        ("none | (difference <= 0)", "difference <= 0"), ("none | (difference <= 0)", "none"),
        ("c << 2", "c << 1"), ("with m.If(~full)", "with m.If(full == full)"), ("(turn != 2)", "(turn == turn)"),
        ('("cross", 1, other)', '("cross", ~came[1], other)'), ("addend + came[0]", "addend"),
        ("came[0].replicate", "came[1].replicate"), ("config.geometry.pixels - square", "config.geometry.pixels"),
        ("found.eq(0)", "found.eq(found)"), ("found << zeros", "found << 1"),
    ],
)  # fmt: skip
def test_another_judge_would_be_noticed(old, new, rng, monkeypatch):
    if old in inspect.getsource(judge):
        break_blocks(monkeypatch, judge, old, new)
    else:
        monkeypatch.setattr(judge, "subtract", mutated(curvature_block, old, new).subtract)
    many = list(cases(CONFIG, rng, 120))
    assert [one[:2] for one in verdicts(Judge(CONFIG), many)] != [*expected(CONFIG, many)]


def decided(config, many):
    """What a verdict says of each case; in its cycle."""
    block, script = verdict.Verdict(config), []
    for n, limit, sum_i, squares, gradients in many:
        shape = dict(zip(("xx", "yy", "cross"), curvature(*gradients), strict=True))
        given = {"sum_i": sum_i, "squares": squares, "events": n, "limit": limit, "curvature": shape}
        script += [{"begin": 1, **given}, *[{}] * (block.latency + 3)]
    watched = play(block, script, flows=(), watch=("done", "doubtful")).watch
    done = [cycle for cycle, value in enumerate(watched["done"]) if value]
    assert done == [block.latency + k * (block.latency + 4) for k in range(len(many))]
    return [watched["doubtful"][cycle + 1] for cycle in done]


VERDICTS = {
    "fast": CONFIG,
    "fractions": CONFIG.replace(weight_frac=3, derivative_frac=6),
    "finer weights": CONFIG.replace(weight_frac=6),
    "ΣI in two pieces": CONFIG.replace(buffer_events=9000, tag_bits=5),
}


@pytest.mark.parametrize("name", VERDICTS)
def test_the_verdict_by_itself(name, rng):
    """By a multiplier: the same of curvatures that are there already."""
    config = VERDICTS[name]
    many = list(cases(config, rng, 200))
    wanted = [doubtful for doubtful, _ in expected(config, many)]
    assert 0.2 < np.mean(wanted) < 0.8 and decided(config, many) == wanted


@pytest.mark.parametrize(
    "old, new",
    [
        ('kept["yy"], by_n, 0', 'kept["xx"], by_n, 0'), ('kept["cross"], by_n', 'kept["xx"], by_n'),
        ("total << 2", "total << 1"), ("(a <= 0) | (total <= 0)", "total <= 0"), ("(a <= 0) | (total <= 0)", "a <= 0"),
        ("(b_low, b_low, 1, SUM)", "(b_low, b_low, 0, SUM)"), ("(a_low, c_high, 0, SUM)", "(a_low, c_low, 0, SUM)"),
        ("(a_low, c_low, 0, SHIFTED)", "(a_low, c_low, 0, SUM)"),
        ("pixels - total", "pixels"),
        ("with m.If(~full)", "with m.If(full == full)"), ("by = 4 if number < self._fours else 1", "by = 1"),
    ],
)  # fmt: skip
def test_another_verdict_would_be_noticed(old, new, rng, monkeypatch):
    break_blocks(monkeypatch, verdict, old, new)
    many = list(cases(CONFIG, rng, 300))
    assert decided(CONFIG, many) != [doubtful for doubtful, _ in expected(CONFIG, many)]


def test_the_curvature_by_itself(rng):
    """What the judge adds up, for one who decides elsewhere."""
    block, many = curvature_block.Curvature(CONFIG), list(cases(CONFIG, rng, 20))
    script, ends = [], []
    for *_, gradients in many:
        script += [{"new_batch": 1}]
        for g in gradients:
            script += [{"i.valid": 1, "i.payload": dict(zip("xy", g, strict=True))}, *[{}] * int(rng.integers(3))]
        while len(script) and not script[-1]:
            script.pop()
        ends.append(len(script) - 1 + block.latency)
        script += [{}, {}]
    watched = play(block, script, flows=(), watch=("done", "curvature")).watch
    assert [cycle for cycle, value in enumerate(watched["done"]) if value] == ends
    found = [tuple(watched["curvature"][cycle][name] for name in ("xx", "yy", "cross")) for cycle in ends]
    assert found == [tuple(curvature(*gradients)) for *_, gradients in many]
