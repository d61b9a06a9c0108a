"""Ring and walker, by induction, so for any number of cycles: windows hold what was written, and b never passes e."""

import pytest

from cmfpga.rtl.sliding import ring, walker
from support.formal.harness import needs_solver, solve
from support.formal.mutants import Mutant
from support.formal.sliding_proof import PLACES, TINY, RingHarness, WalkerHarness

pytestmark = needs_solver

BLOCKS = {"ring": (RingHarness, ring, "Ring"), "walker": (WalkerHarness, walker, "Walker")}


def harness(name, module=None):
    kind, original, block = BLOCKS[name]
    return kind(getattr(module or original, block)(TINY), PLACES)


@pytest.mark.parametrize("name", BLOCKS)
def test_the_block(name):
    outcome = solve(harness(name), "prove", 12)
    assert outcome.by_induction, outcome.log


@pytest.mark.parametrize("name", BLOCKS)
def test_what_is_proved_can_happen(name):
    outcome = solve(harness(name), "cover", 24)
    assert (outcome.status, outcome.covered) == ("PASS", BLOCKS[name][0].COVERS), outcome.log


MUTANTS = [
    Mutant("read before it is written", "(address_s1 != self.written) & ", "", ring),
    Mutant("written at once", "self.written.eq(self.written + write.en)",
           "self.written.eq(self.written + self.i.valid)", ring),
    Mutant("written over", "write.addr.eq(write.addr + write.en)", "write.addr.eq(write.addr)", ring),
    Mutant("the place after", "Mux(reading_s1, address_s1,", "Mux(reading_s1, next_s1,", ring),
    Mutant("goes on after the last", "reading_s1.eq(~last_s1)", "reading_s1.eq(1)", ring),
    Mutant("b passes e", "drops.eq(some & ", "drops.eq(1 & ", walker),
    Mutant("an event too many", "(held > most)", "(held > most + 1)", walker),
    Mutant("dither of the window before", "phase.eq(factor // 2)", "phase.eq(phase)", walker),
]  # fmt: skip


@pytest.mark.parametrize("mutant", MUTANTS, ids=str)
def test_the_proof_finds(mutant):
    name = next(name for name, (_, module, _) in BLOCKS.items() if module is mutant.original)
    outcome = solve(harness(name, mutant.module()), "bmc", 24)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log
