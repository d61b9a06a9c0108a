# amaranth: UnusedElaboratable=no
"""Ingest and iteration control, joined: what begins when, computed from the times at which their surroundings answer.

The bench plays the blocks around it, with delays of any length, and every output is compared in every cycle.
"""

import itertools
from dataclasses import dataclass, field

import numpy as np
import pytest
from amaranth.hdl import Elaboratable, Module, ResetInserter, Signal
from amaranth.lib.wiring import connect
from hypothesis import given
from hypothesis import strategies as st

from cmfpga.config import Config
from cmfpga.rtl import payloads
from cmfpga.rtl.ingest.ingest_control import IngestControl
from cmfpga.rtl.iteration_control import IterationControl
from support.bench import simulate
from support.values import Codec, Port, corners, random_values

CONFIG = Config(max_batch_events=12, buffer_events=9, max_iterations=5, iterations=1)
PULSES = ("open", "take", "divide", "start", "replay", "move", "sweep")
BUFFERS = pytest.mark.parametrize("buffers", [1, 2])


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
        take = last + drain + (plan.end == "roi")
        if buffers == 2:
            # The ROI moves when both are there: the last result, and the next batch with its settings.
            both = opened + 1 if found is None else max(opened, found) + 1
            if found is not None and not plan.load:
                expected["move"].add(both)
            take = max(take, idle, both + settle + 1)
        expected["take"].add(take)
        done = take + 2
        if not plan.degenerate:
            start = take + 1 + plan.division
            expected["divide"].add(take + 1)
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


BATCHES = [
    {"count": 3},
    {"count": 1, "idle": 9, "iterations": 1},
    {"count": 12, "end": "cut", "gaps": [0, 2, 1], "iterations": 5, "wait": 3},
    {"count": 5, "end": "count", "wait": 1, "division": 1},
    {"count": 12, "end": "last", "wait": 2},
    {"count": 12, "end": "count", "votes": 30},
    {"count": 1, "end": "count", "gaps": [3]},
]


@BUFFERS
@pytest.mark.parametrize("eager", [False, True])
def test_batches(buffers, eager):
    """Back to back, of all sizes, offered at once or late, with gaps, taken at once or late."""
    check([Plan(**batch, eager=eager) for batch in BATCHES], buffers=buffers)


@BUFFERS
@pytest.mark.parametrize(
    "delays",
    [
        {"drain": 1},
        {"replay_delay": 0},
        {"replay_delay": 1, "feed": 1},
        {"replay_delay": 12},
        {"move": 2},
        {"settle": 1},
        {"settle": 20},
        {"clear": 0},
        {"clear": 40},
        {"drain": 9, "move": 6, "replay_delay": 6, "feed": 8, "settle": 9},
    ],
    ids=str,
)
def test_delays(delays, buffers):
    """The parameters, from the shortest that each may be."""
    votes = delays.get("feed", 4) + 1
    for eager in (False, True):
        plans = [Plan(count=3, votes=votes, iterations=3), Plan(count=1, votes=votes), Plan(count=2, stored=0)]
        plans += [Plan(count=5, limit=2, end="roi", votes=votes), Plan(count=3, votes=votes, load=True)]
        for plan in plans:
            plan.eager = eager
        check(plans, buffers=buffers, **delays)


@BUFFERS
def test_degenerate_batches(buffers):
    """Each condition, and what just does not meet it; no division is begun, so none is left for the next batch."""
    log = check(
        [
            Plan(count=2, stored=0, minimum=0),
            Plan(count=2, stored=1, minimum=0),
            Plan(count=2, stored=4, minimum=5),
            Plan(count=2, stored=5, minimum=5),
            Plan(count=2, span=0, wait=1, eager=True),
            Plan(count=2, span=1, eager=True),
            Plan(count=2, iterations=0, eager=True),
            Plan(count=2, iterations=1, eager=True),
            Plan(count=2, stored=9, minimum=9, span=(1 << CONFIG.span_bits) - 1),
        ],
        buffers=buffers,
    )
    assert sum(row["divide"] for row in log) == sum(row["start"] for row in log) == 5


def test_no_event_is_accepted_while_busy():
    """An event offered from the start waits for the sweep after the reset, and then for each result to be taken."""
    log = check([Plan(count=2, wait=9, eager=True), Plan(count=2, wait=5, eager=True), Plan(count=2)], clear=30)
    assert not any(row["ready"] for row in log[:32]) and log[32]["ready"]


def test_with_two_buffers_the_next_batch_is_accepted_while_iterations_run():
    """But only the next: the one after it waits until that has been handed over."""
    plans = [Plan(count=12, iterations=5, eager=True, division=1, wait=20) for _ in range(4)]
    log = check(plans, buffers=2)
    takes = [cycle for cycle, row in enumerate(log) if row["take"]]
    assert sum(log[cycle]["iterating"] for cycle in plans[1].accepted + plans[2].accepted) == 2 * 11
    for before, plan in zip(takes, plans[1:], strict=False):
        assert plan.accepted[0] == before + 2
    for plan, following in zip(plans, takes[1:], strict=False):
        assert following > plan.taken


