"""``python -m cmfpga.bench``: the core's clock cycles beside the time that programs need for the same work."""

import contextlib
import json
import os
import platform
import statistics
import time
import warnings
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path

from tqdm import tqdm

from .. import __version__, cli
from ..config import preset
from ..engines.rtl import find_compiler
from ..errors import ConfigError
from ..protocol.settings import BatchSettings, schedule_table, settings_values
from .opponents import Job, make_programs
from .opponents.report import table
from .opponents.timing import Times, side_by_side
from .opponents.workloads import make_workload

EXAMPLES = (
    "python -m cmfpga.bench",
    "python -m cmfpga.bench --quick --json bench.json",
    "python -m cmfpga.bench --clock 150        # MHz that you assume the core to reach",
)

#: The clock that the article reports for its design on the KV260. Which one this core reaches is not known.
ARTICLE_MHZ = 210.0

#: Ascents: the article's, and the sign ascent without and with a last v.
CONSTANT, COLD, WARM = "constant", "cold", "warm"
ASCENTS = {
    CONSTANT: "the article's ascent, constant η",
    COLD: "sign ascent, cold",
    WARM: "sign ascent, warm",
}


@dataclass(frozen=True, kw_only=True)
class Design:
    """A core to be measured: what the table calls it, and its configuration."""

    name: str
    config: object


@dataclass(frozen=True, kw_only=True)
class Case:
    """One batch, one ascent: the cores that do it (the first is what programs are compared with), and the settings."""

    workload: object
    ascent: str
    designs: tuple
    iterations: int
    schedule: tuple | None = None

    def plan(self, iterations):
        """The first so many iterations, as ``Core.cycles`` wants them."""
        return iterations if self.schedule is None else self.schedule[:iterations]


@dataclass(frozen=True, kw_only=True)
class CoreRow:
    """What a core takes for a case, in clock cycles.

    Parameters
    ----------
    measured : bool
        Counted in the simulated Verilog; otherwise computed by ``Core.cycles`` because there is no C++ compiler.
    cycles : int
        From the offer of the batch's first event to its result.
    formula : int
        ``Core.cycles`` for the same batch.
    per_iteration : int
        What one iteration more takes.
    after_last : int
        From the last event's being taken to the result. Events are taken in N cycles after the first is offered.
    back_to_back : int or None
        From one result to the next where batches are offered without a pause: with two buffers, one is taken in while
        the one before is optimised. None if it was not simulated.
    v : (float, float) or None
        Result, px per half batch.
    """

    name: str
    measured: bool
    iterations: int
    cycles: int
    formula: int
    per_iteration: int
    after_last: int
    back_to_back: int | None
    v: tuple | None


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


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A case and its rows; ``article`` is the article's formula for its batch, in cycles."""

    case: Case
    article: int
    cores: list = field(default_factory=list)
    programs: list = field(default_factory=list)


