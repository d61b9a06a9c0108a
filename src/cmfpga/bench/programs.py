"""What the programs take, in seconds."""

import contextlib
import platform
import statistics
import time
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

from .opponents import Job
from .opponents.timing import Times, side_by_side


@dataclass(frozen=True, kw_only=True)
class ProgramRow:
    """What a program takes for a case.

    Parameters
    ----------
    batch, ascent : Times
        Of the whole batch; of what is left when the last event has arrived.
    v : (float, float)
        Result, px per half batch.
    error : float or None
        Difference of its gradient from the float64 reference's, relative to the largest gradient: the median over some
        v and all levels; None without PyTorch.
    """

    name: str
    how: str
    batch: Times
    ascent: Times
    v: tuple
    error: float | None


def make_job(case, v_start=(0.0, 0.0)):
    """The :class:`~cmfpga.bench.opponents.Job` of a case."""
    batch = case.workload
    return Job(
        events=batch.events, roi=batch.roi, width=batch.width, height=batch.height, iterations=case.iterations,
        schedule=case.schedule, dither=case.schedule is not None, v_start=v_start,
    )  # fmt: skip


def time_programs(case, programs, *, runs, seconds, v_start, step=lambda: None):
    """A :class:`ProgramRow` of each program."""
    job = make_job(case, v_start)
    with contextlib.ExitStack() as stack:
        loaded = [stack.enter_context(contextlib.closing(program.load(job))) for program in programs]
        v = [each.batch() for each in loaded]
        errors = _errors(case, programs, loaded)
        clocks = [program.clock for program in programs]
        options = {"runs": runs, "seconds": seconds, "clocks": clocks, "step": step}
        batches = side_by_side([each.batch for each in loaded], **options)
        ascents = side_by_side([each.ascent for each in loaded], **options)
    rows = zip(programs, batches, ascents, v, errors, strict=True)
    return [
        ProgramRow(name=program.name, how=program.how, batch=batch, ascent=ascent, v=at, error=error)
        for program, batch, ascent, at, error in rows
    ]


def time_foreign(case, *, runs, seconds):
    """A row, JSON-ready, of each foreign program: the whole batch from v = 0, by its own search, on all its threads.

    Raises :exc:`~cmfpga.errors.MissingPackage` where it is not installed.
    """
    from ..accuracy.foreign import FOREIGN
    from ..accuracy.foreign import find as find_v

    batch = case.workload

    def find(count=1):
        return [find_v(batch.events, batch.roi, batch.width, batch.height)[0] for _ in range(count)][-1]

    v = find()
    (times,) = side_by_side([find], runs=runs, seconds=seconds, clocks=[time.perf_counter])
    return [{"name": FOREIGN, "how": f"{FOREIGN} {version(FOREIGN)}", "batch": asdict(times), "v": v}]


def _errors(case, programs, loaded):
    """See :class:`ProgramRow`."""
    reference = next((each for program, each in zip(programs, loaded, strict=True) if program.is_reference), None)
    if reference is None:
        return [None] * len(loaded)
    levels = sorted({entry.level for entry in case.schedule or ()} | {0})
    v_x, v_y = case.workload.v
    places = [
        (v, level) for v in ((0.113, 0.207), (0.491 * v_x, 0.337 * v_y), (0.973 * v_x, 1.031 * v_y)) for level in levels
    ]
    right = [reference.gradient(*place) for place in places]
    largest = max(abs(axis) for g in right for axis in g)
    found = []
    for each in loaded:
        got = [each.gradient(*place) for place in places]
        # The median, because one event that float32 rounds over a pixel's border would decide the largest.
        errors = [max(map(abs, (a[0] - b[0], a[1] - b[1]))) for a, b in zip(got, right, strict=True)]
        found.append(statistics.median(errors) / largest)
    return found


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
