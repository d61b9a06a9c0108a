"""AXI4-Lite and AXI4-Stream: the AXI top keeps their rules, whatever masters, core and reset do (bounded proofs)."""

import types

import pytest

from cmfpga.rtl.axi import lite_slave
from cmfpga.rtl.axi.top import AxiTop
from cmfpga.rtl.shell import result_packet, skid_buffer
from support.formal.axi_proof import CONFIG, AxiHarness
from support.formal.harness import needs_solver, solve
from support.mutation import methods_of, mutated

pytestmark = needs_solver

#: Cycles of the proof: register accesses, a result and half its packet, a reset in between. 18 pass too, in minutes.
CYCLES = 10
#: Cycles until everything has happened once: a change to bypass comes last.
REACHED = 18


def test_the_rules_are_kept():
    outcome = solve(AxiHarness(), "bmc", CYCLES, search=())
    assert outcome.status == "PASS", outcome.log


def test_everything_can_happen_in_the_proof():
    outcome = solve(AxiHarness(), "cover", REACHED, search=())
    assert (outcome.status, outcome.covered) == ("PASS", AxiHarness.COVERS), outcome.log


MUTANTS = {  # block's attribute in the top, or in its shell: module, old, new
    "an answer without data": ("lite_slave", lite_slave, "both.eq(have_address & have_data", "both.eq(have_address"),
    "an answer that goes away": ("lite_slave", lite_slave, "with m.Elif(self.b.ready):", "with m.Else():"),
    "data that go away": ("lite_slave", lite_slave, "with m.Elif(self.r.ready):", "with m.Else():"),
    "a packet that goes on without being taken": (
        "result_packet", result_packet, "m.If(~self.o.valid | self.o.ready)", "m.If(~self.o.valid | self.o.valid)"
    ),
    "a packet that ends too early": (
        "result_packet", result_packet, "last.eq(sent == self.beats - 1)", "last.eq(sent == 2)"
    ),
    "ready in a reset": (
        "input", skid_buffer, "m.d.sync += self.i.ready.eq(following != 2)", "m.d.comb += self.i.ready.eq(1)"
    ),
}  # fmt: skip


def broken_top(name):
    attribute, original, old, new = MUTANTS[name]
    top = AxiTop(CONFIG)
    block = getattr(top if attribute == "lite_slave" else top.shell, attribute)
    for key, value in methods_of(mutated(original, old, new), type(block).__name__).items():
        setattr(block, key, types.MethodType(value, block))
    return top


@pytest.mark.parametrize("name", MUTANTS)
def test_the_proof_finds(name):
    outcome = solve(AxiHarness(broken_top(name)), "bmc", CYCLES)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log
