"""Proofs of four blocks: that they hold, that what they are about can happen, and that they find what is broken.

Collector: whatever units take, and in whatever order they finish, each outcome is one result, and the last one is
marked. For batches of one to three rows, the next of which begins before one has finished, two units that finish
whenever they like, and results that wait as long as they like: enough cycles for what follows a short batch. That each
row is handed over once is tested, not proved.

Store: no event is lost, none comes twice, and those of a bin come in the order in which they came. For up to four
events in either bin, in any of five cycles, and bins read in either order; pages of two events, so that they are
linked. Enough cycles to fill the store, and to read all of it.

Ring and walker, by induction, so for any number of cycles: windows hold what was written, and b never passes e.
"""

import pytest

from cmfpga.rtl.regions import collector, store
from cmfpga.rtl.sliding import ring, walker
from support.formal.harness import needs_solver, solve
from support.formal.mutants import Mutant
from support.formal.results_proof import CollectorHarness
from support.formal.sliding_proof import PLACES, TINY, RingHarness, WalkerHarness
from support.formal.store_proof import StoreHarness, half_of
from support.mutation import mutated

pytestmark = needs_solver


def store_harness(module):
    """Of a copy of the module, whose constants it changes."""
    return StoreHarness(half_of(mutated(store, "SLOT_BITS = ", "SLOT_BITS = ") if module is store else module))


#: By module: harness of it or of a mutant, what is proved in how many cycles, and cycles in which all can happen.
PROOFS = {
    collector: (CollectorHarness, "bmc", 26, 26, CollectorHarness.COVERS),
    store: (store_harness, "bmc", 30, 30, StoreHarness.COVERS),
    ring: (lambda module: RingHarness(module.Ring(TINY), PLACES), "prove", 12, 24, RingHarness.COVERS),
    walker: (lambda module: WalkerHarness(module.Walker(TINY), PLACES), "prove", 14, 24, WalkerHarness.COVERS),
}
MODULES = [pytest.param(module, id=module.__name__.rpartition(".")[2]) for module in PROOFS]


@pytest.mark.parametrize("module", MODULES)
def test_the_block(module):
    harness, mode, cycles, *_ = PROOFS[module]
    outcome = solve(harness(module), mode, cycles)
    assert outcome.by_induction if mode == "prove" else outcome.status == "PASS", outcome.log


@pytest.mark.parametrize("module", MODULES)
def test_what_is_proved_can_happen(module):
    harness, _, _, cycles, covers = PROOFS[module]
    outcome = solve(harness(module), "cover", cycles)
    assert (outcome.status, outcome.covered) == ("PASS", covers), outcome.log


MUTANTS = [
    Mutant("last one not marked", "done + 1 >= batch", "done >= batch", collector),
    Mutant("first one marked", "last.eq(done + 1 >= batch.settings.rows)", "last.eq(1)", collector),
    Mutant("over too early", "(done >= batch.settings.rows)", "(done + 1 >= batch.settings.rows)", collector),
    Mutant("not counted anew", "waiting.eq(0), done.eq(0)", "waiting.eq(0)", collector),
    Mutant("the next batch's before", "unit.valid & (unit.payload.turn == turn)", "unit.valid", collector),
    Mutant("over at once", "self.begun.eq(~waiting)", "self.begun.eq(1)", collector),
    Mutant("the batch of the results before", "batch.eq(self.batch), turn.eq(self.turn)", "batch.eq(self.batch)",
           collector),
    Mutant("another unit's outcome goes", "unit.ready.eq(chosen == number)", "unit.ready.eq(chosen != number)",
           collector),
    Mutant("all outcomes go", "unit.ready.eq(chosen == number)", "unit.ready.eq(unit.valid)", collector),
    Mutant("an outcome goes before it is taken", "with m.If(self.o.ready):", "with m.If(1):", collector),
    Mutant("pages never linked", "stored & fresh & (before.count != 0)", "stored & fresh & 0", store),
    Mutant("first page of another bin", 'write["head"].addr.eq(address)', 'write["head"].addr.eq(0)', store),
    Mutant("page given twice", "m.d.sync += bins.page.eq(bins.page + 1)", "m.d.sync += bins.page.eq(0)", store),
    Mutant("page of the operation before", "allocated = delay(m, bins.page, 1,", "allocated = delay(m, bins.page, 2,",
           store),
    Mutant("an event too few", "count.eq(of_bin - 2)", "count.eq(of_bin - 3)", store),
    Mutant("an event too many", "count.eq(of_bin - 2)", "count.eq(of_bin - 1)", store),
    Mutant("idle too early", "looking | known | walking | flying | self.o.valid", "looking | known", store),
    Mutant("read before it is written", " & some & (", " & (", ring),
    Mutant("counted late", "stored.eq(stored + self.i.valid)", "stored.eq(stored + write.en)", ring),
    Mutant("written over", "write.addr.eq(write.addr + write.en)", "write.addr.eq(write.addr)", ring),
    Mutant("the place after", "Mux(reading_s1, address_s1,", "Mux(reading_s1, next_s1,", ring),
    Mutant("goes on after the last", "If((goes & last_s1) | ", "If(", ring),
    Mutant("an event of the next hop in an empty window", " & ~over)", ")", ring),
    Mutant("b passes e", "looked & some & (", "looked & (", walker),
    Mutant("told before it is complete", "self.begin.eq(ahead)", "self.begin.eq(ahead + 1)", walker),
    Mutant("an event more than fit", "(held > most)", "(held > most + 1)", walker),
    Mutant("dither of the window before", "phase.eq(factor // 2)", "phase.eq(phase)", walker),
]  # fmt: skip


@pytest.mark.parametrize("mutant", MUTANTS, ids=str)
def test_the_proof_finds(mutant):
    harness, _, _, cycles, _ = PROOFS[mutant.original]
    outcome = solve(harness(mutant.module()), "bmc", cycles)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log
