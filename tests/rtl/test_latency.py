"""The one convention for ``latency``: cycles from an item's entry into a block until what comes of it stands there.

What comes out is compared with the models in the blocks' own tests; here, items as close as they may be are timed.
"""

from dataclasses import dataclass, field

import pytest

from cmfpga.config import preset
from cmfpga.rtl import payloads
from cmfpga.rtl.ascent.constant import ConstantAscent
from cmfpga.rtl.ascent.gradient import Gradient
from cmfpga.rtl.ascent.newton import NewtonAscent
from cmfpga.rtl.ascent.roi_updater import RoiUpdater
from cmfpga.rtl.ascent.sign import SignAscent
from cmfpga.rtl.ascent.velocity import Velocity
from cmfpga.rtl.confidence.probe import LeastJudge, Probe
from cmfpga.rtl.confidence.verdict import Verdict
from cmfpga.rtl.core import Core
from cmfpga.rtl.image.accumulator import Accumulator
from cmfpga.rtl.image.dither import Dither
from cmfpga.rtl.image.evaluators import Evaluators
from cmfpga.rtl.image.gradient_reader import GradientReader
from cmfpga.rtl.image.one_pass_gradient import OnePassGradient
from cmfpga.rtl.image.tagged_accumulator import TaggedAccumulator
from cmfpga.rtl.image.time_scaler import TimeScaler
from cmfpga.rtl.image.voter import BilinearVoter
from cmfpga.rtl.image.warp import Warp
from cmfpga.rtl.ingest.event_buffer import EventBuffer
from cmfpga.rtl.ingest.reciprocal import Reciprocal
from cmfpga.rtl.ingest.roi_filter import RoiFilter
from cmfpga.rtl.ingest.thinner import Thinner
from support.bench import member, play
from support.configs import CONFIGS
from support.values import random_value

DEFAULT, ODD = CONFIGS["default"], CONFIGS["odd"]
FAST, QUAD, SIMILAR = map(preset, ("fast", "quad", "similarity"))
CELL = {"valid": 1, "address": 0, "i": 1, "dx": 0, "dy": 0}
VOTES = {"banks": [CELL] * 4, "last": 1}


def steps(taken):
    """Cycles in which a signal is not what it was in the one before."""
    return [cycle for cycle in range(1, len(taken)) if taken[cycle] != taken[cycle - 1]]


def pulses(taken):
    """Cycles in which a signal, or one of an array's, is valid."""
    return [
        cycle
        for cycle, value in enumerate(taken)
        if (any(one["valid"] for one in value) if isinstance(value, list) else value)
    ]


@dataclass(frozen=True)
class Timing:
    """How a block is timed: ``item(k)`` is what its inputs are in the cycle of an entry, every ``every`` cycles."""

    block: object
    latency: int
    out: str = "o.valid"
    item: object = None  # an event that is offered, if there is nothing else
    every: int = 1
    before: list = field(default_factory=list)
    came: object = pulses
    stays: dict = field(default_factory=dict)  # the inputs between two items
    row: int = 1  # the item is there for so many cycles
    late: int = 0  # the entry is so many cycles after the item: the last of what the item begins


def moved(k):
    return {"move": 1, "v": {"x": 1 << DEFAULT.v_frac, "y": 0}, "roi_gain": 1 << DEFAULT.roi_gain_frac}


