"""The accumulator's forwarding buffer is right whatever a RAM returns when a row is read and written at one edge.

Proved by k-induction, so for any number of cycles: any operation may come in any cycle, and one row that the solver
chooses is followed. Small words and few rows stand for all others, because addresses are only compared, and words
only added and handed on, in the same way at every width; one bank is proved at the article's size all the same.
"""

import pytest
from amaranth.hdl import signed
from amaranth.lib import data

from cmfpga.config import preset
from cmfpga.rtl import payloads
from cmfpga.rtl.image.accumulator import Accumulator, ReadAddWrite
from support.formal.accumulator_proof import TINY, AccumulatorHarness, ReadAddWriteHarness
from support.formal.harness import needs_solver, run_sby

pytestmark = needs_solver

# Cycles. The induction closes in 4, the length of the pipeline; more only lengthen the search from reset, which takes
# many minutes where words are wide.
LONG = 16
SHORT = 5


def small_bank():
    """Words that wrap after a few operations, and a depth that is no power of two."""
    word = data.StructLayout({"i": 4, "dx": signed(3)})
    add = data.StructLayout({"i": 3, "dx": signed(2)})
    return ReadAddWrite(word, add, 6)


def paper_bank():
    """One bank of the article's size."""
    config = preset("paper")
    vote = payloads.votes(config)["banks"].shape.elem_shape
    word = payloads.pixel(config)
    return ReadAddWrite(
        word, data.StructLayout({name: vote[name].shape for name in word.members}), config.geometry.bank_depth
    )


@pytest.mark.parametrize("bank, cycles", [(small_bank, LONG), (paper_bank, SHORT)], ids=["small", "paper"])
def test_forwarding_is_right_for_any_number_of_cycles(bank, cycles, tmp_path):
    outcome = run_sby(ReadAddWriteHarness(bank()), "prove", cycles, tmp_path)
    assert outcome.by_induction, outcome.log


def test_hazards_can_happen_in_the_proof(tmp_path):
    outcome = run_sby(ReadAddWriteHarness(small_bank()), "cover", LONG, tmp_path)
    assert (outcome.status, outcome.covered) == ("PASS", ReadAddWriteHarness.COVERS), outcome.log


def test_votes_and_sweeps_are_right_for_any_number_of_cycles(tmp_path):
    outcome = run_sby(AccumulatorHarness(Accumulator(TINY)), "prove", SHORT, tmp_path)
    assert outcome.by_induction, outcome.log


def test_a_sweep_right_behind_votes_can_happen_in_the_proof(tmp_path):
    outcome = run_sby(AccumulatorHarness(Accumulator(TINY)), "cover", LONG, tmp_path)
    assert (outcome.status, outcome.covered) == ("PASS", AccumulatorHarness.COVERS), outcome.log
