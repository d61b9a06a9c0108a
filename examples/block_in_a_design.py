"""One block of cmfpga in a small design of one's own: a filter that silences hot pixels.

Needs no extra.

``ReadAddWrite`` is a memory whose words grow by what arrives, one event in every clock cycle, even if the same address
comes again and again: sums that are still on their way back to the RAM are forwarded. The accelerator keeps its images
in it. Here it counts the events of each pixel, and an event passes while its pixel has had fewer than a limit.

    python examples/block_in_a_design.py
"""

import numpy as np
from amaranth.hdl import Module, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out
from amaranth.sim import Simulator

from cmfpga.events import generate
from cmfpga.rtl.image.accumulator import ReadAddWrite

WIDTH, HEIGHT, LIMIT = 32, 16, 12


class HotPixelFilter(wiring.Component):
    """Passes the first ``limit`` events of each pixel. One event per cycle; latency ``ReadAddWrite.latency`` cycles."""

    def __init__(self, width, height, limit):
        self.width, self.height, self.limit = width, height, limit
        self.event = data.StructLayout({"x": range(width), "y": range(height)})
        flow = stream.Signature(self.event, always_ready=True)
        super().__init__({"i": In(flow), "o": Out(flow)})

    def elaborate(self, platform):
        m = Module()
        word, one = data.StructLayout({"count": 16}), data.StructLayout({"count": 1})
        m.submodules.counts = counts = ReadAddWrite(word, one, self.width * self.height)
        m.d.comb += [
            counts.i.valid.eq(self.i.valid),
            counts.i.payload.address.eq(self.i.payload.y * self.width + self.i.payload.x),
            counts.i.payload.add.count.eq(1),
        ]
        event = self.i.payload  # delayed as the block delays its answer
        for stage in range(1, counts.latency + 1):
            delayed = Signal(self.event, name=f"event_s{stage}")
            m.d.sync += delayed.eq(event)
            event = delayed
        m.d.comb += [
            self.o.payload.eq(event),
            self.o.valid.eq(counts.o.valid & (counts.o.payload.count < self.limit)),
        ]
        return m


def simulate(dut, x, y):
    """Events that the design passes, as a list of (x, y)."""
    passed = []

    async def bench(ctx):
        ctx.set(dut.i.valid, 1)
        for k in range(len(x) + ReadAddWrite.latency):
            if k < len(x):
                ctx.set(dut.i.payload, {"x": int(x[k]), "y": int(y[k])})
            else:
                ctx.set(dut.i.valid, 0)
            _, _, valid, event = await ctx.tick().sample(dut.o.valid, dut.o.payload)
            if valid:
                passed.append((event.x, event.y))
        await ctx.tick()
        if ctx.get(dut.o.valid):
            passed.append((ctx.get(dut.o.payload.x), ctx.get(dut.o.payload.y)))

    simulator = Simulator(dut)
    simulator.add_clock(1e-6)
    simulator.add_testbench(bench)
    simulator.run()
    return passed


def expected(x, y, limit):
    """The same in NumPy: an event passes if fewer than ``limit`` of its pixel came before it."""
    pixel = y.astype(int) * WIDTH + x
    before = np.array([np.count_nonzero(pixel[:k] == pixel[k]) for k in range(len(pixel))])
    return [(int(a), int(b)) for a, b in zip(x[before < limit], y[before < limit], strict=True)]


scene = generate(
    seed=2, width=WIDTH, height=HEIGHT, size=(8, 8), velocity=(300.0, 100.0), duration_us=40_000, hot_pixels=2,
    hot_rate=5000.0,
)  # fmt: skip
x, y = scene.events.x, scene.events.y
passed = simulate(HotPixelFilter(WIDTH, HEIGHT, LIMIT), x, y)
assert passed == expected(x, y, LIMIT)
assert len(passed) < len(x)
print(f"{len(x)} events in, {len(x) - len(passed)} of hot pixels left out, {len(passed)} passed: as NumPy says")
