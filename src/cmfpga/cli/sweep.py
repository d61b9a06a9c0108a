"""``cmfpga sweep``: many recordings, many configurations."""

import importlib.util
import json
from math import inf

from tqdm import tqdm

from .. import cli
from ..engines import ENGINES
from ..errors import ConfigError
from ..sweep import plan
from ..sweep.task import Run, Store, estimate_resources, pool, processors, run_task, version, write_atomically

EXAMPLES = (
    "cmfpga sweep a.h5@100,30 b.h5@60,40 --vary preset=fast,paper --batches 20",
    "cmfpga sweep *.h5 --roi 88,28 --vary weight_frac=2,3,4 --vary dt_frac=6,8 --workers 4 --out widths",
    "cmfpga sweep rec.h5@100,30 --vary 'cold=0:1:1*8,1:1:1*4 0:3/4:1*4' --engine model",
    "cmfpga sweep rec.h5@100,30 --vary iterations=20,50 --preset paper --scheduler tcp://head:8786",
)


def parser():
    """Parser of the arguments of ``cmfpga sweep``."""
    made = cli.parser("cmfpga sweep", "Track many recordings with many configurations, and rank these.", EXAMPLES)
    made.add_argument(
        "recordings", nargs="+", metavar="RECORDING[@X,Y]",
        help="a recording, and its ROI's left column and top row, px; one with several ROIs is several objects",
    )  # fmt: skip
    text = "values of a field, or of preset; with several fields all combinations"
    made.add_argument("--vary", nargs="+", action="extend", default=[], metavar="FIELD=A,B,…", help=text)
    text = "ROI of the recordings that have none behind an @"
    made.add_argument("--roi", type=cli.pair("X,Y"), metavar="X,Y", help=text)
    cli.add_batch_options(made, "as long as suits the motion")
    text = "stop each after B batches (default: at the end)"
    made.add_argument("--batches", type=cli.positive, metavar="B", help=text)
    made.add_argument("--engine", default="rtl", choices=ENGINES, help="as of track (default: rtl)")
    cli.add_recording_options(made)
    where = made.add_mutually_exclusive_group()
    text = "processes of a local Dask cluster; 0: a thread of this one (default: one per processor)"
    where.add_argument("--workers", type=cli.natural, metavar="W", help=text)
    text = "use the workers of this Dask scheduler, as tcp://head:8786"
    where.add_argument("--scheduler", metavar="ADDRESS", help=text)
    text = "estimate each hardware's resources by Yosys (minutes each)"
    made.add_argument("--resources", action="store_true", help=text)
    made.add_argument("--out", default="cmfpga-sweep", metavar="DIR", help="folder for results, and to go on from")
    made.add_argument("--json", action="store_true", help="print the ranking as JSON")
    cli.add_config_options(made)
    return made


def main(arguments=None):
    """Run the command; returns the exit status."""
    options = parser().parse_args(arguments)
    for package in ("pandas", "pyarrow", "distributed"):
        if importlib.util.find_spec(package) is None:
            raise ConfigError(f"sweep: {package} is not installed; pip install 'cmfpga[sweep]'")
    if options.resources:
        from ..fpga import resources

        resources.require_yosys()
    names = ("engine", "start_event", "batches", "sensor", "time_unit")
    run = Run(size=cli.batch_size(options), **{name: getattr(options, name) for name in names})
    choices, skipped = plan.choices(options.preset, options.assignments, options.vary)
    if skipped:
        total = len(choices) + len(skipped)
        cli.note(f"{len(skipped)} of {total} combinations are skipped, as {skipped[0]}")
    subjects = plan.subjects(options.recordings, options.roi, run)
    rows = plan.rows(subjects, choices, run)
    if not any(row.task for row in rows):
        raise ConfigError(rows[0].problem)
    for subject in subjects:
        hot = choices[0].hot_note(subject)
        size = "" if "sensor_width" in choices[0].changes else subject.size_note
        cli.note(subject.note, hot and f"{subject.name}: {hot}", size)
    with cli.locked(options.out) as folder:
        return _sweep(options, run, rows, folder)


