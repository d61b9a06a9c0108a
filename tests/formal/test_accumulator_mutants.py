"""Neither the proofs nor the simulation of the accumulators pass what is broken."""

import pytest

from cmfpga.rtl.image.accumulator import ReadAddWrite
from cmfpga.rtl.image.tagged_accumulator import TaggedBank
from support.formal.accumulator_proof import TINY, AccumulatorHarness, TaggedAccumulatorHarness, tiny
from support.formal.bank_proof import ReadAddWriteHarness, TaggedBankHarness
from support.formal.bank_simulation import ReadAddWriteTraffic, TaggedTraffic, differences
from support.formal.harness import needs_solver, solve
from support.formal.mutants import ACCUMULATOR, READ_ADD_WRITE, TAGGED_ACCUMULATOR, TAGGED_BANK

# Every counterexample is shorter.
CYCLES = 14

TRAFFIC = {ReadAddWrite: ReadAddWriteTraffic(), TaggedBank: TaggedTraffic()}
#: How a mutated module is proved.
HARNESSES = [
    (READ_ADD_WRITE, lambda module: ReadAddWriteHarness(module.ReadAddWrite(*ReadAddWriteTraffic.arguments))),
    (TAGGED_BANK, lambda module: TaggedBankHarness(module.TaggedBank(tiny(6, 4)))),
    (ACCUMULATOR, lambda module: AccumulatorHarness(module.Accumulator(TINY))),
    (TAGGED_ACCUMULATOR, lambda module: TaggedAccumulatorHarness(module.TaggedAccumulator(tiny(2, 2)), 1, [2])),
]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("bank", TRAFFIC)
def test_simulation_passes_the_original(bank, seed):
    assert differences(bank(*TRAFFIC[bank].arguments), TRAFFIC[bank], seed) == []


@pytest.mark.parametrize(
    "bank, mutant", [(ReadAddWrite, m) for m in READ_ADD_WRITE] + [(TaggedBank, m) for m in TAGGED_BANK], ids=str
)
def test_simulation_finds(bank, mutant):
    broken = getattr(mutant.module(), bank.__name__)
    assert differences(broken(*TRAFFIC[bank].arguments), TRAFFIC[bank], seed=0)


@needs_solver
@pytest.mark.parametrize("mutant, harness", [(m, harness) for all_, harness in HARNESSES for m in all_], ids=str)
def test_proof_finds(mutant, harness, tmp_path):
    outcome = solve(harness(mutant.module()), "bmc", CYCLES, tmp_path)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log
