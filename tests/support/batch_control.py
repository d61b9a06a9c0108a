"""Ingest and iteration control, joined: a bench that plays the blocks around them, and what must begin when."""

import itertools
from dataclasses import dataclass, field

import numpy as np
from amaranth.hdl import Elaboratable, Module, Signal
from amaranth.lib.wiring import connect

from cmfpga.config import Config
from cmfpga.rtl import payloads
from cmfpga.rtl.ingest.ingest_control import IngestControl
from cmfpga.rtl.iteration_control import IterationControl
from support.bench import simulate
from support.values import Codec, Port, random_values

CONFIG = Config(max_batch_events=12, buffer_events=9, max_iterations=5, iterations=1)
PULSES = ("open", "take", "divide", "start", "replay", "move", "sweep")


@dataclass
class Plan:
    """One batch: what is offered, and how long the surroundings take."""

    count: int
    end: str = "last"  # or "count", "cut", "roi"
    iterations: int = 2
    minimum: int = 1
    stored: int = 5
    span: int = 100
    load: bool = False  # the batch loads its ROI
    eager: bool = False  # offered while the batch before is under way, not after its result has been taken
    idle: int = 0  # cycles before the first event is offered
    gaps: list = field(default_factory=lambda: [0])  # before the other events, in turn
    division: int = 7
    votes: int = 6  # from a replay to the pulse that the next v follows
    wait: int = 0  # cycles that the result waits
    limit: int = 0  # ROI events that end the batch
    inside: list = field(default_factory=lambda: [True])  # with a limit: which events are in the ROI, in turn

    def __post_init__(self):
        #: cycles in which an event was accepted, the first one offered, and the result taken, set by the bench
        self.accepted, self.offered, self.taken, self.payloads = [], None, None, []
        if self.limit:
            reached = [self.inside[k % len(self.inside)] for k in range(CONFIG.max_batch_events)]
            if self.end == "roi":
                self.count = 1 + np.cumsum(reached).tolist().index(self.limit)
            self.stored = sum(reached[: self.count])

    @property
    def degenerate(self):
        return not self.stored or self.stored < self.minimum or not self.span or not self.iterations

    def counted(self, cycle, drain):
        """ROI events that have been counted by this cycle."""
        return sum(
            self.inside[k % len(self.inside)] for k, accepted in enumerate(self.accepted) if accepted + drain <= cycle
        )


class Control(Elaboratable):
    """Both, with their ports as attributes; ``taken_in`` is what the ingest's blocks say, in one."""

    def __init__(self, config, *, drain, replay_delay, move, settle):
        self.ingest = ingest = IngestControl(config, drain=drain)
        self.iterate = iterate = IterationControl(config, replay_delay=replay_delay, move=move, settle=settle)
        self.taken_in = Signal(payloads.batch(config))
        self.i, self.o, self.settings, self.cleared = ingest.i, ingest.o, ingest.settings, ingest.cleared
        self.sweep, self.open = ingest.clear, ingest.handover.opened
        self.take, self.batch = ingest.handover.take, ingest.handover.batch
        for name in ("start", "planned", "updated", "degenerate", "done"):
            setattr(self, name, getattr(iterate.run, name))
        names = ("divide", "replay", "move", "divided", "complete", "iterating", "iterations", "cycles", "taken")
        for name in names:
            setattr(self, name, getattr(iterate, name))

    def elaborate(self, platform):
        m = Module()
        m.submodules.ingest, m.submodules.iterate = ingest, iterate = self.ingest, self.iterate
        connect(m, ingest.handover, iterate.handover)
        said = {"count": self.taken_in.roi_events, "overflow": self.taken_in.overflow}
        for bundle in (ingest.measured, ingest.stored, ingest.corner):
            for name in bundle.signature.members:
                m.d.comb += getattr(bundle, name).eq(said[name] if name in said else self.taken_in[name])
        m.d.comb += ingest.thinned.eq(self.taken_in.thinned)
        return m


def control(*, buffers=1, drain=4, replay_delay=3, move=3, settle=6, **_):
    return Control(CONFIG.replace(buffers=buffers), drain=drain, replay_delay=replay_delay, move=move, settle=settle)