BLOCKS = {
    "roi filter": Timing(
        RoiFilter(DEFAULT), 4, item=lambda k: {"i.valid": 1, "i.payload": {"t": 5 + k, "x": 9, "y": 8, "last": 0}},
        before=[{"start": 1, "roi": {"x": 0, "y": 0}}, {}],
    ),
    "thinner": Timing(
        Thinner(payloads.roi_event(DEFAULT), most_stored=9, most_events=99), 1, before=[{"start": 1, "thinning": 1}]
    ),
    "event buffer": Timing(
        EventBuffer(DEFAULT), 4, item=lambda k: {"replay": 1}, every=2,
        before=[{"clear": 1}, {"i.valid": 1}, {"take": 1}],
    ),
    "reciprocal": Timing(
        Reciprocal(span_bits=24, reciprocal_bits=16), 41, out="done", item=lambda k: {"start": 1, "span": 7}, every=41
    ),
    "dither": Timing(Dither(FAST), 2),
    "time scaler": Timing(TimeScaler(DEFAULT), 6),
    "warp": Timing(Warp(DEFAULT), 3),
    "warp with levels": Timing(Warp(FAST), 4),
    "evaluators": Timing(Evaluators(QUAD), 8, out="o.0.valid"),
    "voter": Timing(BilinearVoter(DEFAULT), 3),
    "accumulator": Timing(Accumulator(ODD), 3, item=lambda k: {"sweep.valid": 1, "sweep.payload.address": k}),
    # P/4 addresses, the first in the cycle of ``start``; the last of them is the entry.
    "gradient reader": Timing(
        GradientReader(ODD, accumulator_latency=3), 8, item=lambda k: {"start": 1},
        every=ODD.geometry.bank_words, late=ODD.geometry.bank_words - 1,
    ),
    "tagged accumulator": Timing(
        TaggedAccumulator(QUAD), 5, out="o", item=lambda k: {"i.valid": 1, "i.payload": VOTES}
    ),
    "one-pass gradient": Timing(
        OnePassGradient(QUAD, accumulator_latency=4), 10, item=lambda k: {"votes.valid": 1, "votes.payload": VOTES}
    ),
    # P·S costs cycles only where P is no power of two.
    "gradient": Timing(Gradient(DEFAULT), 1, every=Gradient.lead),
    "gradient, P no power of two": Timing(Gradient(ODD), 4, every=Gradient.lead),
    "velocity": Timing(
        Velocity(payloads.velocity(DEFAULT), target_bits=20), 1, out="moved",
        item=lambda k: {"move": 1},
    ),
    "constant ascent": Timing(ConstantAscent(DEFAULT), 5, out="run.updated", every=2),
    "sign ascent": Timing(SignAscent(SIMILAR), 2, out="run.updated", every=3),
    "newton ascent": Timing(NewtonAscent(FAST), 34, out="run.updated", every=38, row=4, late=3),
    # The last of its cycles is the velocity's.
    "probe": Timing(Probe(SIMILAR), 3, item=lambda k: {"begin": 1}, late=-1),
    "judge": Timing(
        LeastJudge(SIMILAR), 17, out="done", item=lambda k: {"i.valid": 1}, every=25, row=4, late=3
    ),
    "verdict": Timing(Verdict(FAST), 39, out="done", item=lambda k: {"begin": 1}, every=41),
    "ROI updater": Timing(
        RoiUpdater(DEFAULT), 9, out="corner.roi_next", item=moved, every=9, came=steps, stays=moved(0) | {"move": 0}
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BLOCKS)
def test_latency(name, rng):
    timing = BLOCKS[name]
    block, script, entries = timing.block, [*timing.before], []
    assert block.latency == timing.latency

    def offered(k):
        return {"i.valid": 1, "i.payload": random_value(member(block, "i.payload").shape(), rng)}

    for k in range(20):
        entries.append(len(script) + timing.late)
        script += [(timing.item or offered)(k)] * timing.row + [timing.stays] * (timing.every - timing.row)
    script += [{}] * (timing.latency + timing.late + 5)
    watch = play(block, script, flows=(), watch=(timing.out,)).watch[timing.out]
    assert timing.came(watch) == [entry + timing.latency for entry in entries]


def test_no_block_is_left_out():
    for name in ("fast", "quad", "paper"):
        timed = [block for block in Core(preset(name)).blocks.values() if hasattr(block, "latency")]
        assert {type(block) for block in timed} <= {type(timing.block) for timing in BLOCKS.values()}


def test_the_plain_sums_are_final_as_early_as_the_gradient_needs_them():
    assert min(GradientReader.lead, OnePassGradient(FAST, accumulator_latency=1).lead) >= Gradient.lead
