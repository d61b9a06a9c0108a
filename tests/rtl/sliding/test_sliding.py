"""Hop control, walker and ring together against the model: windows, events and dither, whenever events come."""

import dataclasses

import numpy as np
import pytest
from amaranth.hdl import Module
from amaranth.lib import wiring

from cmfpga.config import preset
from cmfpga.config.dither import DITHER_BITS, FACTORS
from cmfpga.protocol.settings import BatchSettings
from cmfpga.reference.integer.sliding import Sliding
from cmfpga.rtl.sliding import hop_control, ring, walker
from support.bench import simulate
from support.mutation import break_blocks

CONFIG = preset("sliding").replace(
    roi_width=12, roi_height=10, sensor_width=32, sensor_height=24, buffer_events=60, time_bits=16, span_bits=12,
    hop_us=0, follow="", after="",
)  # fmt: skip
#: Which close by number, by time, share nothing, come one event a hop; a pause may be longer than any window.
LENGTHS = {
    "both": {"window_events": 60, "hop_events": 5, "window_us": 900, "hop_us": 150},
    "by number": {"window_events": 60, "hop_events": 7, "window_us": 0, "hop_us": 0},
    "by time": {"window_events": 60, "hop_events": 60, "window_us": 400, "hop_us": 60},
    "disjoint": {"window_events": 6, "hop_events": 6, "window_us": 0, "hop_us": 0},
    "one event a hop": {"window_events": 9, "hop_events": 1, "window_us": 1500, "hop_us": 900},
}


CORNER = (5, 6)


def drawn(rng, count):
    steps = 10 * rng.integers(0, 3, count) * rng.choice([0, 1, 2], count)  # often just as old as a window may be
    steps[rng.random(count) < 0.01] += 1800
    t = 65_000 + np.cumsum(steps)
    x, y = 8 + 6 * t / t[-1] + rng.normal(0, 6, count), 9 + rng.normal(0, 6, count)
    noise = rng.random(count) < 0.4  # wherever the ROI goes, there are events
    x[noise], y[noise] = rng.integers(0, 32, noise.sum()), rng.integers(0, 24, noise.sum())
    return t % (1 << 16), x.astype(int).clip(0, 31), y.astype(int).clip(0, 23)


class Windows(wiring.Component):
    """The three blocks, as a core would join them."""

    def __init__(self):
        self.control, self.walker, self.ring = hop_control.HopControl(CONFIG), walker.Walker(CONFIG), ring.Ring(CONFIG)
        super().__init__({})

    def elaborate(self, platform):
        m = Module()
        m.submodules.control, m.submodules.walker, m.submodules.ring = self.control, self.walker, self.ring
        wiring.connect(m, self.control.o, self.ring.i)
        m.d.comb += [
            self.walker.lengths.eq(self.control.lengths),
            self.control.oldest.eq(self.walker.begin),
            self.walker.closed.eq(self.control.closed),
            self.walker.end.eq(self.control.end),
            self.walker.now.eq(self.control.now[: CONFIG.span_bits]),
            self.walker.stale.eq(self.control.stale),
            self.ring.look.eq(self.walker.look),
            self.walker.t.eq(self.ring.o.payload.t),
            self.ring.first.eq(self.walker.begin),
            self.ring.end.eq(self.control.end),
        ]
        return m


