"""The suites: synthetic batches, real batches, and the tracked checkerboard."""

import math

import numpy as np

from cmfpga.config import preset
from cmfpga.engines import ENGINES

from .default_use import run_known
from .foreign import FOREIGN, find
from .real import TRACK_BOUNDS, real_cases, track_checkerboard, track_config, track_scores
from .synthetic import BATCHES, synthetic_cases
from .table import ERRORS, SHARES, binned, contrast_shares, errors, heads_of, measure, percent, scored
from .yardstick import ROI

STARTS = (("cold", False), ("warm", True))


def run_suites(options, config, report):
    """Print the tables of all suites; of the synthetic batches only, without a folder of recordings."""
    names = ENGINES if options.engine == "all" else (options.engine,)
    if config.slides:  # the others are batches
        return run_known(names, options, config, report)
    cases = synthetic_cases(options.batches, seeds=options.seeds)
    rows, found = [], {}
    for what in names:
        for start, warm in STARTS:
            values = found[what, start] = measure(what, config, errors, cases, warm=warm, progress=report.progress)
            rows.append((what, start, *report.cells(f"synthetic, {start}, {what}", ERRORS, values)))
    report.table("Synthetic batches: error of v, px per half batch", ("engine", "start", *heads_of(ERRORS)), rows)
    rows = binned(cases, found[names[0], "cold"])
    report.table(f"The same by kind of batch (cold start, {names[0]})", ("batches with", *heads_of(ERRORS)), rows)
    if options.eventcv:
        values = [math.dist(find(case.events, case.roi, ROI, ROI)[0], case.truth) for case in report.progress(cases)]
        row = (FOREIGN, "cold", *report.cells(f"synthetic, cold, {FOREIGN}", ERRORS, np.array(values)))
        report.table(f"The same batches by {FOREIGN}, from v = 0", ("program", "start", *heads_of(ERRORS)), [row])
    if options.data is not None:
        real, rows = real_cases(options.data), []
        for what in names:
            values = found[what, "real"] = measure(what, config, contrast_shares, real, progress=report.progress)
            rows.append((what, *report.cells(f"real, {what}", SHARES, values)))
        report.table("Real batches: contrast at the v found, cold start", ("engine", *heads_of(SHARES)), rows)
        _run_checkerboard(names, config, options, report, found)
    compare_with_model(found)
    if options.known:
        run_known(names, options, config, report)


def _run_checkerboard(names, config, options, report, found):
    rows = []
    for track, limits in TRACK_BOUNDS.items():
        bounds = ", ".join(f"{low:.0f} … {high:.0f}" for low, high in limits).replace("-", "−")
        for what in names:
            speeds = measure(what, track_config(config, track), track_checkerboard, options.data)
            found[what, track] = speeds
            scores = report.keep(f"{track}, {what}", speeds, track_scores(speeds, track))
            spans = ("{:.1f} to {:.1f}".format(*scores[axis]) for axis in ("vx_px_per_s", "vy_px_per_s"))
            rows.append((track, what, scores["batches"], bounds, scores["within_bounds"], *spans))
    heads = ("", "engine", "batches", "bounds of vx, vy, px/s", "within", "vx, px/s", "vy, px/s")
    report.table("Checkerboard, tracked", heads, rows)


def compare_with_model(found):
    """Say whether Verilog and model, which must not differ, did the same."""
    for (name, suite), values in found.items():
        model = found.get(("model", suite))
        if name == "rtl" and model is not None:
            same = np.all(np.asarray(values) == model, axis=tuple(range(1, np.ndim(values))))
            print(f"{suite}: rtl and model agree exactly in {same.sum()} of {len(same)} batches")


def brief(engine, *, data=None, batches=BATCHES):
    """The suites' scores for preset ``fast``, and a line of text on each: ``{"scores": …, "text": […]}``, JSON-ready.

    Of the synthetic suite the first so many ``batches``; ``data``, the folder of real recordings: None leaves them out.
    """
    config, cases, scores, text = preset("fast"), synthetic_cases(batches), {}, []
    for start, warm in STARTS:
        found = scores[f"synthetic, {start}"] = scored(ERRORS, measure(engine, config, errors, cases, warm=warm))
        most, many = (percent(found[f"below_{limit}_px"]) for limit in ("0.6", "0.3"))
        told = f"{found['batches']} synthetic batches, {start}: {most} % within 0.6 px, {many} % within 0.3 px"
        text.append(f"preset fast, {engine}, {told}")
    if data is not None:
        found = scores["real, cold"] = scored(SHARES, measure(engine, config, contrast_shares, real_cases(data)))
        most, many = (percent(found[f"at_least_{least}_percent"]) for least in (97, 99))
        told = f"{found['batches']} real batches, cold: {most} % reach 97 % of the best contrast, {many} % reach 99 %"
        text.append(f"preset fast, {engine}, {told}; {found['batches_that_drop_events']} drop events")
    return {"scores": scores, "text": text}
