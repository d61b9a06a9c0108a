"""The proofs of the accumulators do not pass what is broken."""

import pytest

from cmfpga.rtl.image import tagged_accumulator
from support.formal.accumulator_proof import TINY, AccumulatorHarness, TaggedAccumulatorHarness, small_bank, tiny
from support.formal.bank_proof import TaggedBankHarness
from support.formal.harness import needs_solver, solve
from support.formal.mutants import (
    ACCUMULATOR,
    READ_ADD_WRITE,
    SLICED_MEMORY,
    TAGGED_ACCUMULATOR,
    TAGGED_BANK,
)

# Every counterexample is shorter.
CYCLES = 14

#: How a mutated module is proved.
HARNESSES = {
    "bank": (READ_ADD_WRITE, lambda module: small_bank(module.ReadAddWrite)),
    "tagged-bank": (TAGGED_BANK, lambda module: TaggedBankHarness(module.TaggedBank(tiny(6, 4)))),
    "accumulator": (ACCUMULATOR, lambda module: AccumulatorHarness(module.Accumulator(TINY))),
    "tagged-accumulator": (
        TAGGED_ACCUMULATOR, lambda module: TaggedAccumulatorHarness(module.TaggedAccumulator(tiny(2, 2)), 1, [2])
    ),
}  # fmt: skip
CASES = [
    pytest.param(harness, mutant, id=f"{name}-{mutant}")
    for name, (mutants, harness) in HARNESSES.items() for mutant in mutants
]  # fmt: skip


@needs_solver
@pytest.mark.parametrize("harness, mutant", CASES)
def test_proof_finds(harness, mutant):
    outcome = solve(harness(mutant.module()), "bmc", CYCLES)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log


@needs_solver
@pytest.mark.parametrize("mutant", SLICED_MEMORY, ids=str)
def test_proof_finds_in_deep_banks(mutant, monkeypatch):
    monkeypatch.setattr(tagged_accumulator, "SHALLOW", 4)
    monkeypatch.setattr(tagged_accumulator, "SlicedMemory", mutant.module().SlicedMemory)
    harness = TaggedBankHarness(tagged_accumulator.TaggedBank(tiny(6, 4)))
    outcome = solve(harness, "bmc", CYCLES)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log
