"""Thinner against its model: which events pass, how many are left out, and the factor that a batch leaves behind."""

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.reference.integer.filters import next_thinning, thinner
from cmfpga.rtl import payloads
from cmfpga.rtl.ingest.thinner import Thinner
from support.bench import GAPS, flow_script, play
from support.values import random_gaps, random_value, random_values, tensor

CONFIG = Config(buffer_events=300, max_batch_events=5000)


def block_of():
    return Thinner(payloads.roi_event(CONFIG), most_stored=CONFIG.buffer_events, most_events=CONFIG.max_batch_events)


def check(batches, *, probability=0.0, seed=0):
    """Batches of (events, thinning, target), one after the other; returns the factor of each."""
    rng = np.random.default_rng(seed)
    block = block_of()
    events = random_values(block.i.payload.shape(), rng, 97)
    script, expected, cycles, counts, factors = [], [], [], {}, []
    last = None
    for count, thinning, target in batches:
        # The settings are random but for the cycle in which they count; the first event follows at once.
        script.append({"start": 1, "thinning": thinning, "target": target})
        factor = last if target and last else thinning
        last = next_thinning(count, target)
        factors.append(factor)
        batch = [next(events) for _ in range(count)]
        others = {"thinning": random_value(8, rng), "target": random_value(block.target.shape(), rng)}
        part, pushed = flow_script(
            block, [(event, others) for event in batch], random_gaps(rng, count, probability), rng, drain=0
        )
        pushed = [len(script) + cycle for cycle in pushed]
        passed = thinner((tensor(range(count)),), factor)[0].tolist()
        expected += [batch[number] for number in passed]
        cycles += [pushed[number] + block.latency for number in passed]
        # The count is right two cycles after each event.
        for number, cycle in enumerate(pushed, 1):
            counts[cycle + 2] = number - len(range(0, number, factor))
        counts.setdefault(len(script) + 1, 0)
        script += part
        # No event in the cycle before `start`.
        script += [{}] * int(rng.integers(1, 4))
    script += [{}] * 4
    recording = play(block, script, watch=("thinned",))
    assert recording.values() == expected
    assert recording.cycles() == cycles
    for cycle, wanted in counts.items():
        assert recording.watch["thinned"][cycle] == wanted, f"cycle {cycle}"
    return factors


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("thinning", [1, 2, 3, 7, 64, 128, 254, 255])
def test_one_event_in_so_many(thinning, gap):
    """The first passes, then every ``thinning``-th; each batch begins anew, wherever the one before ended."""
    counts = [1, thinning, thinning + 1, 2 * thinning - 1, 2 * thinning, 3, 2 * thinning + 1]
    assert set(check([(count, thinning, 0) for count in counts], probability=GAPS[gap])) == {thinning}


def test_every_factor():
    check([(thinning + 2, thinning, 0) for thinning in range(1, 256)])


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("target", [1, 2, 3, 10, 299, 300])
def test_next_factor_is_the_smallest_that_meets_the_target(target, gap):
    """⌈events/target⌉, for every remainder and across all multiples; 1 for an empty batch."""
    counts = [0, 1, target - 1, target, target + 1, 2 * target - 1, 2 * target, 2 * target + 1, 5 * target, 1]
    factors = check([(count, 9, target) for count in counts], probability=GAPS[gap])
    assert factors == [9, *(max(1, -(-count // target)) for count in counts[:-1])]


#: Batches, and the factor of each.
FACTORS = {
    "from one below 255 to far beyond, and back": (
        [(count, 5, 1) for count in (253, 254, 255, 256, 257, 511, 1000, 4000, 3, 1)],
        [5, 253, 254, 255, 255, 255, 255, 255, 255, 3],
    ),
    "stops at 255": ([(count, 5, 4) for count in (1016, 1017, 1020, 1021, 5)], [5, 254, 255, 255, 255]),
    # Without: the factor set by hand; and the target that is followed is the one under which events were counted.
    "a target counts if the batch before had one": (
        [(100, 7, 10), (100, 7, 20), (100, 7, 0), (100, 6, 10), (50, 5, 50), (10, 3, 300), (10, 2, 1), (0, 9, 0)],
        [7, 10, 7, 6, 10, 1, 1, 9],
    ),
    # The factor follows all ROI events, not those that were stored.
    "what does not pass is counted too": ([(200, 10, 20), (200, 1, 20), (200, 1, 20)], [10, 10, 10]),
    "the largest batch is counted": ([(5000, 255, 0), (5000, 2, 300), (5000, 1, 1), (2, 1, 0)], [255, 2, 17, 1]),
}


@pytest.mark.parametrize("name", FACTORS)
def test_factors(name):
    batches, factors = FACTORS[name]
    assert check(batches) == factors


def test_a_factor_of_zero_passes_everything():
    """A setting that no tool writes must not stop the core."""
    rng = np.random.default_rng(0)
    block = block_of()
    events = [random_value(block.i.payload.shape(), rng) for _ in range(9)]
    script, _ = flow_script(block, events, [0] * 9, rng)
    recording = play(block, [{"start": 1, "thinning": 0, "target": 0}, *script], watch=("thinned",))
    assert recording.values() == events and recording.watch["thinned"][-1] == 0
