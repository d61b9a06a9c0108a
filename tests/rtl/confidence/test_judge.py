"""The judge against the comparison that it makes, in its cycle."""

import numpy as np
import pytest
from amaranth.sim import Simulator

from cmfpga.config import preset
from cmfpga.protocol.confidence import curvature, is_trusted
from cmfpga.rtl.confidence import judge as module
from cmfpga.rtl.confidence.judge import Judge

CONFIG = preset("fast").replace(
    sensor_width=40, sensor_height=30, roi_width=16, roi_height=12, buffer_events=48, tag_bits=5
)


def cases(config, rng, count):
    """``(n, limit, found, sums, squares, sums at x, sums at y)``: any verdict; the sums alone give the gradients."""
    widths, pixels = config.widths, config.geometry.pixels
    for _ in range(count):
        n, limit = int(rng.integers(1, config.buffer_events + 1)), int(rng.choice([0, 1, 90, 1023]))
        found = rng.integers(-1, 2, 2).tolist()
        sum_i = int(rng.integers(widths.sum_i_max + 1) >> rng.integers(4))
        squares = sum_i**2 // pixels + int(rng.integers(1, 2 ** int(rng.integers(1, 12))))
        signs = [-1 if axis > 0 else 1 for axis in found]
        size = limit * (pixels * squares - sum_i**2) // (8 * n * pixels) + int(rng.integers(0, 9))
        xx, yy = (int(size * rng.uniform(0.8, 3)) for _ in "xy")
        mixed = int(rng.uniform(-0.7, 0.7) * size)
        if rng.random() < 0.3:  # anything
            xx, yy, mixed = (int(rng.integers(-widths.s_max // 4, widths.s_max // 4)) for _ in range(3))
        gx, gy = (int(axis) for axis in rng.integers(-1000, 1000, 2))
        last = (sum_i, 0, 0, gx, gy)
        at_x = (sum_i, 0, 0, gx - signs[0] * xx, gy - signs[0] * mixed)
        at_y = (sum_i, 0, 0, gx - signs[1] * mixed, gy - signs[1] * yy)
        yield n, limit, found, last, squares, at_x, at_y


def verdicts(judge, many):
    """``(doubtful, cycles from the last gradient to done)`` of each case."""
    pixels, results = judge.config.geometry.pixels, []

    async def bench(ctx):
        for n, limit, found, last, squares, at_x, at_y in many:
            ctx.set(judge.new_batch, 1)
            await ctx.tick()
            ctx.set(judge.new_batch, 0)
            ctx.set(judge.sum_i, last[0])
            ctx.set(judge.squares, squares)
            ctx.set(judge.events, n)
            ctx.set(judge.limit, limit)
            ctx.set(judge.away, (found[0] > 0) + 2 * (found[1] > 0))
            for iterating, probing, sums in ((1, 0, last), (0, 1, at_x), (0, 2, at_y)):
                ctx.set(judge.iterating, iterating)
                ctx.set(judge.probing, probing)
                ctx.set(judge.i.payload, {"x": pixels * sums[3], "y": pixels * sums[4]})
                ctx.set(judge.i.valid, 1)
                ctx.set(judge.begin, iterating)
                await ctx.tick()
                ctx.set(judge.i.valid, 0)
                ctx.set(judge.begin, 0)
                for _ in range(0 if probing == 2 else judge.config.one_pass.latency):
                    await ctx.tick()
            cycles = 1
            while not ctx.get(judge.done) and cycles < 2 * judge.latency:
                await ctx.tick()
                cycles += 1
            await ctx.tick()
            results.append((ctx.get(judge.doubtful), cycles))

    simulator = Simulator(judge)
    simulator.add_clock(1e-6)
    simulator.add_testbench(bench)
    simulator.run()
    return results


def expected(config, many):
    pixels = config.geometry.pixels
    return [
        int(not is_trusted(config, n, limit, curvature(pixels, found, last, squares, at_x, at_y)))
        for n, limit, found, last, squares, at_x, at_y in many
    ]


@pytest.mark.parametrize("changes", [{}, {"weight_frac": 3, "derivative_frac": 6}, {"weight_frac": 6}], ids=str)
def test_the_verdict_is_the_models(changes, rng):
    config = CONFIG.replace(**changes)
    judge, many = Judge(config), list(cases(config, rng, 120))
    wanted = expected(config, many)
    assert 0.2 < np.mean(wanted) < 0.8
    assert verdicts(judge, many) == [(doubtful, judge.latency) for doubtful in wanted]


@pytest.mark.parametrize(
    "old, new",
    [
        ("difference.eq(Mux(side[-1], b, 0))", "difference.eq(0)"), ("Mux(turn == 3, scaled, 0)", "0"),
        ("none | (difference <= 0)", "difference <= 0"), ("none | (difference <= 0)", "none"),
        ("c << 2", "c << 1"), ("with m.If(~full)", "with m.If(full == full)"), ("(turn != 2)", "(turn == turn)"),
        ('wide["cross"] + fall', 'wide["cross"] - fall'), ("(self.away & self.probing).any()", "Const(0, 1)"),
        ("config.geometry.pixels - square", "config.geometry.pixels"),
    ],
)  # fmt: skip
def test_another_judge_would_be_noticed(old, new, rng):
    with open(module.__file__, encoding="utf-8") as file:
        source = file.read()
    assert source.count(old) == 1, old
    mutant = dict(vars(module))
    exec("from amaranth.hdl import Const\n" + source.replace(old, new), mutant)
    many = list(cases(CONFIG, rng, 120))
    found = [doubtful for doubtful, _ in verdicts(mutant["Judge"](CONFIG), many)]
    assert found != expected(CONFIG, many)
