"""The tables of a sweep, and the ranking of its configurations."""

import functools
import io
import math
import statistics

import pandas

from ..config import Config
from ..forms import Many, Number, Text
from ..fpga import resources
from ..imaging.camera import RATES
from ..protocol.flags import Flag
from ..tracking.columns import COLUMNS, MORE, Column, columns, declared
from ..tracking.verdict import Verdict
from ..truth import WRONG_PX
from .task import MORE_COLUMNS, version, write_atomically

#: Columns of ``results``, in order, before those of the resources and the configuration.
RESULTS = declared(
    Column(name="recording", dtype=str, doc="as it was given, without its ROI"),
    Column(name="configuration", dtype=int, doc="number of the configuration, from 0, the field that was named last "
           "changing fastest"),
    Column(name="status", dtype=str, doc="`ok`; `empty`: no batch measured anything; `failed`: there is no result"),
    Column(name="reason", dtype=str, doc="why it is not `ok`"),
    Column(name="roi_x", dtype=int, doc="left column of the first batch's ROI, px"),
    Column(name="roi_y", dtype=int, doc="top row of the first batch's ROI, px"),
    Column(name="batches", dtype=int, doc="batches tracked"),
    Column(name="degenerate_batches", dtype=int, doc="batches that measured nothing"),
    Column(name="batches_with_warnings", dtype=int, doc="batches with a flag that is a warning"),
    Column(name="flags", dtype=str, doc="all flags that were set, joined by `|`"),
    Column(name="events", dtype=int, doc="events of all batches"),
    Column(name="events_left_over", dtype=int, doc="events after the last batch"),
    Column(name="roi_events_mean", doc="events in the ROI that the buffer held, mean over the batches"),
    Column(name="vx_px_per_s_median", doc="median velocity, px/s"),
    Column(name="vy_px_per_s_median", doc="the same along y"),
    Column(name="contrast_mean", doc="contrast at the v found, mean over the batches, (events/px)²"),
    Column(name="gain_median", doc="how many times the contrast at v = 0 that at the v found is, both dithered, "
           "median over the batches; 1 for a degenerate batch"),
    Column(name="trusted_batches", dtype=int, doc="batches that are to be trusted; empty where the confidence was not "
           "measured"),
    Column(name="verdict", dtype=str, doc="the same, and the velocity, in words, as `track` says it"),
    Column(name="error_px_median", doc="distance of v from the truth, median over the batches, px per half batch; a "
           "degenerate batch errs by infinity; empty where the truth is not known"),
    Column(name="error_px_max", doc="the largest of them"),
    Column(name="error_below_0.6_px", doc="share of the batches whose error is less than 0.6 px per half batch"),
    Column(name="cycles_mean", doc="clock cycles of a batch, mean over those that are not degenerate; empty for "
           "engines without a clock"),
    Column(name="cycles_max", dtype=int, doc="clock cycles of the longest batch"),
    Column(name="truth", dtype=str, doc="where the true motion was found: `sidecar` or `recording`; empty: nowhere"),
    Column(name="engine", dtype=str, doc="`rtl`, `model` or `float`"),
    Column(name="batch_events", dtype=int, doc="`--batch-events`"),
    Column(name="batch_us", dtype=int, doc="`--batch-us`"),
    Column(name="batch_roi_events", dtype=int, doc="`--batch-roi-events`"),
    Column(name="start_event", dtype=int, doc="`--start-event`"),
    Column(name="recording_sha256", dtype=str, doc="of the file"),
    Column(name="configuration_hash", dtype=str, doc="of the hardware: equal hash, equal Verilog"),
    Column(name="cmfpga", dtype=str, doc="version, and a digest of the sources"),
    Column(name="preset", dtype=str, doc="the configuration that was begun with"),
)  # fmt: skip

_TYPES = {int: "Int64", float: "Float64", str: "string"}
_FIELD_TYPES = {name: _TYPES[field.type] for name, field in Config.__dataclass_fields__.items()}

