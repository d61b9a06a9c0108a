"""Schedule: parts of the table in any order, entries out of range limited and flagged only where they are used."""

import itertools

import numpy as np
import pytest

from cmfpga.rtl import payloads
from cmfpga.rtl.ascent.schedule import Schedule
from support.bench import held, play
from support.configs import SIGNS
from support.values import random_value, shape_range


class Player:
    """Drives a schedule and says what its outputs must be in every cycle."""

    def __init__(self, config, rng):
        self.config, self.rng = config, rng
        self.block = Schedule(config)
        self.table = [(0, 0, 0)] * config.schedule_entries
        self.script, self.entry, self.stride, self.limited = [], {}, {}, {0: 0}

    def cycle(self, **values):
        """Inputs of a cycle; whatever has no strobe is random."""
        noise = {
            "first": random_value(self.block.first.shape(), self.rng),
            "write.payload": random_value(self.block.write.payload.shape(), self.rng),
        }
        self.script.append(noise | values)

    def write(self, address, entry):
        self.cycle(**{"write.valid": 1, "write.payload": {"address": address, "entry": entry}})
        self.table[address] = entry["level"], entry["shift"], entry["stride"]

    def batch(self, first, count, gaps):
        """One batch of ``count`` iterations, each ``gaps[k]`` cycles longer than it has to be."""
        self.cycle(new_batch=1)
        self.limited[len(self.script)] = 0
        self.cycle()
        self.cycle(first=first)
        self.cycle()
        most = limits(self.config)
        self.stride[len(self.script)] = min(self.table[first][2], most[2])
        self.cycle(start=1)
        for k, gap in zip(range(count), gaps, strict=True):
            entry = self.table[(first + k) % len(self.table)]
            self.entry[len(self.script)] = min(entry[0], most[0]), min(entry[1], most[1])
            following = self.table[(first + k + 1) % len(self.table)]
            self.stride[len(self.script) + 1] = min(following[2], most[2]) if k + 1 < count else None
            for _ in range(gap + 1):
                self.cycle()
            self.cycle(advance=1)
            if any(value > limit for value, limit in zip(entry, most, strict=True)):
                self.limited[len(self.script)] = 1
        self.entry[len(self.script)] = None  # what follows the last entry is nobody's
        for _ in range(2):
            self.cycle()

    def check(self):
        watch = play(self.block, self.script, flows=(), watch=("level", "shift", "stride", "limited")).watch
        timelines = ({0: None} | self.entry, {0: None} | self.stride, self.limited)
        columns = (held(timeline, len(self.script)) for timeline in timelines)
        for cycle, (wanted, stride, limited) in enumerate(zip(*columns, strict=True)):
            if wanted is not None:
                assert (watch["level"][cycle], watch["shift"][cycle]) == wanted, f"cycle {cycle}"
            if stride is not None:
                assert watch["stride"][cycle] == stride, f"cycle {cycle}"
            assert watch["limited"][cycle] == limited, f"cycle {cycle}"
        return [entry for entry in self.entry.values() if entry], set(self.limited.values())


def limits(config):
    return config.max_level, config.formats.v.width - 2, 2


def entry_of(config, rng, *, good):
    if not good:
        return random_value(payloads.schedule_entry(config), rng)
    values = (int(rng.integers(limit + 1)) for limit in limits(config))
    return dict(zip(("level", "shift", "stride"), values, strict=True))


@pytest.mark.parametrize("good", [True, False], ids=["in range", "any"])
@pytest.mark.parametrize("name", SIGNS)
def test_parts_of_the_table(name, good, rng):
    """Batches that use any part, past the table's end too, and rewrite some of it in between."""
    config = SIGNS[name]
    player = Player(config, rng)
    entries = config.schedule_entries
    for address in rng.permutation(entries).tolist():
        player.write(address, entry_of(config, rng, good=good))
    for number in range(12):
        count = int(rng.integers(1, entries + 1))
        first = entries - 1 if number == 3 else int(rng.integers(entries))
        gaps = (rng.integers(0, 3, count) if number % 2 else np.zeros(count, int)).tolist()
        player.batch(first, count, gaps)
        for _ in range(3):
            player.write(int(rng.integers(entries)), entry_of(config, rng, good=good))
    used, flags = player.check()
    assert len(set(used)) >= 5
    assert flags == ({0} if good else {0, 1})


@pytest.mark.parametrize("name", SIGNS)
def test_limits_to_the_unit(name):
    """The largest level, step and stride pass, one more is limited; whichever the formats can hold."""
    config = SIGNS[name]
    shape, most = payloads.schedule_entry(config), limits(config)
    tops = [shape_range(part.shape)[1] for _, part in shape]
    cases = set(itertools.product(*zip(most, tops, strict=True)))
    cases |= {tuple(min(most[k] + 1, tops[k]) if k == at else 0 for k in range(3)) for at in range(3)}
    for entry in sorted(cases):
        player = Player(config, np.random.default_rng(0))
        player.write(0, dict(zip(shape.members, entry, strict=True)))
        player.batch(0, 1, [0])
        used, flags = player.check()
        wanted = tuple(map(min, entry, most))
        assert used == [wanted[:2]] and (1 in flags) == (entry != wanted)


def test_only_entries_that_are_used_are_flagged(rng):
    """Entries out of range before and right behind the part: shown to nobody, flagged by nobody."""
    config = SIGNS["similarity"]
    player = Player(config, rng)
    bad = {"level": 3, "shift": 15, "stride": 3}
    for address in range(config.schedule_entries):
        player.write(address, bad)
    for address in (4, 5, 6):
        player.write(address, {"level": 1, "shift": 2, "stride": 1})
    player.batch(4, 3, [0, 2, 0])
    player.batch(6, 1, [3])
    assert player.check()[1] == {0}


def test_the_flag_stays_until_the_next_batch(rng):
    config = SIGNS["similarity"]
    player = Player(config, rng)
    player.write(0, {"level": 3, "shift": 1, "stride": 0})
    for address in (1, 2, 3):
        player.write(address, {"level": 2, "shift": address, "stride": 2})
    player.batch(0, 4, [0, 1, 0, 1])  # the first is limited, the others are not
    player.batch(1, 3, [0, 0, 0])
    used, flags = player.check()
    assert used == [(2, 1), (2, 1), (2, 2), (2, 3), (2, 1), (2, 2), (2, 3)] and flags == {0, 1}
