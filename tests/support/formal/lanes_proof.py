"""The properties of what is between lanes and banks: no vote is lost or doubled, and none waits for ever."""

from amaranth.asserts import AnySeq
from amaranth.hdl import Assert, Assume, Cat, ClockDomain, Const, Cover, Elaboratable, Module, Mux, Signal, Value

from cmfpga.config import Config
from cmfpga.rtl.arithmetic import delay
from cmfpga.rtl.image.lanes.router import Router
from support.formal.bank_proof import anything


def tiny(lanes):
    """Votes of a few bits."""
    return Config(
        gradient="one_pass", lanes=lanes, roi_width=4, roi_height=4, buffer_events=3, weight_frac=1, derivative_frac=1
    )


class Harness(Elaboratable):
    """A block whose inputs are free; its memories start with anything and are read as they are written."""

    platform = None

    def __init__(self, dut):
        self.dut = dut
        self.sync = ClockDomain("sync", reset_less=True)

    def elaborate(self, platform):
        m = Module()
        m.domains.sync = self.sync
        m.submodules.dut = self.dut
        self.properties(m)
        return m


class RouterHarness(Harness):
    """Any heads, each of which wants one bank at most, and stays until it is given; the turn goes round."""

    COVERS = 1

    def properties(self, m):
        dut, lanes = self.dut, range(self.dut.config.lanes)
        turn = Signal(range(len(lanes)))
        m.d.sync += turn.eq(turn + 1)
        m.d.comb += [dut.turn.eq(Cat(turn, turn)), anything(dut.wants.as_value()), anything(dut.heads.as_value())]
        before, given_to = {}, []
        for lane in lanes:
            for half in range(2):
                wants, head, taken = dut.wants[lane][half], dut.heads[lane][half].as_value(), dut.taken[lane][half]
                kept, last = (
                    Signal.like(wants, name=f"kept_{lane}_{half}"),
                    Signal(len(head), name=f"last_{lane}_{half}"),
                )
                m.d.sync += [kept.eq(Mux(taken, 0, wants)), last.eq(head)]
                m.d.comb += [
                    Assume((wants & (wants - 1)[: len(wants)]) == 0),
                    Assume((kept == 0) | ((wants == kept) & (head == last))),
                    Assert(~taken | wants.any()),  # nothing comes from nowhere
                ]
                # Since its lane's turn, which comes within as many cycles as there are lanes; this needs no look back.
                waited = Signal(range(len(lanes) + 1), name=f"waited_{lane}_{half}")
                m.d.sync += waited.eq(Mux(wants.any() & ~taken, waited + 1, 0))
                m.d.comb += Assert(waited <= (turn - lane - 1)[: len(turn)])
                before[lane, half] = wants, head, taken
        for bank, o in enumerate(dut.o):
            half, number = bank & 1, bank >> 1
            given = [before[lane, half][0][number] & before[lane, half][2] for lane in lanes]
            wanted = Cat(before[lane, half][0][number] for lane in lanes).any()
            m.d.comb += [
                Assert(sum(given, Const(0, 4)) == wanted),  # one where one is wanted, and no other
            ]
            expected, valid = Signal(o.shape(), name=f"expected_{bank}"), Signal(name=f"valid_{bank}")
            given_to.append(valid)
            chosen = 0
            for lane in lanes:
                chosen |= Mux(given[lane], before[lane, half][1], 0)
            chosen, wanted = (
                delay(m, each, Router.latency - 1, name=f"{name}_{bank}", valid=True)
                for each, name in ((chosen, "chosen"), (wanted, "was_wanted"))
            )
            m.d.sync += [expected.eq(chosen), valid.eq(wanted)]
            # What nobody gives adds nothing, wherever.
            m.d.comb += Assert((o.add == expected.add) & (~valid | (o.address == expected.address)))
        m.d.comb += Cover(Cat(given_to).all())


class QueueHarness(Harness):
    """Any votes, as long as it was not full two cycles ago, taken whenever; one that the solver chooses is followed."""

    COVERS = 2

    def properties(self, m):
        dut = self.dut
        soon, room, inside = Signal(init=1), Signal(init=1), Signal(range(dut.depth + 3))
        present = dut.wants.any()
        vote = dut.i.payload
        m.d.sync += [soon.eq(~dut.full), room.eq(soon), inside.eq(inside + dut.i.valid - dut.taken)]
        m.d.comb += [
            anything(dut.i.valid),
            anything(vote.as_value()),
            anything(dut.taken),
            Assume(~dut.i.valid | room),
            Assume(~dut.taken | present),
            Assert(inside <= dut.depth),
            Assert(dut.empty == (inside == 0)),
        ]
        # Where a vote is, there is a head a cycle later.
        came = Signal()
        m.d.sync += came.eq((inside - dut.taken) != 0)
        m.d.comb += Assert(~came | present)

        chosen, gone, ahead = Signal(), Signal(), Signal.like(inside)
        followed = Signal.like(Value.cast(vote))
        pick = Signal()
        m.d.comb += pick.eq(AnySeq(1) & dut.i.valid & ~chosen)
        with m.If(pick):
            m.d.sync += [chosen.eq(1), ahead.eq(inside - dut.taken), followed.eq(vote)]
        with m.Elif(dut.taken & chosen & ~gone):
            m.d.sync += [ahead.eq(ahead - 1), gone.eq(ahead == 0)]
        wanted = Signal(vote.shape())
        m.d.comb += wanted.eq(followed)
        bank = wanted.bank if len(Value.cast(wanted.bank)) else Const(0, 1)
        with m.If(present & chosen & ~gone & (ahead == 0)):
            m.d.comb += Assert((dut.head == wanted.operation) & (dut.wants == (1 << bank)[: len(dut.wants)]))
        m.d.comb += [Cover(inside == dut.depth), Cover(gone & (inside == 0) & (followed != 0))]
