"""The properties of the ring and of the walker: a word of a window is the one that was written, b never passes e."""

from amaranth.hdl import Assert, Assume, Cat, Cover, Mux, Signal

from cmfpga.config import Config
from cmfpga.config.dither import FACTORS
from support.formal.bank_proof import anything
from support.formal.harness import Harness

#: Eight places.
TINY = Config(roi_width=4, roi_height=4, sensor_width=4, sensor_height=4, buffer_events=7, span_bits=4, time_bits=8)
PLACES = 8


class RingHarness(Harness):
    """Any events, replays, ends and pauses; no event comes whose place a replay has still to read.

    One place that the solver chooses is followed: what was written there last.
    """

    COVERS = 3
    any_content = True

    def properties(self, m, row, memories):
        dut, (memory,) = self.dut, memories
        word = memory.read.data.shape()
        # Which the induction has to be told about. These names are not part of the interface.
        reading, address, following = (self.register(name) for name in ("reading_s1", "address_s1", "next_s1"))
        held, some, another, told = (self.register(name) for name in ("held", "some", "more", "ends"))
        goes, last = (self.register(name, "comb") for name in ("goes", "last_s1"))
        gone = self.register("goes_s1")
        stored = Signal(range(PLACES))  # place of the event that comes
        m.d.sync += stored.eq(stored + dut.i.valid)
        free = dut.i.valid, dut.i.payload.as_value(), dut.replay, dut.first, dut.closed, dut.end, dut.room, dut.look
        after = (stored + 1)[: len(stored)]
        was = [Signal(name=f"was_{n}", init=1) for n in range(2)]  # reading, one and two cycles ago
        firsts = [Signal.like(dut.first, name=f"first_{n}") for n in range(2)]
        ended = [Signal.like(dut.end, name=f"end_{n}") for n in range(2)]
        m.d.comb += [
            *map(anything, free),
            Assume(~dut.replay | ~(reading | Cat(was).any())),
            # What is right before it is told.
            Assume(~dut.replay | ((dut.first == firsts[0]) & (firsts[0] == firsts[1]))),
            Assume(~dut.closed | (dut.end == ended[0])),
            # A replay begins among what can be read, or right behind it.
            Assume(~(dut.replay & memory.write.en) | (dut.first != stored)),
            Assume(~(dut.i.valid & reading) | (after != address)),
            Assume(~(dut.i.valid & dut.replay) | (after != dut.first)),
            Assert(stored == (dut.written + memory.write.en)[: len(stored)]),
            Assert(self.register("stored") == stored),
            Assert(~reading | (following == (address + 1)[: len(address)])),
            Assert(~reading | (told == (following == ended[1]))),
        ]
        for line, value in ((was, reading), (firsts, dut.first), (ended, dut.end)):
            m.d.sync += [line[0].eq(value), line[1].eq(line[0])]

        # A replay never passes what was written: counted, and not the difference of two places.
        ahead = Signal(range(2 * PLACES))  # events that can be read and have not been
        more = memory.write.en
        was_over = Signal()  # a cycle ago the window was known to be empty
        m.d.sync += was_over.eq(self.register("closed") & self.register("empty_s1"))
        with m.If(dut.replay):
            m.d.sync += ahead.eq((dut.written - dut.first)[: len(address)] + more)
        with m.Elif(reading):
            m.d.sync += ahead.eq(ahead + more - goes)
        m.d.comb += [
            Assert(~reading | (ahead < PLACES)),
            Assert(~reading | (ahead == (dut.written - address)[: len(address)])),
            Assert(~reading | ((held == ahead) & (some == ((ahead != 0) & ~was_over)) & (another == (ahead > 1)))),
            Assert(~reading | ~more | (ahead < PLACES - 1)),
            Assert(~goes | (ahead != 0)),
        ]

        # What was written to that place last, before it is in the memory and while it is read. A register starts at a
        # constant, so it holds the difference from the first word.
        difference, wanted, out = Signal(word.size), [Signal(word.size) for _ in range(2)], [Signal() for _ in range(2)]
        shadow = memory.first ^ difference
        with m.If(dut.i.valid & (stored == row)):
            m.d.sync += difference.eq(memory.first ^ dut.i.payload.as_value())
        m.d.sync += [
            out[0].eq(goes & (address == row)),
            out[1].eq(out[0]),
            wanted[0].eq(shadow),
            wanted[1].eq(wanted[0]),
        ]
        event = {name: dut.o.payload[name] for name in word.members}
        found = Signal(word)
        m.d.comb += [found[name].eq(value) for name, value in event.items()]
        written = memory.write.data.as_value()
        m.d.comb += [
            Assert(Mux(memory.written, written, memory.content.as_value()) == shadow),
            Assert(~out[0] | (memory.read.data.as_value() == wanted[0])),
            Assert(~out[1] | (dut.o.valid & (found.as_value() == wanted[1]))),
            Assert(~out[0] | gone),
        ]

        # The last one is that before the end, and ends the replay.
        ends, closed = Signal(), Signal()
        m.d.sync += closed.eq(dut.closed)
        m.d.comb += ends.eq(goes & closed & (following == ended[0]))
        line = [Signal(2, name=f"ended_{n}") for n in range(2)]
        m.d.sync += [line[0].eq(Cat(goes, ends)), line[1].eq(line[0])]
        began = Signal()
        m.d.sync += began.eq(dut.replay)
        m.d.comb += [
            Assert(~line[0][1] | ~reading | began),
            Assert(line[0][0] == gone),
            Assert(~line[0][0] | (self.register("last_s1") == line[0][1])),
            Assert(dut.o.valid == line[1][0]),
            Assert(~line[1][0] | (dut.o.payload.last == line[1][1])),
        ]
        # Of an empty window nothing goes, though the next hop's events may be there. None comes right behind a hop.
        shut = [Signal(name=f"shut_{n}", init=1) for n in range(2)]  # so many cycles ago, one and two
        m.d.sync += [shut[0].eq(dut.closed), shut[1].eq(shut[0])]
        m.d.comb += [
            Assume(~(dut.closed & ~shut[0]) | (dut.end == stored)),
            Assume(~(dut.closed & ~shut[1]) | ~dut.i.valid),
            Assert(~(goes & dut.closed & shut[0]) | (address != dut.end)),
        ]
        waits = Signal()
        with m.If(dut.replay):
            m.d.sync += waits.eq(0)
        with m.Elif(reading & dut.room & ~goes):
            m.d.sync += waits.eq(1)
        m.d.comb += [
            Cover(goes & waits & (address == 0) & last),  # it waited, and went on from the last place to the first
            Cover(out[1] & (found.as_value() != memory.first)),
            Cover(reading & (ahead == PLACES - 1)),
        ]


