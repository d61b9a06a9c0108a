"""What the programs take, in seconds."""

import contextlib
import platform
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
    confidence : bool
        With the probes of the confidence.
    v : (float, float)
        Result, px per half batch.
    """

    name: str
    how: str
    batch: Times
    ascent: Times
    confidence: bool
    v: tuple


def time_programs(case, programs, *, v_start, **options):
    """A :class:`ProgramRow` of each program; and one with the confidence, which the article's ascent has not."""
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
    return [
        ProgramRow(
            name=program.name + ", confidence" * probes, how=program.how, batch=batch, ascent=ascent,
            confidence=probes, v=at,
        )
        for (program, probes), batch, ascent, at in zip(rows, batches, ascents, v, strict=True)
    ]  # fmt: skip


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
    (times,) = side_by_side([find], runs=runs, seconds=seconds, clock=time.perf_counter)
    return [{"name": FOREIGN, "how": f"{FOREIGN} {version(FOREIGN)}", "batch": asdict(times), "v": v}]


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