@pytest.mark.parametrize("load", [False, True])
@pytest.mark.parametrize("late", range(0, 50, 7))
def test_with_two_buffers_the_roi_moves_once_a_batch(late, load):
    """After the result and the next batch's first event, whichever is later; not where that batch loads its ROI."""
    plans = [
        Plan(count=3, wait=4, eager=True),
        Plan(count=3, idle=late, load=load, eager=True),
        Plan(count=2, stored=0, idle=late, eager=True),
        Plan(count=3, load=load, eager=True),
        Plan(count=3),
    ]
    log = check(plans, buffers=2)
    # Also after a batch that measured nothing: the ROI updater is told that it is still.
    assert sum(row["move"] for row in log) == (2 if load else 4)
    settled = 0
    for cycle, row in enumerate(log):
        if row["move"]:
            settled = cycle + 6
            assert not (row["take"] or row["open"])
        assert not row["take"] or (cycle > settled and not row["iterating"] and not row["done"])
        assert not row["open"] or cycle > settled


@BUFFERS
@pytest.mark.parametrize("inside", [[1], [0, 1], [1, 0, 0], [0, 0, 0, 1]], ids=str)
@pytest.mark.parametrize("gaps", [[0], [0, 3, 1], [6]], ids=str)
def test_a_batch_ends_with_its_roi_events(gaps, inside, buffers):
    """Not one event more is accepted, though the next is offered all the time and what is stored is known late."""
    limits = range(1, min(9, sum(inside[k % len(inside)] for k in range(11))) + 1)
    plans = [Plan(count=0, end="roi", limit=limit, inside=inside, gaps=gaps, eager=True) for limit in limits]
    # Another end first, or in the same event.
    for count in (1, 2, 4, 5):
        plans.append(Plan(count=count, limit=sum(inside[k % len(inside)] for k in range(count)) + 1, inside=inside))
        plans.append(Plan(count=12, end="cut", limit=9, inside=[0, *inside], gaps=gaps, eager=True))
    reached = max(1, sum(inside[k % len(inside)] for k in range(4)))
    plans.append(Plan(count=4, limit=reached, inside=inside, eager=True))
    plans.append(Plan(count=4, end="count", limit=reached, inside=inside, eager=True))
    check([plan for plan in plans if plan.end == "roi" or plan.stored <= plan.limit], buffers=buffers)


@BUFFERS
def test_the_largest_batch_counts_as_cut_also_where_its_last_event_reaches_the_limit(buffers):
    """Whether an event is stored is not known when it is accepted."""
    plan = Plan(count=0, end="roi", limit=3, inside=[0, 0, 0, 1])
    assert plan.count == CONFIG.max_batch_events
    plan.end = "cut"
    check([plan, Plan(count=2)], buffers=buffers)


@BUFFERS
@pytest.mark.parametrize("first", range(0, 130, 9))
def test_reset_at_any_time(first, buffers):
    """Whatever is under way is forgotten: what comes then is as after power-up."""
    dut = control(buffers=buffers)
    reset, top = Signal(), Module()
    top.submodules.dut = ResetInserter(reset)(dut)
    broken = [Plan(count=4, eager=True, iterations=3, wait=3), *(Plan(count=4, eager=True) for _ in range(9))]
    plans = [Plan(count=3, eager=True), Plan(count=2, eager=True, load=True), Plan(count=4, eager=True)]
    before, _ = surroundings(dut, broken, stop=first + 1)
    after, log = surroundings(dut, plans)

    async def bench(ctx):
        await before(ctx)
        for name in ("divided", "complete", "updated", "cleared", "taken"):
            ctx.set(getattr(dut, name), 0)
        ctx.set(dut.i.valid, 0)
        ctx.set(reset, 1)
        await ctx.tick()
        ctx.set(reset, 0)
        await after(ctx)

    simulate(top, bench)
    compare(plans, log, buffers=buffers)


def test_replay_cannot_start_before_the_last_event_is_counted():
    with pytest.raises(ValueError, match="2 cycles before the last event is counted"):
        IterationControl(CONFIG, replay_delay=-2, move=3, settle=6)


@corners
@given(st.data())
def test_corners(data):
    fields = {
        "iterations": st.integers(0, CONFIG.max_iterations),
        "minimum": st.integers(0, CONFIG.buffer_events),
        "span": st.sampled_from([0, 1, 77]),
        "load": st.booleans(),
        "eager": st.booleans(),
        "idle": st.integers(0, 30),
        "gaps": st.lists(st.integers(0, 2), min_size=1, max_size=3),
        "division": st.integers(1, 12),
        "votes": st.integers(5, 15),
        "wait": st.integers(0, 30),
    }
    ends = {"count": st.integers(1, CONFIG.max_batch_events), "end": st.sampled_from(["last", "count"])}
    by_roi = {"count": st.just(0), "end": st.just("roi"), "limit": st.integers(1, 3)}
    pattern = st.lists(st.booleans(), min_size=0, max_size=2).map(lambda inside: [*inside, True])
    plan = st.one_of(
        st.builds(Plan, **fields, **ends, stored=st.integers(0, CONFIG.buffer_events)),
        st.builds(Plan, **fields, **by_roi, inside=pattern),
    )
    plans = data.draw(st.lists(plan, min_size=2, max_size=5))
    check(plans, buffers=data.draw(st.sampled_from([1, 2])))