#: Of a column behind those of ``track.csv``, and resources: forms of what is kept.
_MORE, _ESTIMATE = Number(missing=True), Number(low=0)


def results(rows, outcomes, run, estimates):
    """One line for each of ``rows``, as a DataFrame.

    ``outcomes`` are each row's, as :func:`~cmfpga.sweep.task.run_task` returns it; ``estimates`` those of
    :func:`~cmfpga.sweep.task.estimate_resources` by hardware hash, empty if they were not asked for.
    """
    lines = []
    for row, outcome in zip(rows, outcomes, strict=True):
        config = row.task.config if row.task else None
        line = {
            "recording": row.subject.name,
            "configuration": row.choice.number,
            **dict(zip(("roi_x", "roi_y"), row.roi or (), strict=False)),
            **summary(row, outcome),
            "truth": row.subject.truth and row.subject.truth.source,
            "engine": run.engine,
            "batch_events": run.size.get("events"),
            "batch_us": run.size.get("duration_us"),
            "batch_roi_events": run.size.get("roi_events"),
            "start_event": run.start_event,
            "recording_sha256": row.subject.digest or None,
            "configuration_hash": config and config.hardware_hash,
            "cmfpga": version(),
            "preset": row.choice.preset,
        }
        estimated = (estimates.get(config.hardware_hash) or {}).get("total", {}) if config else {}
        line |= {f"resources.{kind}": estimated.get(kind) for kind in resources.KINDS} if estimates else {}
        line |= {f"config.{name}": value for name, value in row.choice.fields(row.subject).items()}
        lines.append(line)
    types = {name: _TYPES[column.dtype] for name, column in RESULTS.items()}
    types |= {f"{name}_median": "Float64" for name in _rates(rows)}
    types |= {f"resources.{kind}": "Float64" for kind in resources.KINDS} if estimates else {}
    types |= {f"config.{name}": kind for name, kind in _FIELD_TYPES.items()}
    return _frame(lines, types)


def summary(row, outcome):
    """What one track amounts to: the columns of :data:`RESULTS` that an outcome determines."""
    if outcome["status"] != "ok":
        return {"status": "failed", "reason": outcome["reason"]}
    batches = outcome["batches"]
    flags = [batch["flags"].split("|") if batch["flags"] else [] for batch in batches]
    verdict = Verdict.of(batches, row.task.config)
    degenerate = sum("degenerate" in names for names in flags)
    status, reason, speeds = "ok", None, ("vx_px_per_s", "vy_px_per_s", *MORE)
    if degenerate == len(batches):
        status, reason = "empty", f"no event ever entered the ROI at {row.roi[0]},{row.roi[1]}"
        if most := max(batch["roi_events"] for batch in batches):
            reason = f"no batch measured anything: at most {most} events in the ROI"
    found = {
        "status": status,
        "reason": reason,
        "batches": len(batches),
        "degenerate_batches": degenerate,
        "batches_with_warnings": sum(bool(Flag.parse(batch["flags"]).warnings) for batch in batches),
        "flags": "|".join(dict.fromkeys(name for names in flags for name in names)),
        "events": sum(batch["events"] for batch in batches),
        "events_left_over": outcome["events_left_over"],
        "roi_events_mean": _mean(batch["roi_events"] for batch in batches),
        **{f"{name}_median": _middle(batch[name] for batch in batches) for name in speeds if name in batches[0]},
        "contrast_mean": _mean(batch["contrast"] for batch in batches),
        "gain_median": _middle(1.0 if batch["gain"] is None else batch["gain"] for batch in batches),
        "trusted_batches": int(verdict.trusted.sum()) if verdict.judged.any() else None,
        "verdict": "; ".join(filter(None, (verdict.share, verdict.velocity))) or None,
        "cycles_mean": _mean(cycles_of(outcome)),
        "cycles_max": max(cycles_of(outcome), default=None),
    }
    if row.subject.truth:
        errors = errors_of(outcome)
        found["error_px_median"] = statistics.median(errors)
        found["error_px_max"] = max(errors)
        found["error_below_0.6_px"] = _mean(error < WRONG_PX for error in errors)
    return found


