"""Arithmetic that several blocks share: products in LUTs and limits, for every operand."""

import pytest
from amaranth.hdl import Module, Shape, Signal
from amaranth.sim import Simulator

from cmfpga import fixed
from cmfpga.rtl.arithmetic import saturate, small_product


@pytest.mark.parametrize("bits", [1, 2, 3, 4, 6])
@pytest.mark.parametrize("shape", [Shape(5, signed=True), Shape(4)], ids=str)
def test_small_product(shape, bits):
    m = Module()
    value, factor, product = Signal(shape), Signal(bits), Signal(Shape(shape.width + bits, shape.signed))
    m.d.comb += product.eq(small_product(value, factor))
    low = -(1 << shape.width - 1) if shape.signed else 0

    async def bench(ctx):
        for v in range(low, low + (1 << shape.width)):
            for f in range(1 << bits):
                ctx.set(value, v)
                ctx.set(factor, f)
                assert ctx.get(product) == v * f

    simulator = Simulator(m)
    simulator.add_testbench(bench)
    simulator.run()


@pytest.mark.parametrize(
    "low, high", [(-16, 15), (-8, 7), (-1, 0), (-7, 8), (-8, 8), (0, 9), (3, 6), (-32, 31), (0, 31)]
)
@pytest.mark.parametrize("shape", [Shape(6, signed=True), Shape(5)], ids=str)
def test_saturate(shape, low, high):
    m = Module()
    value, limited = Signal(shape), Signal(Shape(8, signed=True))
    m.d.comb += limited.eq(saturate(value, low, high))

    async def bench(ctx):
        for number in range(-32, 32) if shape.signed else range(32):
            ctx.set(value, number)
            assert ctx.get(limited) == fixed.saturate(number, low, high)

    simulator = Simulator(m)
    simulator.add_testbench(bench)
    simulator.run()
