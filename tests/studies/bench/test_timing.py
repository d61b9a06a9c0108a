"""Timing, on a clock that is turned by hand."""

import pytest
from studies.bench.programs import Times, side_by_side


class Machine:
    """Actions on a machine whose clock only moves by what they take."""

    def __init__(self):
        self.now = 0.0
        self.calls = []

    def clock(self):
        return self.now

    def action(self, name, seconds):
        def act(count):
            self.calls.append((name, count))
            self.now += count * seconds

        return act


def test_median_and_range():
    assert Times.of([5.0, 1.0, 2.0]) == Times(median=2.0, low=1.0, high=5.0)


def test_side_by_side():
    machine = Machine()
    steps = []
    actions = [machine.action("short", 1e-5), machine.action("long", 0.5)]
    options = {"runs": 3, "seconds": 0.02, "clock": machine.clock, "step": lambda: steps.append(1)}
    short, long = side_by_side(actions, **options)
    for times, seconds in ((short, 1e-5), (long, 0.5)):
        assert (times.low, times.median, times.high) == pytest.approx((seconds,) * 3)
    # In turn, the short one repeated until it can be timed, the long one not at all.
    assert [name for name, _ in machine.calls[-6:]] == ["short", "long"] * 3 and len(steps) == 6
    assert machine.calls[-2:] == [("short", 2000), ("long", 1)]


def test_a_clock_that_stands_still_ends_too():
    machine = Machine()
    (times,) = side_by_side([machine.action("nothing", 0.0)], runs=1, seconds=0.01, clock=machine.clock)
    assert times.median == 0.0