def surroundings(dut, plans, *, drain=4, replay_delay=3, feed=4, clear=5, seed=0, stop=None, **_):
    """A bench that plays the blocks around ``dut`` until all results are taken, or for ``stop`` cycles; and its log."""
    rng = np.random.default_rng(seed)
    names = ("taken_in", "planned", "divided", "complete", "updated", "cleared", "taken", "settings")
    inputs = {name: Port(getattr(dut, name)) for name in names}
    event, valid, ready = Port(dut.i.payload), Port(dut.i.valid), Port(dut.i.ready)
    flags = ("iterating", "degenerate", "done", "iterations", "cycles")
    outputs = {name: Port(getattr(dut, name)) for name in (*PULSES, *flags)}
    passed, passed_valid = Port(dut.o.payload), Port(dut.o.valid)
    batch = Port(dut.batch).bits
    noise = {name: random_values(getattr(dut, name).shape(), rng) for name in ("settings", "taken_in")}
    event_noise = random_values(dut.i.payload.shape(), rng)
    log = []
    for plan in plans:
        plan.settings = next(noise["settings"]) | {
            "iterations": plan.iterations,
            "min_roi_events": plan.minimum,
            "batch_events": plan.count if plan.end == "count" else 0,
            "batch_roi_events": plan.limit,
            "roi_load": int(plan.load),
        }
        for number in range(plan.count):
            last = int(plan.end == "last" and number == plan.count - 1)
            plan.payloads.append(next(event_noise) | {"last": last})

    async def bench(ctx):
        due = {name: set() for name in ("complete", "cleared", "updated", "divided")}
        filling = running = finished = gap = waited = 0  # batches taken in, handed over, with their result taken
        gap, limit = plans[0].idle, stop or 400 * (len(plans) + 1)
        for cycle in range(limit):
            plan = plans[filling] if filling < len(plans) else None
            number = len(plan.accepted) if plan else 0
            begins = plan and (number or plan.eager or finished == filling)
            offering = bool(begins and gap == 0)
            gap -= bool(begins and gap)
            if offering and number == 0 and plan.offered is None:
                plan.offered = cycle
            valid.set(ctx, int(offering))
            event.set(ctx, plan.payloads[number] if offering else next(event_noise))
            inputs["settings"].set(ctx, plan.settings if offering and number == 0 else next(noise["settings"]))
            # The counts are right only once the last event has passed the blocks in between.
            taken_in = dict(next(noise["taken_in"]))
            latest = plans[running] if running < len(plans) else None
            if latest and latest.limit:
                taken_in["roi_events"] = latest.counted(cycle, drain)
            if latest and len(latest.accepted) == latest.count and cycle >= latest.accepted[-1] + drain:
                taken_in |= {"roi_events": latest.stored, "span": latest.span}
            inputs["taken_in"].set(ctx, taken_in)
            under_way = plans[running - 1].iterations if running else int(rng.integers(CONFIG.max_iterations + 1))
            inputs["planned"].set(ctx, under_way)
            for name in due:
                inputs[name].set(ctx, int(cycle in due[name]))
            inputs["taken"].set(ctx, 0)
            # A sweep of a single address ends in the cycle in which it starts.
            if outputs["sweep"].get(ctx):
                due["cleared"].add(cycle + clear)
                inputs["cleared"].set(ctx, int(clear == 0))
            if outputs["done"].get(ctx):
                inputs["taken"].set(ctx, int(waited == plans[finished].wait))
            row = {name: port.get(ctx) for name, port in outputs.items()}
            row |= {"ready": ready.get(ctx), "passed": passed.get(ctx) if passed_valid.get(ctx) else None}
            row |= {"taken_in": taken_in, "batch": ctx.get(batch)}
            log.append(row)
            if row["divide"]:
                due["divided"].add(cycle + plans[running - 1].division)
            if row["replay"]:
                due["complete"].add(cycle + plans[running - 1].votes)
            if cycle in due["complete"] and row["iterating"]:
                due["updated"].add(cycle + replay_delay + feed)
            if row["take"]:
                assert running < len(plans), f"cycle {cycle}: another batch is handed over"
                running += 1
            if row["done"]:
                waited += 1
                if ctx.get(dut.taken):
                    plans[finished].taken, finished, waited = cycle, finished + 1, 0
            if offering and row["ready"]:
                plan.accepted.append(cycle)
                number += 1
                if number == plan.count:
                    filling += 1
                    gap = plans[filling].idle if filling < len(plans) else 0
                else:
                    gap = plan.gaps[number % len(plan.gaps)]
            await ctx.tick()
            if finished == len(plans):
                limit = min(limit, 20)
                valid.set(ctx, 0)
                inputs["taken"].set(ctx, 0)
                for _ in range(20):  # and nothing follows
                    log.append({name: port.get(ctx) for name, port in outputs.items()})
                    log[-1] |= {"ready": ready.get(ctx), "passed": None, "batch": ctx.get(batch)}
                    await ctx.tick()
                return
        assert stop, f"{finished} of {len(plans)} results; {filling} batches accepted, {running} handed over"

    return bench, log


