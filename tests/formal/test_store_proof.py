"""In the store no event is lost, none comes twice, and those of a bin come in the order in which they came.

For up to four events in either bin, in any of five cycles, and bins read in either order; pages of two events, so that
they are linked. Enough cycles to fill the store, and to read all of it.
"""

import pytest

from cmfpga.rtl.regions import store
from support.formal.harness import needs_solver, solve
from support.formal.mutants import Mutant
from support.formal.store_proof import StoreHarness, half_of
from support.mutation import mutated

pytestmark = needs_solver
CYCLES = 30


def harness(module=None):
    return StoreHarness(half_of(module or mutated(store, "SLOT_BITS = ", "SLOT_BITS = ")))


def test_the_store():
    outcome = solve(harness(), "bmc", CYCLES)
    assert outcome.status == "PASS", outcome.log


def test_what_is_proved_can_happen():
    outcome = solve(harness(), "cover", CYCLES)
    assert (outcome.status, outcome.covered) == ("PASS", StoreHarness.COVERS), outcome.log


MUTANTS = [
    Mutant("pages never linked", "stored & fresh & (before.count != 0)", "stored & fresh & 0", store),
    Mutant("first page of another bin", 'write["head"].addr.eq(address)', 'write["head"].addr.eq(0)', store),
    Mutant("page given twice", "m.d.sync += bins.page.eq(bins.page + 1)", "m.d.sync += bins.page.eq(0)", store),
    Mutant("page of the operation before", "allocated = delay(m, bins.page, 1,", "allocated = delay(m, bins.page, 2,",
           store),
    Mutant("an event too few", "count.eq(of_bin - 2)", "count.eq(of_bin - 3)", store),
    Mutant("an event too many", "count.eq(of_bin - 2)", "count.eq(of_bin - 1)", store),
    Mutant("idle too early", "looking | known | walking | flying | self.o.valid", "looking | known", store),
]  # fmt: skip


@pytest.mark.parametrize("mutant", MUTANTS, ids=str)
def test_the_proof_finds(mutant):
    outcome = solve(harness(mutant.module()), "bmc", CYCLES)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log
