"""Event buffer against a list: what was stored comes out in order, as often as asked; the surplus is counted."""

import itertools

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.rtl.ingest.event_buffer import EventBuffer
from support.bench import GAPS, play
from support.values import random_gaps, random_value, random_values

DEPTHS = [1, 2, 3, 64, 100]


def config_of(depth, buffers=1):
    return Config(buffer_events=depth, buffers=buffers, max_batch_events=1000)


def check(depth, batches, *, buffers=1, probability=0.0, idle=0, seed=0):
    """Batches of (number of events, number of replays, idle cycles before take, before the replay, before clear).

    The last three may be left out. With two buffers the next batch is filled while one is replayed, as early as
    allowed and then so many cycles later.
    """
    rng = np.random.default_rng(seed)
    block = EventBuffer(config_of(depth, buffers))
    noise = random_values(block.i.payload.shape(), rng)
    inputs, expected, ends, replays, overlaps = {}, [], [], [], 0
    clear, free = 0, 0  # first cycles in which to clear and to take
    for count, times, *waits in batches:
        before_take, before_replay, before_clear = waits or (idle, 0, idle)
        inputs[clear] = inputs.get(clear, {}) | {"clear": 1}
        events = list(itertools.islice(noise, count))
        cycle = clear + 1
        for event, gap in zip(events, random_gaps(rng, count, probability), strict=True):
            cycle += gap
            inputs[cycle] = inputs.get(cycle, {}) | {"i.valid": 1, "i.payload": event}
            overlaps += cycle < free
            cycle += 1
        # Counters are valid in the cycle after an event.
        take = max(cycle, free) + before_take
        inputs[take] = inputs.get(take, {}) | {"take": 1}
        ends.append((take, min(count, depth), max(0, count - depth)))
        stored = events[:depth]
        free = take + 1 + before_replay
        for _ in range(times):
            inputs[free] = inputs.get(free, {}) | {"replay": 1}
            replays.append((free, len(stored)))
            # The next replay starts in the cycle in which the last address has been issued.
            free += 1 + len(stored) + idle
            expected += [{**event, "last": int(k == len(stored) - 1)} for k, event in enumerate(stored)]
        clear = before_clear + (free if buffers == 1 else take + 1)
    script = [{"i.payload": next(noise), **inputs.get(cycle, {})} for cycle in range(free + block.latency + 5)]
    recording = play(block, script, watch=("stored.count", "stored.overflow"))
    assert recording.values() == expected
    for end, stored, overflow in ends:
        assert (recording.watch["stored.count"][end], recording.watch["stored.overflow"][end]) == (stored, overflow)
    wanted = [start + block.latency + k for start, count in replays for k in range(count)]
    assert recording.cycles() == wanted
    assert not overlaps or buffers == 2
    recording.overlaps = overlaps
    return recording


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("depth", DEPTHS)
@pytest.mark.parametrize("buffers", [1, 2])
def test_matches_a_list(buffers, depth, gap, rng):
    """Empty to overfull, and fuller again after an overflow; each batch replaces the one before."""
    counts = [depth, 1, depth + 1, max(1, depth - 1), 2 * depth + 3, max(1, depth // 2), depth]
    batches = [(count, int(rng.integers(1, 4))) for count in counts]
    check(depth, batches, buffers=buffers, probability=GAPS[gap], idle=2 if gap == "gaps" else 0)


@pytest.mark.parametrize("buffers", [1, 2])
def test_overflow_is_counted_to_the_largest_batch(buffers):
    check(1, [(1000, 2), (1, 1)], buffers=buffers)


@pytest.mark.parametrize("buffers", [1, 2])
def test_clear_forgets(buffers):
    """Cleared without a replay, or with nothing stored: no event of the batch before comes out."""
    check(5, [(7, 0), (0, 0), (2, 2), (6, 0), (5, 1)], buffers=buffers)


@pytest.mark.parametrize("depth", [1, 3, 4, 5])
def test_one_buffer_is_filled_while_the_other_is_replayed(depth):
    """In all alignments of the filling, also of one that overflows, with three replays."""
    fillings = [max(1, depth - 1), depth, depth + 2]
    batches = [
        (count, 3, 0, start, clear) for clear in range(2 * depth + 4) for start in range(3) for count in fillings
    ]
    assert check(depth, batches, buffers=2).overlaps > len(batches)
    # Each also after one that is replayed more often than it takes to fill the other.
    batches = [batch for count in fillings for clear in range(9) for batch in ((depth, 5, 0, 0, clear), (count, 1))]
    assert check(depth, batches, buffers=2, probability=0.3).overlaps > 0


def test_what_is_replayed_stays_until_it_is_taken():
    """A filling that waits for long, complete, while the other is replayed again and again."""
    check(6, [(4, 9), (9, 2), (2, 7), (1, 9), (6, 1)], buffers=2)
    # Nothing of a filling that is dropped unreplayed.
    check(6, [(4, 2), (6, 0), (0, 0), (3, 2), (1, 0), (2, 4)], buffers=2, idle=1)


def test_counters_follow_the_filling(rng):
    """During a replay the counters are those of the buffer that is being filled, in every cycle."""
    block = EventBuffer(config_of(3, 2))
    event = random_value(block.i.payload.shape(), rng)
    push = {"i.valid": 1, "i.payload": event}
    script = [{"clear": 1}, push, push, {"take": 1}, {"clear": 1, "replay": 1}, *[push] * 5, {}]
    watch = play(block, script, watch=("stored.count", "stored.overflow")).watch
    assert watch["stored.count"] == [0, 0, 1, 2, 2, 0, 1, 2, 3, 3, 3]
    assert watch["stored.overflow"] == [0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2]


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_a_replay_pauses_where_there_is_no_room(share, rng):
    """An event for each cycle with room, no other one, in order; room before and after a replay counts for nothing."""
    block = EventBuffer(config_of(9))
    events = [random_value(block.i.payload.shape(), rng) for _ in range(9)]
    script = [{"clear": 1, "room": 1}, *({"i.valid": 1, "i.payload": event} for event in events), {"take": 1}]
    issued = []
    for _ in range(6):
        script.append({"replay": 1, "room": int(rng.random() < share)})
        for _ in events:
            while rng.random() >= share:
                script.append({"room": 0})
            issued.append(len(script))
            script.append({"room": 1})
        script += [{"room": int(rng.random() < share)} for _ in range(int(rng.integers(4)))]
    recording = play(block, [*script, *[{}] * 5])
    assert recording.values() == [{**event, "last": int(event is events[-1])} for event in events] * 6
    assert recording.cycles() == [cycle + EventBuffer.latency - 1 for cycle in issued]
