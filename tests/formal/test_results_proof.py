"""Whatever units take, and in whatever order they finish: each outcome is one result, and the last one is marked.

For batches of one to three rows, the next of which begins before one has finished, two units that finish whenever they
like, and results that wait as long as they like: enough cycles for what follows a short batch. That each row is handed
over once is tested, not proved.
"""

import pytest

from cmfpga.rtl.regions import collector
from support.formal.harness import needs_solver, solve
from support.formal.mutants import Mutant
from support.formal.results_proof import CollectorHarness

pytestmark = needs_solver
CYCLES = 26


def test_the_results():
    outcome = solve(CollectorHarness(collector), "bmc", CYCLES)
    assert outcome.status == "PASS", outcome.log


def test_what_is_proved_can_happen():
    outcome = solve(CollectorHarness(collector), "cover", CYCLES)
    assert (outcome.status, outcome.covered) == ("PASS", CollectorHarness.COVERS), outcome.log


MUTANTS = [
    Mutant(name, old, new, collector)
    for name, old, new in (
        ("last one not marked", "done + 1 >= batch", "done >= batch"),
        ("first one marked", "last.eq(done + 1 >= batch.settings.rows)", "last.eq(1)"),
        ("over too early", "(done >= batch.settings.rows)", "(done + 1 >= batch.settings.rows)"),
        ("not counted anew", "waiting.eq(0), done.eq(0)", "waiting.eq(0)"),
        ("the next batch's before", "unit.valid & (unit.payload.turn == turn)", "unit.valid"),
        ("over at once", "self.begun.eq(~waiting)", "self.begun.eq(1)"),
        ("the batch of the results before", "batch.eq(self.batch), turn.eq(self.turn)", "batch.eq(self.batch)"),
        ("another unit's outcome goes", "unit.ready.eq(chosen == number)", "unit.ready.eq(chosen != number)"),
        ("all outcomes go", "unit.ready.eq(chosen == number)", "unit.ready.eq(unit.valid)"),
        ("an outcome goes before it is taken", "with m.If(self.o.ready):", "with m.If(1):"),
    )
]


@pytest.mark.parametrize("mutant", MUTANTS, ids=str)
def test_the_proof_finds(mutant):
    outcome = solve(CollectorHarness(mutant.module()), "bmc", CYCLES)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log
