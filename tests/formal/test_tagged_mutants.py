"""Neither the proof nor the simulation of the tagged accumulator passes what is broken."""

import pytest

from cmfpga.rtl.image.tagged_accumulator import TaggedBank
from support.formal.harness import needs_solver, run_sby
from support.formal.tagged_mutants import ACCUMULATOR, BANK
from support.formal.tagged_proof import TaggedAccumulatorHarness, TaggedBankHarness, tiny
from support.formal.tagged_simulation import CONFIG, model, simulate, traffic

# Every counterexample is shorter.
CYCLES = 14


def differences(dut, operations):
    """Cycles in which the answer is not the model's."""
    expected = model(operations, dut.latency)
    got = simulate(dut, operations)
    return [cycle for cycle, pair in enumerate(zip(got, expected, strict=True)) if pair[0] != pair[1]]


@pytest.mark.parametrize("seed", range(3))
def test_simulation_passes_the_original(seed):
    assert differences(TaggedBank(CONFIG), traffic(seed)) == []


@pytest.mark.parametrize("mutant", BANK, ids=str)
def test_simulation_finds(mutant):
    assert differences(mutant.module().TaggedBank(CONFIG), traffic(0))


@needs_solver
@pytest.mark.parametrize("mutant", BANK, ids=str)
def test_proof_finds(mutant, tmp_path):
    outcome = run_sby(TaggedBankHarness(mutant.module().TaggedBank(tiny(6, 4))), "bmc", CYCLES, tmp_path)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log


@needs_solver
@pytest.mark.parametrize("mutant", ACCUMULATOR, ids=str)
def test_proof_of_the_accumulator_finds(mutant, tmp_path):
    harness = TaggedAccumulatorHarness(mutant.module().TaggedAccumulator(tiny(2, 2)), 1, [2])
    outcome = run_sby(harness, "bmc", CYCLES, tmp_path)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log
