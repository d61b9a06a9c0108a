"""Latencies of blocks that no test of their own times: cycles from an item's entry until what comes of it stands there.

What comes out is compared with the models where these are parts of others; here, close items are timed.
"""

import pytest

from cmfpga.config import preset
from cmfpga.rtl import payloads
from cmfpga.rtl.ascent.gradient import Gradient
from cmfpga.rtl.ascent.velocity import Velocity
from cmfpga.rtl.image.accumulator import Accumulator
from cmfpga.rtl.image.gradient_reader import GradientReader
from cmfpga.rtl.image.one_pass_gradient import OnePassGradient
from cmfpga.rtl.image.tagged_accumulator import TaggedAccumulator
from support.bench import play
from support.configs import CONFIGS

ODD, QUAD = CONFIGS["odd"], preset("quad")
VOTES = {"banks": [{"valid": 1, "address": 0, "i": 1, "dx": 0, "dy": 0}] * 4, "last": 1}
WORDS = ODD.geometry.bank_words
#: Block, latency, output, inputs of the k-th item; cycles from item to item, and from each to its entry.
BLOCKS = {
    "accumulator": (
        Accumulator(ODD), 3, "o.valid", lambda k: {"sweep.valid": 1, "sweep.payload.address": k}, 1, 0,
    ),
    # P/4 addresses, the first in the cycle of ``start``; the last of them is the entry.
    "gradient reader": (
        GradientReader(ODD, accumulator_latency=3), 8, "o.valid", lambda k: {"start": 1}, WORDS, WORDS - 1,
    ),
    "tagged accumulator": (TaggedAccumulator(QUAD), 5, "o", lambda k: {"i.valid": 1, "i.payload": VOTES}, 1, 0),
    "one-pass gradient": (
        OnePassGradient(QUAD, accumulator_latency=4), 10, "o.valid",
        lambda k: {"votes.valid": 1, "votes.payload": VOTES}, 1, 0,
    ),
    "velocity": (
        Velocity(payloads.velocity(CONFIGS["default"]), target_bits=20), 1, "moved", lambda k: {"move": 1}, 1, 0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BLOCKS)
def test_latency(name):
    block, latency, out, item, every, late = BLOCKS[name]
    assert block.latency == latency
    script = [cycle for k in range(20) for cycle in (item(k), *[{}] * (every - 1))]
    taken = play(block, [*script, *[{}] * (latency + late + 5)], flows=(), watch=(out,)).watch[out]
    valid = [any(one["valid"] for one in now) if isinstance(now, list) else now for now in taken]
    assert [cycle for cycle, value in enumerate(valid) if value] == [every * k + late + latency for k in range(20)]


def test_the_plain_sums_are_final_as_early_as_the_gradient_needs_them():
    assert min(GradientReader.lead, OnePassGradient(QUAD, accumulator_latency=1).lead) >= Gradient.lead