def article_cycles(*, events, roi_events, pixels, iterations):
    """C_batch of the article: N + T·(n + L_r + P/4 + L_v) with L_r = 32 and L_v = 35."""
    return events + iterations * (roi_events + 32 + pixels // 4 + 35)


# -------------------------------------------------------------------- what is measured


def make_cases(quick=False):
    """The cases, in the order of the table; ``quick`` leaves out all but the article's batch with the presets."""
    paper, fast = preset("paper"), preset("fast")
    batch = make_workload("the article's batch", events=5000, roi_events=800)
    designs = [Design(name="core, preset paper", config=paper)]
    if not quick:
        designs.append(Design(name="core, paper in one pass", config=paper.replace(gradient="one_pass")))
    cases = [_constant(batch, designs, 100), *_signs(batch, "fast", fast)]
    if quick:
        return cases

    full, name = preset("full-frame"), "full-frame"
    batch = make_workload(
        "Kim and Kim's case", events=5000, roi_events=5000, width=full.roi_width, height=full.roi_height
    )
    size = {key: getattr(full, key) for key in ("roi_width", "roi_height", "buffer_events", "tag_bits", "ram_style")}
    large = paper.replace(**size)
    designs = [
        Design(name="core, paper at 240×180", config=large),
        Design(name="core, the same in one pass", config=large.replace(gradient="one_pass")),
    ]
    cases += [_constant(batch, designs, 90), *_signs(batch, name, full)]

    config = preset("fast-128")
    batch = make_workload(
        "the article's density on 128×128",
        events=20000,
        roi_events=3200,
        width=config.roi_width,
        height=config.roi_height,
    )
    return [*cases, *_signs(batch, "fast-128", config)]


def _constant(batch, designs, iterations):
    # From v = 0, as a program is; the ROI stays, so that batches can be repeated.
    fields = {"iterations": iterations, "start": "zero", "roi_gain": 0.0}
    designs = tuple(Design(name=design.name, config=design.config.replace(**fields)) for design in designs)
    return Case(workload=batch, ascent=CONSTANT, designs=designs, iterations=iterations)


def _signs(batch, name, config):
    designs = (Design(name=f"core, preset {name}", config=config.replace(roi_gain=0.0)),)
    for ascent, schedule in ((COLD, config.cold_schedule), (WARM, config.warm_schedule)):
        yield Case(workload=batch, ascent=ascent, designs=designs, iterations=len(schedule), schedule=schedule)


# -------------------------------------------------------------------- the core


def measure(case, design):
    """The :class:`CoreRow` of a design, from the simulated Verilog where there is a C++ compiler."""
    events, roi_events, iterations = len(case.workload.events), case.workload.roi_events, case.iterations
    if find_compiler() is None:
        return _computed(case, design)
    core = _simulated(design.config)
    settings = BatchSettings.from_config(design.config, case.workload.roi)
    first = _run(core, settings, case)  # leaves v for a warm batch; and the sweep after the reset is over
    shorter = _one_iteration_less(settings)
    if case.ascent == WARM:
        settings, shorter = (_replace(each, roi=None) for each in (settings, shorter))
    result, less = _run(core, settings, case), _run(core, shorter, case)
    done = (first["roi_events"], result["iterations"], less["iterations"])
    if done != (roi_events, iterations, iterations - 1):
        raise AssertionError(f"the core did {done[1]} and {done[2]} iterations on {done[0]} events")
    cycles = result["measured_cycles"]
    return CoreRow(
        name=design.name,
        measured=True,
        iterations=iterations,
        cycles=cycles,
        formula=core.core.cycles(events=events, roi_events=roi_events, iterations=case.plan(iterations)),
        per_iteration=cycles - less["measured_cycles"],
        after_last=cycles - events,
        back_to_back=_back_to_back(core, settings, case),
        v=tuple(design.config.formats.v.real(result[f"v_{axis}"]) for axis in "xy"),
    )


def _run(core, settings, case):
    events = case.workload.events
    core.write_schedule(schedule_table(core.config, settings))
    return core.run(events.t, events.x, events.y, settings_values(core.config, settings))[0]


def _back_to_back(core, settings, case):
    """Cycles between the results of the last two of four batches: the first ones find the core idle."""
    events = case.workload.events
    batches = [(events.t, events.x, events.y)] * 4
    core.write_schedule(schedule_table(core.config, settings))
    results, _ = core.stream(batches, [settings_values(core.config, settings)] * len(batches))
    if any(result["iterations"] != case.iterations for result in results):
        raise AssertionError("the core did another number of iterations in a stream of batches")
    return results[-1]["valid"] - results[-2]["valid"]


def _replace(settings, **changes):
    return BatchSettings(**{**vars(settings), **changes})


def _one_iteration_less(settings):
    changes = {"iterations": settings.iterations - 1, "cold": settings.cold[:-1], "warm": settings.warm[:-1]}
    return _replace(settings, **changes)


@cache
def _simulated(config):
    from ..engines.verilated import VerilatedCore

    return VerilatedCore(config)


def _computed(case, design):
    from amaranth.hdl import UnusedElaboratable

    from ..rtl.core import Core

    warnings.filterwarnings("ignore", category=UnusedElaboratable)  # it is only asked for numbers
    core = Core(design.config)
    batch = {"events": len(case.workload.events), "roi_events": case.workload.roi_events}
    cycles = core.cycles(**batch, iterations=case.plan(case.iterations))
    return CoreRow(
        name=design.name,
        measured=False,
        iterations=case.iterations,
        cycles=cycles,
        formula=cycles,
        per_iteration=cycles - core.cycles(**batch, iterations=case.plan(case.iterations - 1)),
        after_last=cycles - batch["events"],
        back_to_back=None,
        v=None,
    )


# -------------------------------------------------------------------- the programs


def make_job(case, v_start=(0.0, 0.0)):
    """The :class:`~cmfpga.bench.opponents.Job` of a case."""
    batch = case.workload
    return Job(
        events=batch.events,
        roi=batch.roi,
        width=batch.width,
        height=batch.height,
        iterations=case.iterations,
        schedule=case.schedule,
        dither=case.schedule is not None,
        v_start=v_start,
    )


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
    """The processor's name, as far as the system tells."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith(("model name", "Model")):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine() or "unknown processor"


# -------------------------------------------------------------------- the command


def _parser():
    made = cli.parser(
        "bench",
        "The core's clock cycles, counted in the simulated Verilog, beside the article's formula and the time that "
        "programs on this machine need for the same work.",
        EXAMPLES,
    )
    made.add_argument("--quick", action="store_true", help="the article's batch only, fewer and shorter runs")
    made.add_argument(
        "--runs", type=cli.positive, metavar="R", help="timed runs of each program (default: 15; quick: 5)"
    )
    made.add_argument(
        "--clock", type=_megahertz, default=ARTICLE_MHZ, metavar="MHZ",
        help=f"clock assumed for the core, MHz (default: {ARTICLE_MHZ:g}, the article's)",
    )  # fmt: skip
    made.add_argument("--json", metavar="FILE", help="write all numbers to FILE too")
    made.add_argument(
        "--data",
        default=os.environ.get("CMFPGA_DATA"),
        metavar="DIR",
        help="folder of real recordings, for the accuracy (default: $CMFPGA_DATA); none: only synthetic batches",
    )
    return made


def _megahertz(text):
    import argparse

    try:
        clock = float(text)
    except ValueError:
        clock = 0.0
    if not 1 <= clock <= 10000:
        raise argparse.ArgumentTypeError(f"{text!r}: 1 to 10000 MHz is needed")
    return clock


def main(arguments=None):
    """Run the command; returns the exit status."""
    options = _parser().parse_args(arguments)
    if options.json is not None and not Path(options.json).absolute().parent.is_dir():
        raise ConfigError(f"--json {options.json}: its folder does not exist")
    runs = options.runs or (5 if options.quick else 15)
    seconds = 0.003 if options.quick else 0.02
    started = time.perf_counter()
    programs, missing = make_programs()
    if find_compiler() is None:
        missing.append("no C++ compiler was found: the core's cycles are computed by its formula, not measured")
    cases = make_cases(options.quick)
    outcomes = []
    steps = sum(len(case.designs) for case in cases) + 2 * runs * len(cases) * len(programs)
    with tqdm(total=steps, unit="step", disable=None, leave=False) as bar:
        for case in cases:
            bar.set_description(f"{case.workload.name}, {ASCENTS[case.ascent]}")
            outcomes.append(_outcome(case, programs, outcomes, runs, seconds, bar.update))
    scores = _accuracy(options, missing)
    report = {
        "version": __version__,
        "clock_mhz_assumed": options.clock,
        "processor": processor(),
        "runs": runs,
        "quick": options.quick,
        "seconds": time.perf_counter() - started,
        "missing": missing,
        "programs": {program.name: program.how for program in programs},
        "cases": [_plain(outcome) for outcome in outcomes],
        "accuracy": scores,
    }
    lines, report["limits"], report["speed_ups"] = table(report)
    print("\n".join(lines))
    if options.json is not None:
        Path(options.json).write_text(json.dumps(report, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
        print(f"wrote {options.json}")
    return 0


def _accuracy(options, missing):
    """How often preset ``fast`` finds the motion: scores and lines of text; None where that cannot be measured here."""
    try:
        from .. import accuracy

        engine = "model" if find_compiler() is None else "rtl"
        if options.quick:
            return accuracy.brief(engine, batches=30)
        return accuracy.brief(engine, data=options.data)
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        missing.append("accuracy: torch is not installed; pip install 'cmfpga[reference]'")
        return None


def _outcome(case, programs, before, runs, seconds, step):
    batch = case.workload
    outcome = Outcome(
        case=case,
        article=article_cycles(
            events=len(batch.events),
            roi_events=batch.roi_events,
            pixels=batch.width * batch.height,
            iterations=case.iterations,
        ),
    )
    for design in case.designs:
        outcome.cores.append(measure(case, design))
        step()
    # A warm batch starts where the cold one before it ended, as it does in the core.
    v_start = (0.0, 0.0)
    if case.ascent == WARM:
        ended = [row.v for row in (*before[-1].cores, *before[-1].programs) if row.v is not None]
        v_start = ended[0] if ended else batch.v
    timed = time_programs(case, programs, runs=runs, seconds=seconds, v_start=v_start, step=step)
    outcome.programs.extend(timed)
    return outcome


def _plain(outcome):
    """An :class:`Outcome` for JSON."""
    case, batch = outcome.case, outcome.case.workload
    return {
        "workload": batch.name,
        "ascent": case.ascent,
        "events": len(batch.events),
        "roi_events": batch.roi_events,
        "width": batch.width,
        "height": batch.height,
        "iterations": case.iterations,
        "true_v": list(batch.v),
        "article_cycles": outcome.article,
        "cores": [asdict(row) for row in outcome.cores],
        "programs": [asdict(row) for row in outcome.programs],
    }
