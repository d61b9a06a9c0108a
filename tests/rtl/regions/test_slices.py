"""Slices: every window is the last slices, in order, however events come and go; each broken one is noticed."""

import numpy as np
import pytest

from cmfpga.rtl.regions import slices
from support.bench import simulate
from support.mutation import break_blocks
from support.regions import CONFIGS

CONFIG = CONFIGS["overlapping windows"].replace(max_batch_events=20)
ROOM = 6  # events of a slice


def offered(rng):
    """Slices: events (t, x, y), how long they may be, and whether the last one is marked."""
    found, t = [], 0
    for _ in range(14):
        count, by_number = int(rng.integers(1, ROOM + 1)), int(rng.choice([0, 0, 3, 1]))
        events = [(t + k, int(rng.integers(40)), int(rng.integers(30))) for k in range(count)]
        t += count
        found.append((events, by_number, True))
    # Ends by itself: three of three events, and one as long as there is room for.
    return [*found, ([(t + k, k, k) for k in range(3)], 3, False), ([(t + 9 + k, k, k) for k in range(ROOM)], 0, False)]


def windows(parts):
    """What goes out: (t, x, y, last), window by window."""
    cut = []
    for events, by_number, _ in parts:
        size = by_number or ROOM
        cut += [events[k : k + size] for k in range(0, len(events), size)]
    for k in range(len(cut)):
        window = [event for one in cut[max(0, k - CONFIG.slices + 1) : k + 1] for event in one]
        yield [(*event, int(number + 1 == len(window))) for number, event in enumerate(window)]


def play(config, parts, rng, busy):
    """Events that came out, and the cycles in which they did, with those in which they came in; busy: never a pause."""
    dut = slices.Slices(config)
    events = [
        (event, by_number, marked and k + 1 == len(one))
        for one, by_number, marked in parts
        for k, event in enumerate(one)
    ]
    wanted = sum(map(len, windows(parts)))
    out, came, went = [], [], []

    async def bench(ctx):
        opening = 1  # what follows takes the first event of a window a cycle after it is offered
        for cycle in range(60 * len(events)):
            offers = len(came) < len(events) and (busy or rng.random() < 0.6)
            ctx.set(dut.i.valid, offers)
            if offers:
                (t, x, y), by_number, last = events[len(came)]
                ctx.set(dut.i.payload, {"t": t, "x": x, "y": y, "last": last})
                ctx.set(dut.slice_events, by_number)
            takes = ctx.get(dut.o.valid) and opening == 2 and (busy or rng.random() < 0.6)
            ctx.set(dut.opened, opening == 1 and ctx.get(dut.o.valid))
            ctx.set(dut.o.ready, takes)
            opening = 2 if ctx.get(dut.o.valid) or opening == 2 else 1
            if takes:
                p = ctx.get(dut.o.payload)
                out.append((p.t, p.x, p.y, p.last))
                went.append(cycle)
                opening = 1 if p.last else 2
            if offers and ctx.get(dut.i.ready):
                came.append(cycle)
            await ctx.tick()
            if len(out) == wanted:
                return
        assert len(out) == wanted, "some events did not come out"

    simulate(dut, bench)
    return out, came, went


def check(seed, busy=False):
    rng = np.random.default_rng(seed)
    parts = offered(rng)
    out, came, went = play(CONFIG, parts, rng, busy)
    assert out == [event for window in windows(parts) for event in window]
    return parts, came, went


def test_a_window_is_the_last_slices():
    for seed in range(4):
        check(seed)


def test_an_event_per_cycle_and_so_many_between_two_windows():
    parts, came, went = check(9, busy=True)
    at, ends = 0, [len(window) for window in windows(parts)]
    for before, count in zip([0, *ends], ends, strict=False):
        if at:
            assert went[at] - went[at - 1] <= 5  # n + 4 cycles until the slice's first event, n of them go out
        rows = np.diff(went[at : at + count])
        assert (rows > 1).sum() <= 1 and rows.sum() <= count + 3, (before, rows)
        at += count
    assert {*came} <= {*went}  # in the same cycle


MUTANTS = {
    "a slice too few": ("m.d.sync += [replayed.eq(before[-1])", "m.d.sync += [replayed.eq(before[0])"),
    "nothing kept": ("m.d.sync += [replayed.eq(before[-1])", "m.d.sync += [replayed.eq(at)"),
    "the ring does not close": ("Mux(place == depth - 1, 0, place + 1)", "place + 1"),
    "the slice itself comes again": ("begin.eq(at)", "begin.eq(at + 1)"),
    "the last word lost": ("& ~found & ~there)", "& ~found)"),
    "a word lost that was not taken": ("(self.o.ready & self.o.valid) | ~there", "1"),
    "read although it waits": ("read.en.eq(goes | ~found)", "read.en.eq(1)"),
    "a window ends too early": ("out.last.eq(0)", "out.last.eq(kept.t[0])"),
    "not by its number": ("(number + 1 == wanted)", "0"),
    "number of the slice before": ("wanted.eq(self.slice_events),\n", ""),
    "one event, by its number": ("(self.slice_events == 1)", "0"),
    "more than there is room for": ("(number == config.slice_events - 1)", "0"),
    "written although it waits": ("write.en.eq(self.i.valid & self.o.ready)", "write.en.eq(self.i.valid)"),
    "begins before a slice comes": ("there & (self.i.valid | begun)", "there"),
}


def test_nothing_is_offered_before_a_slice_is():
    """Or what follows would take over the settings of the slice before."""
    dut = slices.Slices(CONFIG)

    async def bench(ctx):
        async def nothing(ctx):
            ctx.set(dut.i.valid, 0)
            for _ in range(9):
                assert not ctx.get(dut.o.valid)
                await ctx.tick()

        ctx.set(dut.o.ready, 1)
        for wanted in (1, 2):
            ctx.set(dut.i.payload, {"t": wanted, "x": 0, "y": 0, "last": 1})
            ctx.set(dut.i.valid, 1)
            ctx.set(dut.opened, 1)
            await ctx.tick().until(dut.i.ready)
            ctx.set(dut.opened, 0)
            await nothing(ctx)
        # Offered for a cycle, and not any more.
        ctx.set(dut.i.valid, 1)
        await ctx.tick()
        await nothing(ctx)

    simulate(dut, bench)


@pytest.mark.parametrize("name", MUTANTS)
def test_a_broken_block_is_noticed(name, monkeypatch):
    break_blocks(monkeypatch, slices, *MUTANTS[name])
    with pytest.raises(AssertionError):
        for seed in range(3):
            check(seed)
        test_nothing_is_offered_before_a_slice_is()