def errors_of(outcome):
    """Distance from the truth of each batch, px per half batch; infinite for a degenerate one."""
    return [math.inf if batch["error_px"] is None else batch["error_px"] for batch in outcome["batches"]]


def cycles_of(outcome):
    """Clock cycles of each batch, where there is a clock; not of degenerate ones, which take few and find nothing."""
    found = [batch["cycles"] for batch in outcome["batches"] if "degenerate" not in batch["flags"].split("|")]
    return [cycles for cycles in found if cycles is not None]


def outcome_form(motion):
    """The form of an outcome that was kept: batches with their columns, each of its kind."""
    batch = {name: column.form for name, column in columns(motion).items()} | dict.fromkeys(MORE_COLUMNS, _MORE)
    return {"status": Text(), "batches": Many(batch, 1), "events_left_over": Number(int, low=0), "note": Text()}


#: The same of resources.
ESTIMATE_FORM = {
    "status": Text(), "total": dict.fromkeys(resources.KINDS, _ESTIMATE), "yosys": Text(), "estimate": Text(),
}  # fmt: skip


def _mean(values, kind=statistics.fmean):
    """The mean of those that are there; None without any."""
    values = [value for value in values if value is not None]
    return kind(values) if values else None


_middle = functools.partial(_mean, kind=statistics.median)


def batches(rows, outcomes):
    """One line for each batch of each row, as a DataFrame: what varies, the columns of track.csv, and the truth."""
    varied = list(rows[0].choice.varied) if rows else []
    lines = [
        {
            "recording": row.subject.name,
            "first_roi": f"{row.roi[0]},{row.roi[1]}",
            "configuration": row.choice.number,
            **{f"config.{name}": row.choice.varied[name] for name in varied},
            **batch,
        }
        for row, outcome in zip(rows, outcomes, strict=True)
        if outcome["status"] == "ok"
        for batch in outcome["batches"]
    ]
    types = {"recording": "string", "first_roi": "string", "configuration": "Int64"}
    types |= {f"config.{name}": _FIELD_TYPES.get(name, "string") for name in varied}
    types |= {name: _TYPES[column.dtype] for name, column in COLUMNS.items()} | dict.fromkeys(MORE_COLUMNS, "Float64")
    types |= dict.fromkeys(_rates(rows), "Float64")
    return _frame(lines, types)


def _rates(rows):
    """What the rows' motions tell beside v, in the order of their first row: columns of track.csv."""
    return list(dict.fromkeys(name for row in rows if row.task for name in RATES[row.task.config.motion]))


def _frame(lines, types):
    return pandas.DataFrame(
        {name: pandas.array([line.get(name) for line in lines], dtype=kind) for name, kind in types.items()}
    )


def write(frame, path):
    """Write a DataFrame as CSV or Parquet, by the suffix of ``path``."""
    if path.suffix == ".csv":
        content = frame.to_csv(index=False, lineterminator="\n").encode()
    else:
        buffer = io.BytesIO()
        frame.to_parquet(buffer, index=False, engine="pyarrow")
        content = buffer.getvalue()
    write_atomically(path, content)


#: What configurations are ranked by, in the order in which it decides: title, and whether less is better.
CRITERIA = {
    "error_px": ("error, median [px/half batch]", True),
    "trusted": ("trusted batches, share", False),
    "gain": ("contrast gained by v, share of the best", False),
    "cycles": ("cycles per batch, mean", True),
    "lut": ("LUT (estimate)", True),
}


