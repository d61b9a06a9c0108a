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
BANKS = [pytest.param(ReadAddWrite, mutant, id=f"bank-{mutant}") for mutant in READ_ADD_WRITE]
BANKS += [pytest.param(TaggedBank, mutant, id=f"tagged-bank-{mutant}") for mutant in TAGGED_BANK]
#: How a mutated module is proved.
HARNESSES = {
    "bank": lambda module: ReadAddWriteHarness(module.ReadAddWrite(*ReadAddWriteTraffic.arguments)),
    "tagged-bank": lambda module: TaggedBankHarness(module.TaggedBank(tiny(6, 4))),
    "accumulator": lambda module: AccumulatorHarness(module.Accumulator(TINY)),
    "tagged-accumulator": lambda module: TaggedAccumulatorHarness(module.TaggedAccumulator(tiny(2, 2)), 1, [2]),
}
MUTANTS = dict(zip(HARNESSES, (READ_ADD_WRITE, TAGGED_BANK, ACCUMULATOR, TAGGED_ACCUMULATOR), strict=True))
PROVED = [pytest.param(name, mutant, id=f"{name}-{mutant}") for name in MUTANTS for mutant in MUTANTS[name]]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("bank", TRAFFIC, ids=lambda bank: bank.__name__)
def test_simulation_passes_the_original(bank, seed):
    assert differences(bank(*TRAFFIC[bank].arguments), TRAFFIC[bank], seed) == []


@pytest.mark.parametrize("bank, mutant", BANKS)
def test_simulation_finds(bank, mutant):
    broken = getattr(mutant.module(), bank.__name__)
    assert differences(broken(*TRAFFIC[bank].arguments), TRAFFIC[bank], seed=0)


@needs_solver
@pytest.mark.parametrize("name, mutant", PROVED)
def test_proof_finds(name, mutant, tmp_path):
    outcome = solve(HARNESSES[name](mutant.module()), "bmc", CYCLES, tmp_path)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log
