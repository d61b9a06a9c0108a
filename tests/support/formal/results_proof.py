"""The properties of a batch's results: one of each outcome, with its own number, the last one marked, in any order."""

from amaranth.asserts import AnyConst, AnySeq
from amaranth.hdl import Assert, Assume, Cat, Cover, Mux, Signal

from support.formal.harness import FreeHarness
from support.formal.store_proof import tiny

UNITS, ROWS = 2, 3


def config():
    return tiny().replace(regions=4, units=UNITS, roi_gain=1.0, roi_gain_int=1, roi_gain_frac=0)


class CollectorHarness(FreeHarness):
    """The collector with any units: each has outcomes of any numbers, whenever it likes; results may have to wait.

    Batches have one to three rows. The next one begins when all of one were handed over, before they have finished.
    """

    COVERS = 4

    def __init__(self, module):
        super().__init__(module.Collector(config()))

    def properties(self, m):
        dut = self.dut
        rows, begun, turn, wanted = Signal(range(ROWS + 1)), Signal(), Signal(), Signal(init=1)
        result, taken = dut.o.payload, dut.o.valid & dut.o.ready
        given, done, batches = (Signal(range(ROWS + 1), name=name) for name in ("given", "done", "batches"))
        under_way = Signal(range(4))  # batches
        m.d.comb += [
            rows.eq(AnyConst(len(rows))),
            Assume((rows >= 1) & (rows <= ROWS)),
            dut.batch.settings.rows.eq(rows),
            dut.o.ready.eq(AnySeq(1)),
            # A batch begins at once, and the next one when all of this one were handed over.
            dut.begins.eq(~begun | (AnySeq(1) & dut.begun & (given == rows) & (batches < ROWS))),
            dut.turn.eq(turn ^ dut.begins),
        ]
        m.d.sync += [begun.eq(1), turn.eq(dut.turn)]
        offers, matches, units, works, turns = [], [], dut.units, [], []
        for number, unit in enumerate(units):
            works.append(Signal(name=f"works_{number}"))
            turns.append(Signal(name=f"turn_{number}"))  # that of the batch in which it was handed over
            key = Signal(4, name=f"key_{number}")  # region, and a mark
            starts, ripe = Signal(name=f"starts_{number}"), Signal(name=f"ripe_{number}")
            offers.append(starts)
            m.d.comb += [
                starts.eq(AnySeq(1) & ~works[-1] & begun),
                unit.valid.eq(ripe),
                unit.payload.turn.eq(turns[-1]),
                Cat(unit.payload.number, unit.payload.roi_events).eq(key),
                Assert(~unit.ready | (unit.valid & taken)),
            ]
            with m.If(starts):
                m.d.sync += [works[-1].eq(1), turns[-1].eq(turn), key.eq(AnySeq(len(key)))]
            with m.Elif(unit.ready):
                m.d.sync += [works[-1].eq(0), ripe.eq(0)]
            with m.Elif(works[-1] & AnySeq(1)):
                m.d.sync += ripe.eq(1)
            matches.append(unit.ready & (Cat(result.region, result.roi_events) == key) & (turns[-1] == wanted))
        # The distributor hands over no more than a batch has.
        total, last = Signal(range(ROWS + UNITS + 1)), taken & (done + 1 == rows)
        m.d.comb += [total.eq(given + sum(offers)), Assume(total <= rows), Assume(~dut.begins | ~Cat(*offers).any())]
        m.d.sync += [given.eq(total), under_way.eq(under_way + dut.begins - last)]
        with m.If(dut.begins):
            m.d.sync += [given.eq(0), batches.eq(batches + 1)]
        with m.If(taken):
            m.d.sync += [done.eq(Mux(last, 0, done + 1)), wanted.eq(wanted ^ last)]
        waited, before, alone = Signal(), Signal(1 + len(result.region)), Signal(2)
        now, both = Cat(result.last, result.region), Cat(unit.valid for unit in units).all()
        m.d.sync += [waited.eq(dut.o.valid & ~dut.o.ready), before.eq(now)]
        m.d.sync += alone.eq(Mux(dut.begins, 0, Cat(under_way <= 1, alone[0])))
        m.d.comb += [
            # One unit's, its own, and of no later batch.
            Assert(~taken | (Cat(*matches).any() & (sum(unit.ready for unit in units) == 1))),
            Assert(~dut.o.valid | (result.last == (done + 1 == rows))),  # the last one, and no other
            Assert(~waited | (dut.o.valid & (now == before))),  # it stays as it is
            # Those before are over with the last one.
            Assert(~dut.begun | (under_way <= 1)),
            Assert(dut.begun | ~alone.all() | (under_way > 1)),
            Assert(~dut.takes_over | ((under_way == 1) & (done == 0))),
            Cover(taken & (done == 1) & result.last),
            Cover(taken & units[1].ready & both),
            Cover(taken & (batches == 2) & (under_way == 1)),
            Cover(taken & units[1].ready & both & (turns[0] != turns[1])),  # the lower one is of the next batch
        ]
