"""The properties of the store of events: each event comes out once, where its bin is read, in the order of arrival."""

from amaranth.asserts import AnyConst, AnySeq
from amaranth.hdl import Assert, Assume, Cover, Signal

from cmfpga.config import Config
from support.formal.bank_proof import anything
from support.formal.lanes_proof import Harness

EVENTS = 4


def tiny():
    """Two bins, and times that number the events."""
    return Config(
        gradient="one_pass", ascent="sign", buffers=2, regions=1, bin_bits=2, sensor_width=8, sensor_height=4,
        roi_width=4, roi_height=4, max_batch_events=EVENTS, span_bits=4, time_bits=8, buffer_events=3,
        max_iterations=20,
    )  # fmt: skip


def half_of(module):
    """A half of the store with pages of two events."""
    module.PAGE_EVENTS, module.SLOT_BITS = 2, 1
    config = tiny()
    config.store.pages = (EVENTS + 2) // 2
    return module.Half(config)


class StoreHarness(Harness):
    """Cleared, filled with up to :data:`EVENTS` events whenever they come, then both bins are read, in any order."""

    COVERS = 2

    def properties(self, m):
        dut = self.dut
        event, out = dut.i.payload, dut.o.payload
        first = Signal(init=1)
        m.d.sync += first.eq(0)
        number, filled, asked = Signal(range(EVENTS + 1)), Signal(range(16)), Signal(2)
        filling, order = Signal(), Signal()
        m.d.comb += [
            dut.clear.eq(first),
            anything(dut.i.valid),
            anything(event.as_value()),
            anything(dut.read.valid),
            order.eq(AnyConst(1)),
            Assume(~dut.i.valid | (dut.cleared & ~first & filling & (number < EVENTS))),
            Assume(~dut.i.valid | ((event.x < 8) & (event.y < 4) & (event.t == number))),
            # One bin, then the other, when the last event lies where it belongs.
            Assume(~dut.read.valid | ((filled > dut.latency) & (asked < 2))),
            dut.read.payload.eq(order ^ asked[0]),
        ]
        more = Signal()  # the solver says when no event comes any more
        m.d.sync += more.eq(more | (AnySeq(1) & ~first))
        m.d.comb += filling.eq(~more)
        m.d.sync += [
            number.eq(number + dut.i.valid),
            asked.eq(asked + (dut.read.valid & dut.read.ready)),
        ]
        with m.If(more & dut.cleared & (filled != 15)):
            m.d.sync += filled.eq(filled + 1)

        # Any one event is followed.
        chosen, followed = Signal(), Signal(event.shape())
        with m.If(AnySeq(1) & dut.i.valid & ~chosen):
            m.d.sync += [chosen.eq(1), followed.eq(event)]
        seen, idle = Signal(), Signal(range(8))
        mine = Signal()
        m.d.comb += mine.eq(dut.o.valid & chosen & (out.t == followed.t))
        with m.If(mine):
            m.d.sync += seen.eq(1)
        total, last, both = Signal(range(EVENTS + 2)), Signal(range(EVENTS + 1)), Signal(2)
        which = out.x[2]
        m.d.sync += total.eq(total + dut.o.valid)
        with m.If(dut.o.valid):
            m.d.sync += [last.eq(out.t), both.eq(both | (1 << which)[:2])]
        over = Signal()
        m.d.sync += idle.eq((~dut.busy & (asked == 2)) & (idle != 7))
        m.d.comb += over.eq((asked == 2) & ~dut.busy & idle.any())
        m.d.comb += [
            Assert(~mine | (~seen & (out.as_value() == followed.as_value()))),  # once, and as it was
            Assert(~dut.o.valid | both.any() | (which == order) | (asked > 1)),
            # In the order of arrival within a bin, and one bin after the other.
            Assert(~(dut.o.valid & (both == (1 << which))) | (out.t > last)),
            Assert(~(dut.o.valid & both.all()) | ((out.t > last) & (which != order))),
            Assert(~over | ((total == number) & (seen | ~chosen))),
            Cover(over & (number == EVENTS) & both.all()),
            Cover(over & (number == EVENTS) & ~both.all() & seen),
        ]
