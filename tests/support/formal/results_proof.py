"""The properties of a batch's results: one of each outcome, with its own number, the last one marked, in any order."""

from amaranth.asserts import AnyConst, AnySeq
from amaranth.hdl import Assert, Assume, Cat, Cover, Signal

from support.formal.lanes_proof import Harness
from support.formal.store_proof import tiny

UNITS, ROWS = 2, 3


def config():
    return tiny().replace(regions=4, units=UNITS, roi_gain=1.0, roi_gain_int=1, roi_gain_frac=0)


class CollectorHarness(Harness):
    """The collector with any units: each has outcomes of any numbers, whenever it likes; results may have to wait.

    Batches have one to three rows. What a batch's last outcome is followed by is the next batch's, which begins later.
    """

    COVERS = 3

    def __init__(self, module):
        super().__init__(module.Collector(config()))

    def properties(self, m):
        dut = self.dut
        rows, begun = Signal(range(ROWS + 1)), Signal()
        result, taken = dut.o.payload, dut.o.valid & dut.o.ready
        given, done, batches = (Signal(range(ROWS + 1), name=name) for name in ("given", "done", "batches"))
        m.d.comb += [
            rows.eq(AnyConst(len(rows))),
            Assume((rows >= 1) & (rows <= ROWS)),
            dut.batch.settings.rows.eq(rows),
            dut.o.ready.eq(AnySeq(1)),
            # A batch begins at once, and the next one when all of this one were taken.
            dut.begins.eq(~begun | (AnySeq(1) & dut.finished & (given == rows) & (batches < ROWS))),
        ]
        m.d.sync += begun.eq(1)
        offers, matches, units = [], [], dut.units
        for number, unit in enumerate(units):
            works, key = Signal(name=f"works_{number}"), Signal(4, name=f"key_{number}")  # region, and a mark
            starts = Signal(name=f"starts_{number}")
            offers.append(starts)
            m.d.comb += [
                starts.eq(AnySeq(1) & ~works & begun),
                unit.valid.eq(works),
                Cat(unit.payload.number, unit.payload.roi_events).eq(key),
                Assert(~unit.ready | (unit.valid & taken)),
            ]
            with m.If(starts):
                m.d.sync += [works.eq(1), key.eq(AnySeq(len(key)))]
            with m.Elif(unit.ready):
                m.d.sync += works.eq(0)
            matches.append(unit.ready & (Cat(result.region, result.roi_events) == key))
        # The distributor hands over no more than a batch has.
        total = Signal(range(ROWS + UNITS + 1))
        m.d.comb += [total.eq(given + sum(offers)), Assume(total <= rows), Assume(~dut.begins | ~Cat(*offers).any())]
        m.d.sync += [given.eq(total), done.eq(done + taken)]
        with m.If(dut.begins):
            m.d.sync += [given.eq(0), done.eq(0), batches.eq(batches + 1)]
        waited, before = Signal(), Signal(1 + len(result.region))
        now, both = Cat(result.last, result.region), Cat(unit.valid for unit in units).all()
        m.d.sync += [waited.eq(dut.o.valid & ~dut.o.ready), before.eq(now)]
        m.d.comb += [
            Assert(
                ~taken | (Cat(*matches).any() & (sum(unit.ready for unit in units) == 1))
            ),  # one unit's, and its own
            Assert(~dut.o.valid | (result.last == (done + 1 == rows))),  # the last one, and no other
            Assert(~waited | (dut.o.valid & (now == before))),  # it stays as it is
            Assert(~begun | (dut.finished == (done == rows))),  # over with the last one
            Cover(taken & (done == 1) & result.last),
            Cover(taken & units[1].ready & both),
            Cover(taken & (batches == 2)),
        ]
