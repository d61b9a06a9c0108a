"""Arithmetic that several blocks share: products in LUTs and limits, for every operand."""

import itertools
import random

import pytest
from amaranth.hdl import Module, Shape, Signal
from amaranth.sim import Simulator

from cmfpga import fixed
from cmfpga.config import preset
from cmfpga.protocol.confidence import is_short as told_short
from cmfpga.rtl import payloads
from cmfpga.rtl.arithmetic import is_beyond, is_short, negative_where, saturate, small_product, wide_product
from support.bench import simulate
from support.values import shape_range


def check(made, into, *shapes, wanted):
    """Of a function without a clock: what it makes, in so many bits, of all values of signals of these shapes."""
    m, inputs, output = Module(), [Signal(shape) for shape in shapes], Signal(into)
    m.d.comb += output.eq(made(*inputs))
    ends = map(shape_range, shapes)

    async def bench(ctx):
        for values in itertools.product(*(range(low, high + 1) for low, high in ends)):
            for signal, value in zip(inputs, values, strict=True):
                ctx.set(signal, value)
            assert ctx.get(output) == wanted(*values)

    simulator = Simulator(m)
    simulator.add_testbench(bench)
    simulator.run()


@pytest.mark.parametrize("bits", [1, 2, 3, 4, 6])
@pytest.mark.parametrize("shape", [Shape(5, signed=True), Shape(4)], ids=str)
def test_small_product(shape, bits):
    into = Shape(shape.width + bits, shape.signed)
    check(small_product, into, shape, Shape(bits), wanted=lambda value, factor: value * factor)


def test_negative_where():
    five = Shape(5, signed=True)
    check(negative_where, five, Shape(1), five, wanted=lambda flag, v: v if not flag or v == -16 else -v)


@pytest.mark.parametrize(
    "low, high", [(-16, 15), (-8, 7), (-1, 0), (-7, 8), (-8, 8), (0, 9), (3, 6), (-32, 31), (0, 31), (0, 24), (-8, 12)]
)
@pytest.mark.parametrize("shape", [Shape(6, signed=True), Shape(5)], ids=str)
def test_saturate(shape, low, high):
    made, wanted = (lambda value, limit=limit: limit(value, low, high) for limit in (saturate, fixed.saturate))
    check(made, Shape(8, signed=True), shape, wanted=wanted)
    check(lambda value: is_beyond(value, low, high), Shape(1), shape, wanted=lambda value: wanted(value) != value)


@pytest.mark.parametrize("cycles", [2, 3, 4])
@pytest.mark.parametrize("a, b", [
    (Shape(20), Shape(21, signed=True)), (Shape(36, signed=True), Shape(24)), (Shape(17), Shape(18, signed=True)),
    (Shape(18), Shape(9, signed=True)), (Shape(35, signed=True), Shape(53)),
], ids=str)  # fmt: skip
def test_wide_product(a, b, cycles):
    m = Module()
    factors = Signal(a), Signal(b)
    product = Signal(Shape(a.width + b.width, signed=True))
    m.d.comb += product.eq(wide_product(m, *factors, cycles, name="product"))
    low, high = zip(*map(shape_range, (a, b)), strict=True)
    ends = [(first, last, 0, 1, last // 2 + 1, last - 1) for first, last in zip(low, high, strict=True)]
    rng = random.Random(a.width)
    pairs = [*itertools.product(*ends), *(list(map(rng.randint, low, high)) for _ in range(300))]

    async def bench(ctx):
        for k in range(len(pairs) + cycles):
            if k >= cycles:
                x, y = pairs[k - cycles]
                assert ctx.get(product) == x * y
            for factor, value in zip(factors, pairs[min(k, len(pairs) - 1)], strict=True):
                ctx.set(factor, value)
            await ctx.tick()

    simulate(m, bench)


@pytest.mark.parametrize("motion", ["fast", "similarity"])
def test_is_short(motion):
    """All translations of few bits, and their ends; of four parameters any near the limit."""
    config = preset(motion).replace(v_frac=2, v_int=3)
    m, count = Module(), len(config.motion_model.names)
    v = Signal(payloads.velocity(config))
    short = Signal()
    m.d.comb += short.eq(is_short(m, v))
    rng, met = random.Random(count), set()
    drawn = [rng.choices(range(-4, 5), k=count) for _ in range(500)]
    pairs = [*itertools.product(range(-8, 9), repeat=2), (-32, -32), (31, -32)] if count == 2 else drawn

    async def bench(ctx):
        for pair in pairs:
            for name, value in zip(config.motion_model.names, pair, strict=True):
                ctx.set(v[name], value)
            await ctx.tick()
            assert ctx.get(short) == told_short([value / 4 for value in pair])
            met.add(ctx.get(short))

    simulate(m, bench)
    assert met == {0, 1}