def play(plans, **options):
    """Simulate from power-up; returns the control's outputs of every cycle."""
    dut = control(**options)
    bench, log = surroundings(dut, plans, **options)
    simulate(dut, bench)
    return log


def check(plans, **options):
    """Every pulse in its cycle and in no other; counters and flags with the result."""
    log = play(plans, **options)
    compare(plans, log, **options)
    return log


def compare(plans, log, *, buffers=1, drain=4, replay_delay=3, feed=4, move=3, settle=6, clear=5, **_):
    expected = {name: set() for name in (*PULSES, "done", "iterating", "ready")}
    expected["sweep"] = {0}
    results, passed = [], {}
    free = clear + 1  # first cycle in which a batch may open
    idle = 0  # first cycle in which one may be handed over
    found = None  # first cycle of the last result
    for plan in plans:
        opened = max(plan.offered, free)
        expected["open"].add(opened)
        check_accepted(plan, opened, drain)
        last = plan.accepted[-1]
        expected["ready"] |= {cycle for cycle in range(opened + 1, last + 1) if not plan.limit or log[cycle]["ready"]}
        passed |= dict(zip(plan.accepted, plan.payloads, strict=True))
        take = last + drain + 2 * (plan.end == "roi")
        if buffers == 2:
            # The ROI moves when both are there: the last result, and the next batch with its settings.
            both = opened + 1 if found is None else max(opened, found) + 1
            if found is not None and not plan.load:
                expected["move"].add(both)
            take = max(take, idle, both + settle + 1)
        expected["take"].add(take)
        judged = take + IterationControl.hand_over
        done = judged + 1
        if not plan.degenerate:
            start = judged + plan.division
            expected["divide"].add(judged)
            expected["start"].add(start)
            replay = start
            for _ in range(plan.iterations):
                expected["replay"].add(replay)
                swept = replay + plan.votes
                updated = swept + replay_delay + feed
                replay = swept + replay_delay
            expected["iterating"] |= set(range(start + 1, updated + 1))
            done = updated + 1
            if buffers == 1:
                expected["move"].add(updated)
                done = updated + move
        taken = done + plan.wait
        assert plan.taken == taken
        expected["done"] |= set(range(done, taken + 1))
        results.append((plan, opened, take, done))
        found, idle = done, taken + 1
        free = taken + 1 if buffers == 1 else take + 1
    for name, cycles in expected.items():
        assert [cycle for cycle, row in enumerate(log) if row[name]] == sorted(cycles), name
    assert {cycle: row["passed"] for cycle, row in enumerate(log) if row["passed"]} == passed
    takes = [take for _, _, take, _ in results]
    codec = Codec(payloads.batch(CONFIG))
    for (plan, opened, take, done), until in zip(results, [*takes[1:], len(log) - 1], strict=True):
        # What is known of a batch when it is handed over stays until the next one is.
        known = log[take]["taken_in"] | {
            "settings": plan.settings,
            "events": plan.count,
            "cut": int(plan.end == "cut"),
            "roi_events": plan.stored,
            "span": plan.span,
        }
        assert {row["batch"] for row in log[take + 1 : until + 1]} == {codec.pack(known)}
        for row in log[done : plan.taken + 1]:
            assert {name: row[name] for name in ("iterations", "cycles", "degenerate")} == {
                "iterations": 0 if plan.degenerate else plan.iterations,
                "cycles": done - opened,
                "degenerate": plan.degenerate,
            }


def check_accepted(plan, opened, drain):
    """One event per cycle as offered; near the limit of ROI events only after those before have been counted."""
    assert len(plan.accepted) == plan.count and plan.accepted[0] == opened + 1
    for number, (a, b) in enumerate(itertools.pairwise(plan.accepted), 1):
        offered = a + 1 + plan.gaps[number % len(plan.gaps)]
        before = plan.accepted[:number]

        def counted(cycle, before=before):
            inside = itertools.cycle(plan.inside)
            return sum(int(stored) for stored, c in zip(inside, before, strict=False) if c + drain <= cycle)

        # Safe even if all that are accepted but not counted by then are stored; at the latest when an event may be
        # both counted and waiting for a cycle.
        first, latest = (
            next(
                cycle
                for cycle in range(offered, offered + drain + 2)
                if not plan.limit or counted(cycle) + sum(cycle - wait <= c for c in before) < plan.limit
            )
            for wait in (drain - 1, drain)
        )
        assert first <= b <= latest