def _sweep(options, run, rows, folder):
    from ..sweep import tables

    tasks = {row.task.key: row.task for row in rows if row.task}
    hardware = {task.config.hardware_hash: task.config for task in tasks.values()} if options.resources else {}
    estimates = {f"{key}-{version()}": (config, version()) for key, config in hardware.items()}
    tracked, estimated = Store(folder / "tasks"), Store(folder / "resources")
    done = {
        key: outcome
        for key, task in tasks.items()
        if (outcome := tracked.get(key, tables.outcome_form(task.config.motion)))
    }
    known = {key: outcome for key in estimates if (outcome := estimated.get(key, tables.ESTIMATE_FORM))}
    left = {key: task for key, task in tasks.items() if key not in done}
    unknown = {key: job for key, job in estimates.items() if key not in known}
    kept = sum(row.task.key in done for row in rows if row.task)
    if left or unknown:
        count = min(processors() if options.workers is None else options.workers, max(len(left), len(unknown)))
        with pool(count, options.scheduler) as where:
            _run(where, run_task, left, tracked, done, folder, "row")
            _run(where, estimate_resources, unknown, estimated, known, folder, "hardware")
    outcomes = [done[row.task.key] if row.task else {"status": "failed", "reason": row.problem} for row in rows]
    cli.note(*dict.fromkeys(outcome.get("note") for outcome in outcomes))
    by_hash = {key: known[f"{key}-{version()}"] for key in hardware}
    for reason in dict.fromkeys(outcome["reason"] for outcome in by_hash.values() if outcome["status"] != "ok"):
        cli.note(f"no resources: {reason}")
    return _report(options, tables, run, rows, outcomes, by_hash, folder, kept)


def _run(where, function, jobs, store, outcomes, folder, unit):
    """Run ``jobs`` and keep each outcome as soon as it is there."""
    with tqdm(total=len(jobs), unit=unit, disable=None if jobs else True) as bar:
        for key, outcome in where.run(function, jobs):
            outcomes[key] = store.put(key, outcome)
            if "traceback" in outcome:
                (folder / "failures").mkdir(exist_ok=True)
                write_atomically(folder / "failures" / f"{key}.txt", outcome["traceback"].encode())
            bar.update()


def _report(options, tables, run, rows, outcomes, estimates, folder, kept):
    """Write the tables, print the ranking and the verdict of each row of the best configuration."""
    frame = tables.results(rows, outcomes, run, estimates)
    names = [f"{table}.{suffix}" for table in ("results", "batches") for suffix in ("csv", "parquet")]
    for table, name in zip((frame, frame, *[tables.batches(rows, outcomes)] * 2), names, strict=True):
        tables.write(table, folder / name)
    ranked = tables.ranking(rows, outcomes, estimates)
    paths = [str(folder / name) for name in names]
    bad = frame[frame["status"] != "ok"]
    failed = int((frame["status"] == "failed").sum())
    if options.json:
        summary = {
            "rows": len(frame),
            "kept": kept,
            "without_result": failed,
            "reasons": sorted(set(bad["reason"])),
            # JSON has no infinity.
            "ranking": [
                entry | {"error_px": None if entry["error_px"] == inf else entry["error_px"]} for entry in ranked
            ],
            "files": paths,
        }
        print(json.dumps(summary, indent=2, ensure_ascii=False))
    else:
        print(f"{len(frame)} rows, {kept} of them kept from before")
        for reason, count in bad["reason"].value_counts(sort=False).items():
            print(f"{count} of {len(frame)} rows without a result: {reason}")
        print(tables.text(ranked))
        best = frame[frame["configuration"] == ranked[0]["configuration"]]
        for recording, verdict in zip(best["recording"], best["verdict"].fillna("no result"), strict=True):
            print(f"{recording}: {verdict}")
        cli.wrote(paths)
    if failed == len(frame):
        raise ConfigError(f"no row has a result: {outcomes[0]['reason']}")
    return 0
