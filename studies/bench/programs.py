"""What the programs take, in seconds, side by side."""

import contextlib
import platform
import statistics
import time
from importlib.metadata import version
from pathlib import Path

from cmfpga.errors import MissingPackage

from .opponents import Job, Unavailable


def times_of(seconds):
    """Seconds of one run: median, and the range of all runs."""
    return {"median": statistics.median(seconds), "low": min(seconds), "high": max(seconds)}


def side_by_side(actions, *, runs, seconds, clock=time.thread_time, step=lambda: None):
    """:func:`times_of` a repetition of ``actions``, in turn, so that a slow moment of the machine hits all.

    Each action does its work a given number of times; it is called once before, so that nothing is compiled or paged in
    while timed. A run repeats it until it lasts about ``seconds``; short work could not be timed otherwise. The
    ``clock`` is by default this thread's, which other work on the machine does not lengthen. ``step`` is called after
    every run.
    """
    counts = [_count(action, clock, seconds) for action in actions]
    taken = [[] for _ in actions]
    for _ in range(runs):
        for action, count, into in zip(actions, counts, taken, strict=True):
            start = clock()
            action(count)
            into.append((clock() - start) / count)
            step()
    return [times_of(into) for into in taken]


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


@contextlib.contextmanager
def or_missing(missing):
    """What cannot be measured for want of a package or a compiler is a line of ``missing``."""
    try:
        yield
    except (MissingPackage, Unavailable) as reason:
        missing.append(str(reason))


def time_programs(case, programs, *, v_start, **options):
    """A row, JSON-ready, of each program; and one with the confidence, which the article's ascent has not.

    ``batch`` is the time of the whole batch, ``ascent`` of what is left when the last event has arrived.
    """
    batch, signs = case.workload, case.steps is not None
    rows = [(program, probes) for probes in (False, True)[: 1 + signs] for program in programs]
    with contextlib.ExitStack() as stack:
        loaded = []
        for program, probes in rows:
            job = Job(
                events=batch.events, roi=batch.roi, width=batch.width, height=batch.height,
                iterations=len(case.steps) if signs else case.iterations, schedule=case.steps,
                dither=signs, probes=probes, v_start=v_start,
            )  # fmt: skip
            loaded.append(stack.enter_context(contextlib.closing(program.load(job))))
        v = [each.batch() for each in loaded]
        batches, ascents = (
            side_by_side([getattr(each, what) for each in loaded], **options) for what in ("batch", "ascent")
        )
    names = [{"name": program.name + ", confidence" * probes, "how": program.how, "confidence": probes}
             for program, probes in rows]  # fmt: skip
    found = zip(names, batches, ascents, v, strict=True)
    return [{**name, "batch": batch, "ascent": ascent, "v": at} for name, batch, ascent, at in found]


def time_foreign(case, *, runs, seconds):
    """A row, JSON-ready, of each foreign program: the whole batch from v = 0, by its own search, on all its threads."""
    from ..accuracy.foreign import FOREIGN, find

    batch = case.workload

    def work(count):
        return [find(batch.events, batch.roi, batch.width, batch.height)[0] for _ in range(count)][-1]

    v = work(1)
    (times,) = side_by_side([work], runs=runs, seconds=seconds, clock=time.perf_counter)
    return [{"name": FOREIGN, "how": f"{FOREIGN} {version(FOREIGN)}", "batch": times, "v": v}]


def processor():
    """The processor's name, as far as the system tells, with family and model: virtual machines' say little."""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        found = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
        name = found.get("model name") or found.get("Model")
        if name:
            numbers = (("family", found.get("cpu family")), ("model", found.get("model")))
            return ", ".join([name, *(f"{which} {number}" for which, number in numbers if number)])
    return platform.processor() or platform.machine() or "unknown processor"
