"""The properties of the store of events: each event comes out once, where its bin is read, in the order of arrival."""

from amaranth.asserts import AnyConst, AnySeq
from amaranth.hdl import Assert, Assume, Cat, Const, Cover, Signal

from cmfpga.config import Config
from support.formal.bank_proof import anything
from support.formal.harness import FreeHarness

EVENTS = 4


def tiny():
    """Two bins, and times that number the events."""
    return Config(
        gradient="one_pass", ascent="newton", border="whole", cold="0:1:1", warm="0:1:1", buffers=2, regions=1,
        bin_bits=2, sensor_width=8, sensor_height=4,
        roi_width=4, roi_height=4, max_batch_events=EVENTS, span_bits=4, time_bits=8, buffer_events=3,
        max_iterations=20,
    )  # fmt: skip


def half_of(module):
    """A half of the store with pages of two events."""
    module.PAGE_EVENTS, module.SLOT_BITS = 2, 1
    config = tiny()
    config.store.pages = (EVENTS + 2) // 2
    return module.Half(config)


#: The cycles in which events may come; a little later bins are asked for.
FILL = range(5, 5 + EVENTS + 1)


class StoreHarness(FreeHarness):
    """Cleared, filled with any events in any cycles of :data:`FILL`, then both bins are read, in any order."""

    COVERS = 2

    def properties(self, m):
        dut = self.dut
        event, out = dut.i.payload, dut.o.payload
        now, number, asked = Signal(range(40)), Signal(range(EVENTS + 1)), Signal(2)
        order = Signal()
        m.d.sync += [
            now.eq(now + 1),
            number.eq(number + dut.i.valid),
            asked.eq(asked + (dut.read.valid & dut.read.ready)),
        ]
        reading = (now >= FILL.stop + dut.latency) & (asked < 2)
        m.d.comb += [
            dut.clear.eq(now == 0),
            Assert((now < FILL.start) | dut.cleared),
            anything(dut.i.valid),
            Assume(~dut.i.valid | ((now >= FILL.start) & (now < FILL.stop) & (number < EVENTS))),
            event.t.eq(number),
            event.y.eq(0),
            event.x.eq(Cat(Const(0, 2), AnySeq(1))),
            order.eq(AnyConst(1)),
            dut.read.valid.eq(reading),
            dut.read.payload.eq(order ^ asked[0]),
        ]
        # Any one event is followed.
        chosen, followed, seen = Signal(), Signal(event.shape()), Signal()
        with m.If(AnySeq(1) & dut.i.valid & ~chosen):
            m.d.sync += [chosen.eq(1), followed.eq(event)]
        mine = Signal()
        m.d.comb += mine.eq(dut.o.valid & chosen & (out.t == followed.t))
        with m.If(mine):
            m.d.sync += seen.eq(1)
        total, last, both = Signal(range(EVENTS + 2)), Signal(range(EVENTS + 1)), Signal(2)
        which = out.x[2]
        m.d.sync += total.eq(total + dut.o.valid)
        with m.If(dut.o.valid):
            m.d.sync += [last.eq(out.t), both.eq(both | (1 << which)[:2])]
        over, idle = Signal(), Signal()
        m.d.sync += idle.eq(~dut.busy & (asked == 2))
        m.d.comb += over.eq(idle & ~dut.busy)
        m.d.comb += [
            Assert(~mine | (~seen & (out.as_value() == followed.as_value()))),  # once, and as it was
            # In the order of arrival within a bin, and one bin after the other.
            Assert(~dut.o.valid | both.any() | (which == order) | (asked == 2)),
            Assert(~(dut.o.valid & (both == (1 << which)[:2])) | (out.t > last)),
            Assert(~(dut.o.valid & both.all()) | ((out.t > last) & (which != order))),
            Assert(~over | ((total == number) & (seen | ~chosen))),
            Cover(over & (number == EVENTS) & both.all()),
            Cover(over & (number == EVENTS) & ~both.all() & seen),
        ]