def windows(hops, events, crops, rng, *, busy=(0, 40), gap=0.93, stall=0.3):
    """What comes out: ``(begin, end, now, stale, t_first, phases, events of the window)`` of each hop.

    Each hop's replay begins before its events come, and follows them. ``busy``: how long its evaluation takes.
    """
    dut, found, places = Windows(), [], 1 << ring.address_bits(CONFIG)
    control, walk, store = dut.control, dut.walker, dut.ring
    done = []

    async def feed(ctx):
        for name, value in hops.items():
            ctx.set(control.lengths[name], value)
        ctx.set(control.corner, dict(zip("xy", CORNER, strict=True)))
        await ctx.tick()
        for k, (t, x, y) in enumerate(zip(*(axis.tolist() for axis in events), strict=True)):
            while rng.random() < gap * (k // 40 % 2) and not done:  # at once, or so late that a replay waits for it
                await ctx.tick()
            ctx.set(control.i.payload, {"t": t, "x": x, "y": y})
            ctx.set(control.i.valid, 1)
            for _ in range(5000):
                *_, ready = await ctx.tick().sample(control.i.ready)
                if ready or done:
                    break
            else:
                raise AssertionError(f"event at {t} µs is not taken")
            ctx.set(control.i.valid, 0)
            if done:
                return

    async def evaluate(ctx):
        begin, first, phases = 0, None, tuple(factor // 2 for factor in FACTORS)
        for corner in crops:
            for _ in range(2):  # the begin is right before
                await ctx.tick()
            ctx.set(store.replay, 1)
            await ctx.tick()
            ctx.set(store.replay, 0)
            out, last, closed, ended, waited, since = [], False, False, None, 0, 0
            ctx.set(control.free, 1)
            while not closed or not (last or ended == begin):
                ctx.set(store.room, int(rng.random() >= stall))
                ctx.set(store.closed, int(closed))  # a cycle later
                if ctx.get(control.closed):
                    closed, ended = True, ctx.get(control.end)
                    now = ctx.get(control.now) % (1 << CONFIG.span_bits)
                if ctx.get(store.o.valid):
                    event = ctx.get(store.o.payload)
                    out.append((event.t, event.x, event.y))
                    last = bool(event.last)
                await ctx.tick()
                if closed:
                    ctx.set(control.free, 0)
                    since += 1
                waited += 1
                assert waited < 4000, f"hop {len(found)}: {len(out)} events, closed: {closed}"
            ctx.set(store.closed, 1)
            await ctx.tick()  # it is told a cycle after what else is told of a hop
            found.append((begin, ended, now, ctx.get(control.stale), first, phases, out))
            pause = int(rng.integers(*busy))
            for _ in range(pause):
                await ctx.tick()
            ctx.set(store.closed, 0)
            ctx.set(control.corner, dict(zip("xy", corner, strict=True)))
            ctx.set(walk.go, 1)
            await ctx.tick()
            ctx.set(walk.go, 0)
            cycles, last = 1, begin
            while not ctx.get(walk.done):
                await ctx.tick()
                cycles += 1
            begin, phases = ctx.get(walk.begin), (ctx.get(walk.phase_x), ctx.get(walk.phase_y))
            # What is too many was dropped before, from the third cycle after the hop had closed on.
            too_many = max(0, (ended - last) % places - hops["window_events"] + hops["hop_events"])
            before = min(too_many, since + 1 + pause - 2)
            assert cycles == (begin - last) % places - before + walk.latency
            first = None if ctx.get(walk.empty) else ctx.get(walk.t_first)
        done.append(True)

    simulate(dut, feed, evaluate)
    return found


def modelled(hops, events):
    """The same of the model, and where each hop's result crops."""
    given = dataclasses.replace(BatchSettings.from_config(CONFIG, CORNER), min_roi_events=4, **hops)
    sliding, wide = Sliding(CONFIG, given), (1 << ring.address_bits(CONFIG)) - 1
    found, low = [], (1 << CONFIG.span_bits) - 1
    state = sliding.window[0], sliding._origin, 0
    closed = int(events[0][0])
    close = sliding._close

    def noted(now):
        nonlocal state, closed
        t, x, y = (axis.tolist() for axis in sliding.window)
        held, origin, begin = state
        phases = tuple((f // 2 + (begin - origin) * f) % (1 << DITHER_BITS) for f in FACTORS)
        first = int(held[0]) & low if len(held) else None
        out = [(a & low, b, c) for a, b, c in zip(t, x, y, strict=True)]
        stale = int(now - closed > (hops["window_us"] or 1 << (CONFIG.span_bits - 1)))
        found.append((begin & wide, sliding.end & wide, now & low, stale, first, phases, out))
        hop = close(now)
        state, closed = (sliding.window[0], sliding._origin, sliding.begin), now
        return hop

    sliding._close = noted
    crops = [hop.roi_next for hop in sliding.run(*events)]
    return found, crops


@pytest.mark.parametrize("name", LENGTHS)
def test_windows_equal_the_model(name, rng):
    hops, events = LENGTHS[name], drawn(rng, 900)
    wanted, crops = modelled(hops, events)
    assert len(wanted) > 12 and len(set(crops)) > 1
    for how in ({}, {"busy": (0, 1), "gap": 0.0, "stall": 0.0}):
        assert windows(hops, events, crops, rng, **how) == wanted


def test_an_event_a_cycle(rng):
    """From the event that closes a hop to its last event out of the ring; none waits where nobody is late."""
    hops = LENGTHS["by number"]
    t = np.arange(63)
    dut = Windows()
    taken, came, closed = [], [], []

    async def bench(ctx):
        for name in ("window_events", "hop_events"):
            ctx.set(dut.control.lengths[name], hops[name])
        ctx.set(dut.control.free, 1)
        ctx.set(dut.ring.replay, 1)
        await ctx.tick()
        ctx.set(dut.ring.replay, 0)
        for cycle in range(30):
            ctx.set(dut.control.i.valid, int(cycle < 10))
            ctx.set(dut.control.i.payload, {"t": int(t[cycle]), "x": 3, "y": 4})
            if cycle < 10:
                assert ctx.get(dut.control.i.ready)
                taken.append(cycle)
            if ctx.get(dut.control.closed):
                closed.append(cycle)
                ctx.set(dut.ring.closed, 1)
                ctx.set(dut.control.free, 0)
            if ctx.get(dut.ring.o.valid):
                came.append((cycle, ctx.get(dut.ring.o.payload.last)))
            await ctx.tick()

    simulate(dut, bench)
    assert closed == [taken[6] + dut.control.latency]
    assert [cycle for cycle, _ in came] == [*range(came[0][0], came[0][0] + 7)]
    assert [last for _, last in came] == [0] * 6 + [1]
    # It stays one event behind: a cycle more than an event needs that comes alone.
    assert came[-1][0] == closed[0] + ring.Ring.write_latency + ring.Ring.latency


MUTANTS = {  # module, old, new
    "hop closes with one event more": (hop_control, "ending.eq(left == 2)", "ending.eq(left == 1)"),
    "hop closes after the event that is due": (hop_control, "Mux(stays & ~due, behind, place)", "behind"),
    "times of the hop before": (hop_control, "self.now.eq(now_s3)]", "self.now.eq(self.now)]"),
    "the ROI moves at once": (hop_control, "frac), roi[axis])", "frac), self.corner[axis])"),
    "a hop closes while one is evaluated": (hop_control, "free.eq(self.free & ", "free.eq(1 & "),
    "no pause is too long": (hop_control, "self.stale.eq(step_s1 > ", "self.stale.eq(0 & "),
    "an event too many stays": (walker, "held > most", "held > most + 1"),
    "events as old as they may be go": (walker, "> oldest", ">= oldest"),
    "a hop closes a µs late": (hop_control, "(now_s2 - target)", "(now_s2 - target - 1)"),
    "a dither of its own for each window": (walker, "phase.eq(phase + factor)", "phase.eq(factor // 2)"),
    "what is too many goes later": (walker, "counts & over", "0"),
    "the dither goes on in an empty window": (walker, "phase.eq(factor // 2)", "phase.eq(phase)"),
    "time of the event before": (walker, "self.t_first.eq(t_s3)", "self.t_first.eq(self.t_first)"),
    "the last one is not waited for": (ring, "last_s1.eq(closed & ", "last_s1.eq(1 & "),
    "the one behind is not waited for": (ring, "(last_s1 | more)", "1"),
    "written over": (ring, "write.addr.eq(write.addr + write.en)", "write.addr.eq(write.addr + 0)"),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_mutants_are_noticed(name, monkeypatch, rng):
    break_blocks(monkeypatch, *MUTANTS[name])
    events = drawn(rng, 500)
    with pytest.raises(AssertionError):
        for hops in LENGTHS.values():
            wanted, crops = modelled(hops, events)
            assert windows(hops, events, crops, rng) == wanted
