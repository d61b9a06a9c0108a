"""The accumulators' forwarding is right whatever a RAM returns on a collision, and no vote sees a stale word.

Proved by k-induction, so for any number of cycles: a bank for any operations in any cycle, with any tags; an
accumulator for any votes and sweeps, or iterations that keep the rule of the idle cycles, after one pass of the sweep
over RAMs that hold anything. One row that the solver chooses is followed. Small words and few rows stand for all
others, because addresses are only compared, and words only added and handed on, in the same way at every width; one
bank of each is proved at its preset's size all the same, and a deep one, whose words lie in several RAMs.
"""

import pytest
from amaranth.lib import data

from cmfpga.config import preset
from cmfpga.rtl import payloads
from cmfpga.rtl.image import tagged_accumulator
from cmfpga.rtl.image.accumulator import Accumulator, ReadAddWrite
from cmfpga.rtl.image.tagged_accumulator import TaggedAccumulator, TaggedBank
from support.formal.accumulator_proof import TINY, AccumulatorHarness, TaggedAccumulatorHarness, small_bank, tiny
from support.formal.bank_proof import ReadAddWriteHarness, TaggedBankHarness
from support.formal.harness import needs_solver, solve
from support.formal.mutants import ACCUMULATOR, READ_ADD_WRITE, SLICED_MEMORY, TAGGED_ACCUMULATOR, TAGGED_BANK

pytestmark = needs_solver

# Cycles. The induction closes in 5, the length of the longer pipeline; more only lengthen the search from reset, which
# takes many minutes where words are wide.
SHORT, LONG = 6, 16


def paper_bank():
    config = preset("paper")
    vote = payloads.votes(config)["banks"].shape.elem_shape
    word = payloads.pixel(config)
    add = data.StructLayout({name: vote[name].shape for name in word.members})
    return ReadAddWriteHarness(ReadAddWrite(word, add, config.geometry.bank_depth))


def in_turn(config):
    """A configuration's rounds by one evaluator: four images in the same memories."""
    return config.replace(ascent="newton", border="whole", v_frac=max(2, config.v_frac), cold="0:1:1", warm="0:1:1")


# Configuration and the rule's own minimum of idle cycles: with some to spare; with none; at the preset's size.
SWEPT = {
    "4 words": (tiny(4, 4), 2),
    "4 · 4 words": (in_turn(tiny(4, 4)), 6),
    "12 words": (tiny(5, 5), 4),
    "1024 words": (tiny(64, 64, tag_bits=8), 5),
}


def swept(name, bank, fewer=0):
    config, idle = SWEPT[name]
    assert idle == config.one_pass.fewest_idle_cycles
    return TaggedAccumulatorHarness(TaggedAccumulator(config), idle - fewer, [bank])


PROVED = {
    "bank": (lambda: small_bank(ReadAddWrite), LONG),
    "bank of paper": (paper_bank, SHORT),
    "accumulator": (lambda: AccumulatorHarness(Accumulator(TINY)), SHORT),
    "tagged bank": (lambda: TaggedBankHarness(TaggedBank(tiny(6, 4))), LONG),
    "tagged bank, no power of two": (lambda: TaggedBankHarness(TaggedBank(tiny(5, 5))), SHORT),
    "tagged bank of quad": (lambda: TaggedBankHarness(TaggedBank(preset("quad"))), SHORT),
    "tagged bank of fast": (lambda: TaggedBankHarness(TaggedBank(preset("fast"))), SHORT),
    "tagged bank of fast-128": (lambda: TaggedBankHarness(TaggedBank(preset("fast-128"))), SHORT),
    # One bank at a time, because the solver's time grows faster than their number; all four are alike.
    "tagged accumulator of 4 words": (lambda: swept("4 words", 0), SHORT),
    "its last bank": (lambda: swept("4 words", 3), SHORT),
    "tagged accumulator of 12 words": (lambda: swept("12 words", 2), SHORT),
    "tagged accumulator of four images": (lambda: swept("4 · 4 words", 3), SHORT),
    "tagged accumulator of 1024 words": (lambda: swept("1024 words", 1), SHORT),
}


@pytest.mark.parametrize("name", PROVED)
def test_right_for_any_number_of_cycles(name):
    harness, cycles = PROVED[name]
    outcome = solve(harness(), "prove", cycles)
    assert outcome.by_induction, outcome.log


@pytest.mark.parametrize("name", ["bank", "accumulator", "tagged bank", "its last bank"])
def test_hazards_can_happen_in_the_proof(name):
    harness = PROVED[name][0]()
    outcome = solve(harness, "cover", LONG)
    assert (outcome.status, outcome.covered) == ("PASS", harness.COVERS), outcome.log


def test_with_one_idle_cycle_fewer_a_stale_word_is_seen():
    outcome = solve(swept("4 words", 3, fewer=1), "bmc", LONG)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log


# Every counterexample of a mutant is shorter.
MUTANT_CYCLES = 14

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


@pytest.mark.parametrize("harness, mutant", CASES)
def test_proof_finds(harness, mutant):
    outcome = solve(harness(mutant.module()), "bmc", MUTANT_CYCLES)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log


@pytest.mark.parametrize("mutant", SLICED_MEMORY, ids=str)
def test_proof_finds_in_deep_banks(mutant, monkeypatch):
    sliced_memory = mutant.module()
    monkeypatch.setattr(sliced_memory, "SHALLOW", 4)
    monkeypatch.setattr(tagged_accumulator, "memory_of", sliced_memory.memory_of)
    harness = TaggedBankHarness(tagged_accumulator.TaggedBank(tiny(6, 4)))
    outcome = solve(harness, "bmc", MUTANT_CYCLES)
    assert outcome.status == "FAIL" and outcome.step is not None, outcome.log
