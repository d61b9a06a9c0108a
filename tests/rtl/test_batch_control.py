# amaranth: UnusedElaboratable=no
"""Batch control, alone: when it begins what, computed from the times at which its surroundings answer.

The bench plays the blocks around it, with delays of any length, and every output is compared in every cycle.
"""

from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cmfpga.config import Config
from cmfpga.rtl.batch_control import BatchControl

from .bench import Port, corners, np, random_value, random_values, simulate

CONFIG = Config(max_batch_events=12, buffer_events=9, max_iterations=5, iterations=1)
PULSES = ("open", "divide", "start", "replay", "move", "sweep")


@dataclass
class Plan:
    """One batch: what is offered, and how long the surroundings take."""

    count: int
    end: str = "last"  # or "count", "cut"
    iterations: int = 2
    minimum: int = 1
    stored: int = 5
    span: int = 100
    idle: int = 0  # cycles before the first event is offered
    gaps: list = field(default_factory=lambda: [0])  # before the other events, in turn
    division: int = 7
    votes: int = 6  # from a replay to the pulse that the next v follows
    wait: int = 0  # cycles that the result waits
    #: cycle of the last event, set by the bench
    accepted: list = field(default_factory=list)

    @property
    def degenerate(self):
        return not self.stored or self.stored < self.minimum or not self.span or not self.iterations


def play(plans, *, drain=4, replay_delay=3, feed=4, move=3, clear=5, seed=0):
    """Simulate; returns the control's outputs of every cycle."""
    rng = np.random.default_rng(seed)
    dut = BatchControl(CONFIG, drain=drain, replay_delay=replay_delay, move=move)
    names = ("stored", "span", "planned", "divided", "evaluate", "updated", "cleared", "taken", "settings")
    inputs = {name: Port(getattr(dut, name)) for name in names}
    event, valid, ready = Port(dut.i.payload), Port(dut.i.valid), Port(dut.i.ready)
    flags = ("iterating", "degenerate", "cut", "done", "current", "events", "iterations", "cycles")
    outputs = {name: Port(getattr(dut, name)) for name in (*PULSES, *flags)}
    passed, passed_valid = Port(dut.o.payload), Port(dut.o.valid)
    settings_noise = random_values(dut.settings.shape(), rng)
    log = []

    async def bench(ctx):
        cycle, due = 0, {name: set() for name in ("evaluate", "cleared", "updated", "divided")}

        async def step(offer=None, settings=None, taken=0, plan=None):
            """One cycle; whether the offered event was accepted."""
            nonlocal cycle
            plan = plan or Plan(count=1)
            valid.set(ctx, int(offer is not None))
            event.set(ctx, offer or random_value(dut.i.payload.shape(), rng))
            inputs["settings"].set(ctx, settings or next(settings_noise))
            inputs["taken"].set(ctx, taken)
            # The counts are right only once the last event has passed the blocks in between.
            drained = bool(plan.accepted) and len(plan.accepted) == plan.count
            drained = drained and cycle >= plan.accepted[-1] + drain
            inputs["stored"].set(ctx, plan.stored if drained else int(rng.integers(CONFIG.buffer_events + 1)))
            inputs["span"].set(ctx, plan.span if drained else int(rng.integers(3)))
            for name in due:
                inputs[name].set(ctx, int(cycle in due[name]))
            inputs["planned"].set(ctx, plan.iterations if drained else int(rng.integers(CONFIG.max_iterations + 1)))
            # A sweep of a single address ends in the cycle in which it starts.
            if outputs["sweep"].get(ctx):
                due["cleared"].add(cycle + clear)
                inputs["cleared"].set(ctx, int(clear == 0))
            row = {name: port.get(ctx) for name, port in outputs.items()}
            row |= {"ready": ready.get(ctx), "passed": passed.get(ctx) if passed_valid.get(ctx) else None}
            row["evaluate"] = ctx.get(dut.evaluate)
            log.append(row)
            if row["divide"]:
                due["divided"].add(cycle + plan.division)
            if row["replay"]:
                due["evaluate"].add(cycle + plan.votes)
            if row["evaluate"] and row["iterating"]:
                due["updated"].add(cycle + replay_delay + feed)
            accepted = bool(offer is not None and row["ready"])
            if accepted:
                plan.accepted.append(cycle)
            await ctx.tick()
            cycle += 1
            return accepted

        for plan in plans:
            for _ in range(plan.idle):
                await step()
            settings = next(settings_noise) | {
                "iterations": plan.iterations,
                "min_roi_events": plan.minimum,
                "batch_events": plan.count if plan.end == "count" else 0,
            }
            plan.settings = settings
            plan.payloads = []
            for number in range(plan.count):
                for _ in range(plan.gaps[number % len(plan.gaps)] if number else 0):
                    await step(plan=plan)
                offer = random_value(dut.i.payload.shape(), rng)
                offer["last"] = int(plan.end == "last" and number == plan.count - 1)
                plan.payloads.append(offer)
                # Random settings as soon as the first event has been accepted.
                for _ in range(100):
                    if await step(offer, settings if number == 0 else None, plan=plan):
                        break
                else:
                    raise AssertionError(f"event {number} of {plan.count} is not accepted")
            # The next batch's first event stands at the input already, where it must not disturb.
            early = random_value(dut.i.payload.shape(), rng) if plan.wait % 2 else None
            for _ in range(300):
                if log[-1]["done"]:
                    break
                await step(early, plan=plan)
            else:
                raise AssertionError(f"no result; {log[-1]['iterations']} of {plan.iterations} iterations")
            for _ in range(plan.wait):
                await step(early, plan=plan)
            await step(early, taken=1, plan=plan)

    simulate(dut, bench)
    return log


