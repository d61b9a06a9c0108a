"""Event buffer against a list: what was stored comes out in order, as often as asked; the surplus is counted."""

import collections
import itertools

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.config.config import WHEN_FULL
from cmfpga.config.schedule import STRIDES, ScheduleEntry, used
from cmfpga.rtl.ingest.event_buffer import EventBuffer
from support.bench import GAPS, play
from support.values import random_gaps, random_value, random_values

DEPTHS = [1, 2, 3, 64, 100]
#: An ascent whose iterations may leave out events.
SIGNS = {
    "gradient": "one_pass", "ascent": "sign", "border": "whole", "motion": "similarity", "schedule_entries": 64,
}  # fmt: skip


def check(depth, batches, *, buffers=1, probability=0.0, idle=0, seed=0, **changes):
    """Batches of (number of events, number of replays, idle cycles before take, before the replay, before clear).

    The last three may be left out. With two buffers the next batch is filled while one is replayed, as early as
    allowed and then so many cycles later.
    """
    rng = np.random.default_rng(seed)
    config = Config(buffer_events=depth, buffers=buffers, max_batch_events=1000, **changes)
    block, thin = EventBuffer(config), config.when_full == "thin"
    noise = random_values(block.i.payload.shape(), rng)
    strided = config.ascent == "sign"
    inputs, expected, ends, replays, overlaps = collections.defaultdict(dict), [], [], [], 0
    clear, free = 0, 0  # first cycles in which to clear and to take
    for count, times, *waits in batches:
        before_take, before_replay, before_clear = waits or (idle, 0, idle)
        inputs[clear]["clear"] = 1
        events = list(itertools.islice(noise, count))
        cycle = clear + 1
        for event, gap in zip(events, random_gaps(rng, count, probability), strict=True):
            cycle += gap
            inputs[cycle] |= {"i.valid": 1, "i.payload": event}
            overlaps += cycle < free
            cycle += 1
        # Counters are valid in the cycle after an event.
        take = max(cycle, free) + before_take
        inputs[take]["take"] = 1
        halvings = 0
        while thin and -(-count >> halvings) > depth:
            halvings += 1
        stored = events[:: 1 << halvings][:depth]
        ends.append((take, len(stored), count - len(stored), halvings))
        free = take + 1 + before_replay
        for number in range(times):
            entry = ScheduleEntry(0, 0, int(rng.choice(STRIDES)) if strided else 1)
            chosen = stored[used(entry, number, len(stored))]
            inputs[free]["replay"] = 1
            if strided:
                inputs[free]["stride"] = entry.stride.bit_length() - 1
            replays.append((free, len(chosen)))
            # The next replay starts in the cycle in which the last address has been issued.
            free += 1 + len(chosen) + idle
            expected += [{**event, "last": int(k == len(chosen) - 1)} for k, event in enumerate(chosen)]
        clear = before_clear + (free if buffers == 1 else take + 1)
    script = [{"i.payload": next(noise), **inputs[cycle]} for cycle in range(free + block.latency + 5)]
    surplus = "stored.thinned" if thin else "stored.overflow"
    recording = play(block, script, watch=("stored.count", surplus, *(("stored.halved",) if thin else ())))
    assert recording.values() == expected
    begin = 0
    for end, stored, lost, halvings in ends:
        assert (recording.watch["stored.count"][end], recording.watch[surplus][end]) == (stored, lost)
        assert not thin or sum(recording.watch["stored.halved"][begin:end]) == halvings
        begin = end
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


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("depth", [*DEPTHS, 7])
@pytest.mark.parametrize("buffers", [1, 2])
def test_a_full_buffer_thins_out(buffers, depth, gap, rng):
    """Every 2^e-th of the events, with the least e that lets them fit, evenly; sudden growth, and less again."""
    sizes = [depth, depth + 1, 1, 2 * depth - 1, 2 * depth, 2 * depth + 1, 4 * depth + 1, 10 * depth, depth // 2 + 1]
    batches = [(min(900, count), int(rng.integers(1, 3))) for count in sizes]
    batches += [(int(rng.integers(1, min(900, 10 * depth) + 1)), 1) for _ in range(6)]
    options = {"buffers": buffers, "probability": GAPS[gap], "idle": 2 if gap == "gaps" else 0}
    check(depth, batches, when_full="thin", **options)


@pytest.mark.parametrize("when_full", WHEN_FULL)
@pytest.mark.parametrize("buffers", [1, 2])
def test_subsets_of_the_events(buffers, when_full):
    """Each stride and iteration, where the strides begin to count, in a buffer that has been full or not."""
    counts = [1, 127, 129, 255, 256, 257, 511, 512, 513, 560, 561, 1000]
    check(561, [(count, 9) for count in counts], buffers=buffers, when_full=when_full, **SIGNS)


@pytest.mark.parametrize("buffers", [1, 2])
def test_overflow_is_counted_and_clear_forgets(buffers):
    """To the largest batch; cleared without a replay, or with nothing stored, no event of the batch before comes."""
    check(1, [(1000, 2), (1, 1)], buffers=buffers)
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
    block = EventBuffer(Config(buffer_events=3, buffers=2, max_batch_events=1000))
    event = random_value(block.i.payload.shape(), rng)
    push = {"i.valid": 1, "i.payload": event}
    script = [{"clear": 1}, push, push, {"take": 1}, {"clear": 1, "replay": 1}, *[push] * 5, {}]
    watch = play(block, script, watch=("stored.count", "stored.overflow")).watch
    assert watch["stored.count"] == [0, 0, 1, 2, 2, 0, 1, 2, 3, 3, 3]
    assert watch["stored.overflow"] == [0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2]


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_a_replay_pauses_where_there_is_no_room(share, rng):
    """An event for each cycle with room, no other one, in order; room before and after a replay counts for nothing."""
    block = EventBuffer(Config(buffer_events=9, max_batch_events=1000))
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
    assert recording.cycles() == [cycle + block.latency - 1 for cycle in issued]
