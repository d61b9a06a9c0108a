# amaranth: UnusedElaboratable=no
"""Ingest and iteration control, joined: what begins when, computed from the times at which their surroundings answer.

The bench plays the blocks around it, with delays of any length, and every output is compared in every cycle.
"""

import pytest
from amaranth.hdl import Module, ResetInserter, Signal
from hypothesis import given, settings
from hypothesis import strategies as st

from cmfpga.rtl.iteration_control import IterationControl
from support.batch_control import CONFIG, Plan, check, compare, control, surroundings
from support.bench import simulate

BUFFERS = pytest.mark.parametrize("buffers", [1, 2])

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
        {"drain": 1}, {"replay_delay": 0}, {"replay_delay": 1, "feed": 1}, {"replay_delay": 12}, {"move": 2},
        {"settle": 1}, {"settle": 20}, {"clear": 0}, {"clear": 40},
        {"drain": 9, "move": 6, "replay_delay": 6, "feed": 8, "settle": 9},
    ],
    ids=str,
)  # fmt: skip
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


@settings(derandomize=True, deadline=None, max_examples=12, database=None)
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
