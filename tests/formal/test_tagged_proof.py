"""The tagged accumulator's forwarding is right whatever a RAM returns on a collision, and no vote sees a stale word.

Both are proved by k-induction, hence for any number of cycles: a bank for any operations with any tags; the accumulator
for any iterations that keep the rule of the idle cycles, after one pass of the sweep over RAMs that hold anything.
Small words stand for all others, because they are only added and handed on, in the same way at every width.
"""

import pytest

from cmfpga.config import preset
from cmfpga.rtl.image.tagged_accumulator import TaggedAccumulator, TaggedBank
from support.formal.harness import needs_solver, run_sby
from support.formal.tagged_proof import TaggedAccumulatorHarness, TaggedBankHarness, tiny

pytestmark = needs_solver

# Cycles. The induction closes in 4, the length of the pipeline; more only lengthen the search from reset.
SHORT = 4
LONG = 14

# The last has words of the real width.
BANKS = {"small": (tiny(6, 4), LONG), "no power of two": (tiny(5, 5), SHORT), "fast": (preset("fast"), SHORT)}

# Configuration and the rule's own minimum of idle cycles: with some to spare; with none; at the preset's size.
SWEPT = {"4 words": (tiny(4, 4), 2), "12 words": (tiny(5, 5), 4), "1024 words": (tiny(64, 64, tag_bits=8), 5)}


@pytest.mark.parametrize("name", BANKS)
def test_a_bank_is_right_for_any_number_of_cycles(name, tmp_path):
    config, cycles = BANKS[name]
    outcome = run_sby(TaggedBankHarness(TaggedBank(config)), "prove", cycles, tmp_path)
    assert outcome.by_induction, outcome.log


def test_hazards_can_happen_in_the_proof(tmp_path):
    outcome = run_sby(TaggedBankHarness(TaggedBank(tiny(6, 4))), "cover", LONG, tmp_path)
    assert (outcome.status, outcome.covered) == ("PASS", TaggedBankHarness.COVERS), outcome.log


# One bank at a time, because the solver's time grows faster than their number; all four are alike.
@pytest.mark.parametrize("name, bank", [("4 words", 0), ("4 words", 3), ("12 words", 2), ("1024 words", 1)])
def test_no_vote_ever_sees_a_stale_word(name, bank, tmp_path):
    config, idle = SWEPT[name]
    assert idle == config.one_pass.fewest_idle_cycles
    harness = TaggedAccumulatorHarness(TaggedAccumulator(config), idle, [bank])
    outcome = run_sby(harness, "prove", SHORT, tmp_path)
    assert outcome.by_induction, outcome.log


def test_tags_come_back_in_the_proof(tmp_path):
    config, idle = SWEPT["4 words"]
    outcome = run_sby(TaggedAccumulatorHarness(TaggedAccumulator(config), idle, [3]), "cover", LONG + 2, tmp_path)
    assert (outcome.status, outcome.covered) == ("PASS", TaggedAccumulatorHarness.COVERS), outcome.log


def test_with_one_idle_cycle_fewer_a_stale_word_is_seen(tmp_path):
    config, idle = SWEPT["4 words"]
    harness = TaggedAccumulatorHarness(TaggedAccumulator(config), idle - 1, [3])
    outcome = run_sby(harness, "bmc", LONG + 2, tmp_path)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log
