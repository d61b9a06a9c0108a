"""Timing programs side by side."""

import statistics
import time
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Times:
    """Seconds of one run: median, and the range of all runs."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, seconds):
        """Of a list of runs."""
        return cls(median=statistics.median(seconds), low=min(seconds), high=max(seconds))


def side_by_side(actions, *, runs, seconds, clock=time.thread_time, step=lambda: None):
    """Time ``actions``, functions of a count of repetitions, in turn, so that a slow moment of the machine hits all.

    Parameters
    ----------
    actions : list of callables
        Each does its work ``count`` times. Called once before, so that nothing is compiled or paged in while timed.
    runs : int
        How often each is timed.
    seconds : float
        A run repeats an action until it lasts about this long; short work could not be timed otherwise.
    clock : callable
        By default the time that the processor gave to this thread, which other work on the machine does not lengthen.
    step : callable
        Called after every run, for a progress bar.

    Returns
    -------
    list of Times, per repetition
    """
    counts = [_count(action, clock, seconds) for action in actions]
    taken = [[] for _ in actions]
    for _ in range(runs):
        for action, count, into in zip(actions, counts, taken, strict=True):
            start = clock()
            action(count)
            into.append((clock() - start) / count)
            step()
    return [Times.of(into) for into in taken]


def _count(action, clock, seconds):
    action(1)
    count = 1
    while True:
        start = clock()
        action(count)
        took = clock() - start
        if took >= seconds / 4 or count >= 1 << 20:
            return max(1, round(count * seconds / took)) if took > 0 else count
        count *= 4
