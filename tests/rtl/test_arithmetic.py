"""Arithmetic that several blocks share: products in LUTs, for every operand."""

import pytest
from amaranth.hdl import Module, Shape, Signal
from amaranth.sim import Simulator

from cmfpga.rtl.arithmetic import small_product


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