def ranking(rows, outcomes, estimates):
    """The configurations, best first, as dictionaries.

    A configuration is ranked if all its rows are ``ok`` and so comparable with the others; the rest come last. A
    recording that no configuration has a result for does not count.

    - ``error_px``: median over all batches of all recordings whose truth is known, ``below`` the share below 0.6 px;
    - ``trusted``: share of the trusted among all batches, where the confidence was measured;
    - ``gain``: each recording's ``gain_median`` as a share of the best configuration's, mean over the recordings. Not
      the contrast itself: without dither it has a false peak at v = 0;
    - ``cycles``: mean over all batches that are not degenerate;
    - ``resources``: estimates, where they were asked for; LUTs are ranked.

    ``ranks`` has a number from 1 for each of :data:`CRITERIA` that there is a value for. ``best`` is set where no other
    ranked configuration is as good in all of them and better in one.
    """
    groups, gains = {}, {}  # the best gain of each object that some configuration has a result for
    for row, outcome in zip(rows, outcomes, strict=True):
        found, key = summary(row, outcome), (row.subject.name, row.subject.roi)
        groups.setdefault(row.choice.number, []).append((row, outcome, found))
        if found["status"] == "ok":
            gains[key] = max(gains.get(key, 0.0), found["gain_median"])
    listed = [_aggregate(group, gains, estimates) for group in groups.values()]
    ranked = [entry for entry in listed if entry["complete"]]
    for name, (_, less) in CRITERIA.items():
        values = sorted((entry[name] for entry in ranked if entry[name] is not None), reverse=not less)
        for entry in ranked:
            if entry[name] is not None:
                entry["ranks"][name] = 1 + values.index(entry[name])
    for entry in ranked:
        entry["best"] = not any(_dominates(other, entry) for other in ranked)

    def place(entry):
        ranks = [entry["ranks"].get(name, math.inf) for name in CRITERIA]
        return not entry["complete"], ranks, entry["configuration"]

    return sorted(listed, key=place)


def _aggregate(group, gains, estimates):
    ok = [one for one in group if one[2]["status"] == "ok"]
    errors = [error for row, outcome, _ in ok if row.subject.truth for error in errors_of(outcome)]
    cycles = [count for _, outcome, _ in ok for count in cycles_of(outcome)]
    best = [(found["gain_median"], gains[row.subject.name, row.subject.roi]) for row, _, found in ok]
    trusted, measured = ([found[name] for *_, found in ok] for name in ("trusted_batches", "batches"))
    hashes = {row.task.config.hardware_hash for row, _, _ in group if row.task}
    totals = [estimates[key]["total"] for key in sorted(hashes) if estimates.get(key, {}).get("status") == "ok"]
    # With sensors of several sizes there are several hardwares: the largest counts.
    used = {kind: max(total[kind] for total in totals) for kind in resources.KINDS} if totals else None
    choice = group[0][0].choice
    return {
        "configuration": choice.number,
        "varied": choice.varied,
        "label": choice.label,
        "rows": len(group),
        "rows_ok": len(ok),
        "complete": bool(ok) and len(ok) == len(gains),
        "error_px": statistics.median(errors) if errors else None,
        "below": _mean(error < WRONG_PX for error in errors),
        "trusted": sum(trusted) / sum(measured) if ok and None not in trusted else None,
        "gain": _mean(gain / most for gain, most in best if most > 0),
        "cycles": _mean(cycles),
        "resources": used,
        "lut": used["lut"] if used else None,
        "ranks": {},
        "best": False,
    }


def _dominates(one, other):
    """Whether ``one`` is as good as ``other`` in all criteria and better in one."""
    ranks = [(rank, other["ranks"][name]) for name, rank in one["ranks"].items() if name in other["ranks"]]
    return all(a <= b for a, b in ranks) and any(a < b for a, b in ranks)


def number(value):
    """A number for people: few digits, a dash where there is none."""
    if value is None or pandas.isna(value):
        return "–"
    if math.isinf(value):
        return "∞"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def text(ranked):
    """The ranking for a terminal."""
    shown = [name for name in CRITERIA if any(entry[name] is not None for entry in ranked)]
    lines = [("", *(CRITERIA[name][0] for name in shown), "rows")]
    for entry in ranked:
        mark = "* " if entry["best"] else "  "
        rows = f"{entry['rows_ok']} of {entry['rows']}"
        lines.append((mark + entry["label"], *(number(entry[name]) for name in shown), rows))
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join([first.ljust(widths[0]), *map(str.rjust, others, widths[1:])]).rstrip() for first, *others in lines
    )
