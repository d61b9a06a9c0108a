"""Event buffer against a list: what was stored comes out in order, as often as asked; the surplus is counted."""

import pytest

from cmfpga.config import Config
from cmfpga.rtl.event_buffer import EventBuffer

from .bench import GAPS, check_throughput, flow_script, np, play, random_gaps, random_value

DEPTHS = [1, 2, 3, 64, 100]


def config_of(depth):
    return Config(buffer_events=depth, max_batch_events=1000)


def check(depth, batches, *, probability=0.0, idle=0, seed=0):
    """Batches of (number of events, number of replays)."""
    rng = np.random.default_rng(seed)
    block = EventBuffer(config_of(depth))
    shape = block.i.payload.shape()
    script, expected, ends, replays = [], [], [], []
    for count, times in batches:
        script.append({"clear": 1})
        events = [random_value(shape, rng) for _ in range(count)]
        # Counters are valid in the cycle after an event, and a replay may start then.
        part, _ = flow_script(block, events, random_gaps(rng, count, probability), rng, drain=idle)
        script += part
        ends.append((len(script), min(count, depth), max(0, count - depth)))
        stored = events[:depth]
        for _ in range(times):
            replays.append((len(script), len(stored)))
            # The next replay starts in the cycle in which the last address has been issued.
            script += [{"replay": 1}, *[{}] * len(stored), *[{} for _ in range(idle)]]
            expected += [{**event, "last": int(k == len(stored) - 1)} for k, event in enumerate(stored)]
        script += [{} for _ in range(block.latency if times else 1)]
    script += [{}] * 5
    recording = play(block, script, watch=("count", "overflow"))
    assert recording.values() == expected
    for end, stored, overflow in ends:
        assert (recording.watch["count"][end], recording.watch["overflow"][end]) == (stored, overflow)
    wanted = [start + block.latency + k for start, count in replays for k in range(count)]
    assert recording.cycles() == wanted
    return recording


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("depth", DEPTHS)
def test_matches_a_list(depth, gap, rng):
    """Empty to overfull, and fuller again after an overflow; each batch replaces the one before."""
    counts = [depth, 1, depth + 1, max(1, depth - 1), 2 * depth + 3, max(1, depth // 2), depth]
    batches = [(count, int(rng.integers(1, 4))) for count in counts]
    check(depth, batches, probability=GAPS[gap], idle=2 if gap == "gaps" else 0)


def test_latency_and_throughput():
    """Replays back to back: one event per cycle, but for the cycle in which a replay is asked for."""
    recording = check(64, [(64, 1)])
    popped = recording.cycles()
    assert EventBuffer.latency == 3
    check_throughput(popped, popped)


def test_overflow_is_counted_to_the_largest_batch():
    check(1, [(1000, 2), (1, 1)])


def test_clear_forgets():
    """Cleared without a replay, or with nothing stored: no event of the batch before comes out."""
    check(5, [(7, 0), (0, 0), (2, 2), (6, 0), (5, 1)])