def check(plans, **delays):
    """Every pulse in its cycle and in no other; counters and flags with the result."""
    log = play(plans, **delays)
    drain, replay_delay, feed = delays.get("drain", 4), delays.get("replay_delay", 3), delays.get("feed", 4)
    move = delays.get("move", 3)
    expected = {name: set() for name in (*PULSES, "done", "iterating", "ready")}
    expected["sweep"] = {0}
    results, passed = [], {}
    free = delays.get("clear", 5) + 1  # first cycle in which a batch may open
    offer = 0
    for plan in plans:
        offer += plan.idle
        opened = max(offer, free)
        expected["open"].add(opened)
        assert plan.accepted[0] == opened + 1
        assert all(b - a == 1 + plan.gaps[n % len(plan.gaps)] for n, (a, b) in
                   enumerate(zip(plan.accepted, plan.accepted[1:], strict=False), 1))  # fmt: skip
        last = plan.accepted[-1]
        expected["ready"] |= set(range(opened + 1, last + 1))
        passed |= dict(zip(plan.accepted, plan.payloads, strict=True))
        end = last + drain
        done = end + 1
        if not plan.degenerate:
            start = end + plan.division
            expected["divide"].add(end)
            expected["start"].add(start)
            replay = start
            for _ in range(plan.iterations):
                expected["replay"].add(replay)
                swept = replay + plan.votes
                updated = swept + replay_delay + feed
                replay = swept + replay_delay
            expected["iterating"] |= set(range(start + 1, updated + 1))
            expected["move"].add(updated)
            done = updated + move
        taken = done + plan.wait + 1  # the bench sees `done`, then waits, then takes
        expected["done"] |= set(range(done, taken + 1))
        results.append((plan, opened, done, taken))
        free = offer = taken + 1
    for name, cycles in expected.items():
        assert [cycle for cycle, row in enumerate(log) if row[name]] == sorted(cycles), name
    assert {cycle: row["passed"] for cycle, row in enumerate(log) if row["passed"]} == passed
    for plan, opened, done, taken in results:
        for row in log[opened + 1 : taken + 1]:
            assert row["current"] == plan.settings
        for row in log[done : taken + 1]:
            got = {name: row[name] for name in ("events", "iterations", "cycles", "degenerate", "cut")}
            assert got == {
                "events": plan.count,
                "iterations": 0 if plan.degenerate else plan.iterations,
                "cycles": done - opened,
                "degenerate": plan.degenerate,
                "cut": plan.end == "cut",
            }
    return log


def test_batches(rng):
    """Back to back, of all sizes, offered at once or late, with gaps, taken at once or late."""
    check(
        [
            Plan(count=3),
            Plan(count=1, idle=9, iterations=1),
            Plan(count=12, end="cut", gaps=[0, 2, 1], iterations=5, wait=3),
            Plan(count=5, end="count", wait=1, division=1),
            Plan(count=12, end="last", wait=2),
            Plan(count=12, end="count", votes=30),
            Plan(count=1, end="count", gaps=[3]),
        ]
    )


@pytest.mark.parametrize(
    "delays",
    [
        {"drain": 1},
        {"replay_delay": 0},
        {"replay_delay": 1, "feed": 1},
        {"replay_delay": 12},
        {"move": 2},
        {"clear": 0},
        {"clear": 40},
        {"drain": 9, "move": 6, "replay_delay": 6, "feed": 8},
    ],
    ids=str,
)
def test_delays(delays):
    """The parameters, from the shortest that each may be."""
    votes = delays.get("feed", 4) + 1
    check([Plan(count=3, votes=votes, iterations=3), Plan(count=1, votes=votes), Plan(count=2, stored=0)], **delays)


def test_degenerate_batches():
    """Each condition, and what just does not meet it; no division is begun, so none is left for the next batch."""
    log = check(
        [
            Plan(count=2, stored=0, minimum=0),
            Plan(count=2, stored=1, minimum=0),
            Plan(count=2, stored=4, minimum=5),
            Plan(count=2, stored=5, minimum=5),
            Plan(count=2, span=0, wait=1),
            Plan(count=2, span=1),
            Plan(count=2, iterations=0),
            Plan(count=2, iterations=1),
            Plan(count=2, stored=9, minimum=9, span=(1 << CONFIG.span_bits) - 1),
        ]
    )
    assert sum(row["divide"] for row in log) == sum(row["start"] for row in log) == 5


def test_no_event_is_accepted_while_busy():
    """An event offered from the start waits for the sweep after the reset, and then for each result to be taken."""
    log = check([Plan(count=2, wait=9), Plan(count=2, wait=5), Plan(count=2)], clear=30)
    assert not any(row["ready"] for row in log[:32]) and log[32]["ready"]


def test_replay_cannot_start_before_the_last_event_is_counted():
    with pytest.raises(ValueError, match="2 cycles before the last event is counted"):
        BatchControl(CONFIG, drain=4, replay_delay=-2, move=3)


@corners
@given(st.data())
def test_corners(data):
    plan = st.builds(
        Plan,
        count=st.integers(1, CONFIG.max_batch_events),
        end=st.sampled_from(["last", "count"]),
        iterations=st.integers(0, CONFIG.max_iterations),
        minimum=st.integers(0, CONFIG.buffer_events),
        stored=st.integers(0, CONFIG.buffer_events),
        span=st.sampled_from([0, 1, 77]),
        idle=st.integers(0, 3),
        gaps=st.lists(st.integers(0, 2), min_size=1, max_size=3),
        division=st.integers(1, 12),
        votes=st.integers(5, 15),
        wait=st.integers(0, 3),
    )
    check(data.draw(st.lists(plan, min_size=2, max_size=4)))