class WalkerHarness(Harness):
    """Any ends, lengths, and times of events."""

    COVERS = 2

    def properties(self, m, row, memories):
        dut = self.dut
        held, walking, ahead = self.register("held"), self.register("walking"), self.register("ahead")
        counts, over = self.register("counts"), self.register("over")
        lengths, end, before, behind = dut.lengths, Signal.like(dut.end), Signal.like(dut.begin), Signal.like(dut.begin)
        told, ready, most = Signal(), Signal(), Signal.like(dut.begin)
        m.d.comb += [
            *map(anything, (dut.closed, dut.go, dut.end, dut.now, dut.stale, lengths.as_value(), dut.t)),
            Assume(~dut.closed | ~(told | walking)),
            Assume(~dut.go | ready),
            Assume(lengths.hop_events <= lengths.window_events),
        ]
        m.d.sync += [before.eq(ahead), behind.eq(dut.begin), told.eq((told | dut.closed) & ~dut.go)]
        m.d.sync += ready.eq(told & ~dut.go)
        with m.If(dut.closed):
            m.d.sync += [end.eq(dut.end), most.eq(lengths.window_events - lengths.hop_events)]
        moved = Signal.like(dut.begin)
        m.d.comb += [
            moved.eq(ahead - before),
            Assert(told | walking | (ahead == dut.begin)),
            Assert(dut.done | (dut.begin == behind)),  # b does not change but when all is known
            Assert(~(told | walking) | (held == (end - ahead)[: len(end)])),
            Assert(~counts | told),
            Assert(~counts | ((over == (held > most)) & (self.register("more") == most + 1))),
            Assert(~(told | walking) | (self.register("most") == most)),
            Assert(~dut.done | (held == (end - dut.begin)[: len(end)])),
            Assert(~dut.done | (dut.empty == (held == 0))),
            Assert(~dut.done | (held <= most)),  # no more than leave room for the hop
            *(
                Assert(~(dut.done & dut.empty) | (phase == factor // 2))
                for phase, factor in zip((dut.phase_x, dut.phase_y), FACTORS, strict=True)
            ),
        ]
        # b moves by one event, and never past e.
        left = Signal(range(PLACES))
        with m.If(dut.closed):
            m.d.sync += left.eq((dut.end - ahead)[: len(end)])
        with m.Else():
            m.d.sync += left.eq(held)
        m.d.comb += [
            Assert(moved <= 1),
            Assert(~(moved == 1) | (left != 0)),
            Cover(dut.done & ~dut.empty & (dut.begin == 5)),
            Cover(dut.done & dut.empty & (end == 6)),
        ]
