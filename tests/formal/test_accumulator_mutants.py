"""Neither the proof nor the simulation of the accumulator passes what is broken."""

import pytest

from cmfpga.rtl.image.accumulator import ReadAddWrite
from support.formal.accumulator_mutants import ACCUMULATOR, READ_ADD_WRITE
from support.formal.accumulator_proof import TINY, AccumulatorHarness, ReadAddWriteHarness
from support.formal.accumulator_simulation import ADD, DEPTH, WORD, model, simulate, traffic
from support.formal.harness import needs_solver, run_sby

# Every counterexample is shorter.
CYCLES = 12


def differences(dut, operations):
    """Cycles in which the answer is not the model's."""
    expected = model(operations, dut.latency)
    got = simulate(dut, operations)
    return [cycle for cycle, pair in enumerate(zip(got, expected, strict=True)) if pair[0] != pair[1]]


@pytest.mark.parametrize("seed", range(3))
def test_simulation_passes_the_original(seed):
    assert differences(ReadAddWrite(WORD, ADD, DEPTH), traffic(seed)) == []


@pytest.mark.parametrize("mutant", READ_ADD_WRITE, ids=str)
def test_simulation_finds(mutant):
    assert differences(mutant.module().ReadAddWrite(WORD, ADD, DEPTH), traffic(0))


@needs_solver
@pytest.mark.parametrize("mutant", READ_ADD_WRITE, ids=str)
def test_proof_finds(mutant, tmp_path):
    outcome = run_sby(ReadAddWriteHarness(mutant.module().ReadAddWrite(WORD, ADD, DEPTH)), "bmc", CYCLES, tmp_path)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log


@needs_solver
@pytest.mark.parametrize("mutant", ACCUMULATOR, ids=str)
def test_proof_of_the_accumulator_finds(mutant, tmp_path):
    outcome = run_sby(AccumulatorHarness(mutant.module().Accumulator(TINY)), "bmc", CYCLES, tmp_path)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log
