"""The core's clock cycles beside the time that programs need for the same work: ``python -m studies.bench``.

:mod:`~.cases` makes what is measured; :mod:`~.cycles` measures the core, :mod:`~.programs` the :mod:`~.opponents`;
:mod:`~.table` makes the text of the numbers.
"""

import json
import os
import time
from pathlib import Path

from tqdm import tqdm

from cmfpga import __version__, cli
from cmfpga.errors import ConfigError, needs, write_text
from cmfpga.verilog import description
from cmfpga.verilog.compiler import cannot_compile

from .cases import WARM, make_cases
from .cycles import measure
from .opponents import make_programs
from .programs import or_missing, processor, time_foreign, time_programs
from .table import ASCENTS, table

EXAMPLES = (
    "python -m studies.bench",
    "python -m studies.bench --quick --json bench.json",
    "python -m studies.bench --clock 150        # MHz that you assume the core to reach",
    "python -m studies.bench --flow             # dense flow: fields a second by the number of units",
    "python -m studies.bench --hops --data DIR  # windows that slide: cycles after a hop's last event, of recordings",
)


def _parser():
    made = cli.parser(
        "python -m studies.bench",
        "The core's clock cycles, counted in the simulated Verilog, beside the article's formula and the time that "
        "programs on this machine need for the same work.",
        EXAMPLES,
    )
    made.add_argument("--quick", action="store_true", help="the article's batch only, fewer and shorter runs")
    made.add_argument(
        "--runs", type=cli.positive, metavar="R", help="timed runs of each program (default: 15; quick: 5)"
    )
    cli.add_clock_option(made)
    made.add_argument("--flow", action="store_true", help="dense flow instead, of 1, 2, 4, 5 and 8 units (quick: 5)")
    made.add_argument(
        "--sensor", type=cli.pair("W,H"), metavar="W,H",
        help="--flow: of a synthetic window of this sensor, with the tiles and events that flow takes; 3 and 4 units",
    )  # fmt: skip
    made.add_argument("--hops", action="store_true", help="windows that slide instead: from a hop's last event on")
    made.add_argument("--json", metavar="FILE", help="write all numbers to FILE too")
    made.add_argument(
        "--data", default=os.environ.get("CMFPGA_DATA"), metavar="DIR",
        help="folder of real recordings, for accuracy and --flow (default: $CMFPGA_DATA); none: only synthetic ones",
    )  # fmt: skip
    return made


def main(arguments=None):
    """Run the command; returns the exit status."""
    options = _parser().parse_args(arguments)
    if options.json is not None and not Path(options.json).absolute().parent.is_dir():
        raise ConfigError(f"--json {options.json}: its folder does not exist")
    runs, seconds = (options.runs or 5, 0.003) if options.quick else (options.runs or 15, 0.02)
    if options.flow:
        from .flow import run
    elif options.hops:
        from .hops import run
    else:
        run = _batches
    missing = []
    lines, report = run(options, missing, runs=runs, seconds=seconds)
    print("\n".join(lines))
    if options.json is not None:
        report = {"version": __version__, "missing": missing, **report}
        write_text(options.json, json.dumps(report, indent=2, ensure_ascii=False) + "\n")
        print(f"wrote {options.json}")
    return 0


def _batches(options, missing, *, runs, seconds):
    """``(lines of text, what ``--json`` writes)``; ``missing`` gets a line on each thing that is not measured."""
    started = time.perf_counter()
    programs, lines = make_programs()
    missing += lines
    if why := cannot_compile():
        missing.append(f"{why}: the core's cycles are computed by its formula, not measured")
    cases = make_cases(options.quick)
    measured = []
    signs = sum(case.schedule is not None for case in cases)
    steps = sum(len(case.designs) for case in cases) + 2 * runs * (len(cases) + signs) * len(programs)
    with tqdm(total=steps, unit="step", disable=None, leave=False) as bar:
        for case in cases:
            bar.set_description(f"{case.workload.name}, {ASCENTS[case.ascent]}")
            before = measured[-1] if measured else None
            measured.append(_measured(case, programs, before, runs=runs, seconds=seconds, step=bar.update))
    scores, foreign = None, []
    with or_missing(missing), needs("torch", "reference", "accuracy"):
        from ..accuracy.suites import brief

        engine = "model" if cannot_compile() else "rtl"
        scores = brief(engine, **({"batches": 30} if options.quick else {"data": options.data}))
    with or_missing(missing):
        foreign = time_foreign(cases[0], runs=runs, seconds=seconds)
    report = {
        "clock_mhz_assumed": options.clock, "processor": processor(), "runs": runs, "quick": options.quick,
        "seconds": time.perf_counter() - started, "missing": missing,
        "programs": {program.name: program.how for program in programs}, "cases": measured, "foreign": foreign,
        "accuracy": scores,
    }  # fmt: skip
    lines, report["limits"], report["speed_ups"] = table(report)
    return lines, report


def _measured(case, programs, before, *, step, **options):
    """A case and its rows, JSON-ready; ``before`` is what this gave for the case before."""
    batch, cores, v_start, pixels = case.workload, [], (0.0, 0.0), case.workload.width * case.workload.height
    size = {"events": len(batch.events), "roi_events": batch.roi_events}
    for name in case.designs:
        cores.append(measure(case, name))
        step()
    if case.ascent == WARM:  # it starts where the cold one before it ended, as it does in the core
        ended = (row["v"] for row in (*before["cores"], *before["programs"]) if row["v"] is not None)
        v_start = next(ended, batch.v)
    return {
        "workload": batch.name, "ascent": case.ascent, **size, "width": batch.width, "height": batch.height,
        "iterations": case.iterations, "steps": len(case.steps) if case.steps else case.iterations,
        "true_v": list(batch.v),
        "article_cycles": description.article_cycles(**size, pixels=pixels, iterations=case.iterations),
        "cores": cores, "programs": time_programs(case, programs, v_start=v_start, step=step, **options),
    }  # fmt: skip
