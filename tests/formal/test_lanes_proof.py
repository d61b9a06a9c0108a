"""Between lanes and banks no vote is lost or doubled, and none waits for ever.

The router is proved by k-induction, so for any number of cycles: every bank that is wanted gets exactly one head, what
is taken is given, and a head waits for fewer cycles than there are lanes. A queue of four words, in place of sixteen,
is checked for any votes and stalls of the first cycles: enough to fill it, to empty it and to go round.
"""

import pytest

from cmfpga.rtl.image.lanes import router, vote_queue
from cmfpga.rtl.image.lanes.router import Router
from support.formal.harness import needs_solver, solve
from support.formal.lanes_proof import QueueHarness, RouterHarness, tiny
from support.formal.mutants import Mutant

pytestmark = needs_solver
CYCLES = 9


def queue(module, lanes=4):
    return QueueHarness(type("ShortQueue", (module.VoteQueue,), {"depth": 4})(tiny(lanes)))


def routing(module, lanes=4):
    return RouterHarness(module.Router(tiny(lanes)))


@pytest.mark.parametrize("lanes", [2, 4, 8])
def test_the_router_for_any_number_of_cycles(lanes):
    outcome = solve(routing(router, lanes), "prove", Router.latency + 2)
    assert outcome.by_induction, outcome.log


@pytest.mark.parametrize("lanes", [2, 4])
def test_the_queue(lanes):
    outcome = solve(queue(vote_queue, lanes), "bmc", CYCLES)
    assert outcome.status == "PASS", outcome.log


@pytest.mark.parametrize("harness", [queue(vote_queue), routing(router)], ids=["queue", "router"])
def test_what_is_proved_can_happen(harness):
    outcome = solve(harness, "cover", CYCLES)
    assert (outcome.status, outcome.covered) == ("PASS", harness.COVERS), outcome.log


MUTANTS = [
    Mutant("two heads given", "eq(wanted[lane] & ~taken)", "eq(wanted[lane])", router),
    Mutant("turn ignored", "select(self.turn[half], [", "select(0 * self.turn[half], [", router),
    Mutant("taken, not given", "Cat(given[lane][half::2]).any()", "Cat(given[lane]).any()", router),
    Mutant("head of another lane", "if lane >> bit & 1", "if lane >> bit & 1 or lane == 1", router),
    Mutant("a vote too many", "behind[2:].all()", "behind[2:].all() & behind[1]", vote_queue),
    Mutant("head lost", "load.eq(waits & (self.taken | ~self.wants.any()))", "load.eq(waits)", vote_queue),
    Mutant("head again", "with m.Elif(self.taken):", "with m.Elif(self.taken & self.full):", vote_queue),
    Mutant("empty early", "self.empty.eq(~waits & ~self.wants.any())", "self.empty.eq(~waits)", vote_queue),
    Mutant("number stays", "m.If(self.i.valid ^ load)", "m.If(self.i.valid ^ (load & ~self.taken))", vote_queue),
    Mutant("last one forgotten", "~load | (behind != 0)", "~load | (behind > 1)", vote_queue),
    Mutant("added for nobody", "with m.If(~found):", "with m.If(0):", router),
    Mutant("address stays", "write.addr.eq(self._next(write.addr))", "write.addr.eq(write.addr)", vote_queue),
]


@pytest.mark.parametrize("mutant", MUTANTS, ids=str)
def test_the_proof_finds(mutant):
    harness = routing if mutant.original is router else queue
    outcome = solve(harness(mutant.module()), "bmc", CYCLES)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log
