"""Studies: plain ascent, the objective's peak, edges, schedules, widths, confidence, bias, ambiguity, large sensors."""

import numpy as np

from cmfpga.config import preset
from cmfpga.config.schedule import MEASURED
from cmfpga.errors import ConfigError

from .ambiguous import study_ambiguous
from .bias import study_bias
from .default_use import STUDIES as OF_RECORDINGS
from .judged import study_confidence
from .large import study_large
from .real import real_cases
from .synthetic import EVENTS_PER_EDGE, WARM_RADIUS, synthetic_cases
from .table import ERRORS, SHARES, cells_of, contrast_shares, errors, heads_of, measure, scored
from .yardstick import peak_error

#: Cold schedules to compare.
SCHEDULES = (
    MEASURED["translation"]["cold"],  # the default
    "2:3:4 2:2:3 1:3/2:2 1:1:1 0:3/4:3/4",  # level 1 earlier, and far at full resolution
    "2:3:4 2:2:3 2:3/2:2 1:1:1 1:3/4:1/2 0:3/4:1/4",  # a round more
    "2:3:4*2 2:2:3 2:3/2:2 1:3/2:2 1:1:1 0:3/4:1/4",  # two more
    "2:3:4 2:2:3 1:1:1 0:3/4:1/4",  # one less
    "1:3:4 1:2:3 1:3/2:2 1:1:1 0:3/4:1/4",  # no level 2
    "0:3:4 0:2:3 0:3/2:2 0:1:1 0:3/4:1/4",  # full resolution only
)

#: Warm schedules to compare.
WARM_SCHEDULES = (
    MEASURED["translation"]["warm"],  # the default
    "1:1:3/2 1:3/4:1 0:3/4:1/16",  # a last round that hardly moves
    "1:1:3/2*2",  # two
    "1:1:3/2 0:3/4:1",
    "1:3/4:1",  # one
)

#: Fraction bits of dt, v, position, weight, derivative, dither.
WIDTHS = (
    (12, 12, 8, 8, 8, 4),
    (8, 8, 6, 6, 6, 4),
    (8, 6, 4, 4, 4, 4),
    (6, 5, 4, 4, 4, 3),
    (6, 5, 3, 3, 3, 3),
    (5, 5, 3, 2, 2, 2),
    (4, 5, 2, 2, 2, 2),
    (4, 5, 2, 1, 1, 1),
)
WIDTH_FIELDS = ("dt_frac", "v_frac", "position_frac", "weight_frac", "derivative_frac", "dither_frac")
PLAIN_ETAS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # η of the article's ascent to choose the best of


def _compare(report, title, heads, rows, engine, cases, real, *, warm=False):
    """Print a row for each of ``rows``, ``(name, first cells, configuration)``: both suites', or the warm one's."""
    told = []
    for name, cells, config in rows:
        values = measure(engine, config, errors, cases, warm=warm, progress=report.progress)
        found = report.cells(name if warm else f"synthetic, {name}", ERRORS, values)[1:4]
        if real:
            values = measure(engine, config, contrast_shares, real, progress=report.progress)
            found += report.cells(f"real, {name}", SHARES, values)[1:3]
        told.append((*cells, *found))
    more = heads_of(SHARES)[1:3] if real else ()
    report.table(title, (*heads, *heads_of(ERRORS)[1:4], *more), told)


def _study_plain(config, engine, cases, real, report, **_):
    plain = preset("paper").replace(buffer_events=config.buffer_events)
    rows = [(f"eta {eta:g}", (f"{eta:g}",), plain.replace(eta=eta)) for eta in PLAIN_ETAS]
    title = f"The article's ascent in float64: constant η, T = {plain.iterations}, from v = 0"
    _compare(report, title, ("η, (px/half batch)² per (events/px)²",), rows, "float", cases, real)


def _study_peaks(config, engine, cases, real, report, **_):
    values = np.array([peak_error(case) for case in report.progress(cases)])
    rows = [("synthetic", *report.cells("peaks", ERRORS, values))]
    title = "Distance of the dithered objective's peak (float64) from the truth"
    report.table(title, ("suite", *heads_of(ERRORS)), rows)


def _study_edges(config, engine, cases, real, report, *, data, **suite):
    rows = []
    for strength in (0.0, 1.0, 2.0, EVENTS_PER_EDGE, 8.0):
        cases = synthetic_cases(**suite, events_per_edge=strength)
        slow = np.array([case.facts["speed"] < 1 for case in cases])
        values = measure(engine, config, errors, cases, progress=report.progress)
        report.cells(f"events per edge {strength:g}", ERRORS, values)
        peaks = np.array([peak_error(case) for case in report.progress(cases)])
        name = f"{strength:g}" if strength else "1 threshold per px"
        for which, chosen in (("all", np.ones(len(cases), bool)), ("below 1", slow)):
            if chosen.any():
                found, best = (cells_of(ERRORS, scored(ERRORS, each[chosen])) for each in (values, peaks))
                rows.append((name, which, *found[:4], *best[1:3]))
    heads = (*heads_of(ERRORS)[:4], "peak < 0.3 px, %", "peak < 0.6 px, %")
    report.table("Edges of other strengths, cold start", ("events per edge", "speed, px per half batch", *heads), rows)


def _study_schedules(config, engine, cases, real, report, **_):
    if not config.ascent_rule.has_table:
        raise ConfigError(f"ascent = {config.ascent!r}: schedules belong to ascent = newton")
    config = config.replace(schedule_entries=max(config.schedule_entries, 64))
    for which, schedules, title, given in (
        ("cold", SCHEDULES, f"Cold schedules, entries LEVEL:H:LIMIT*COUNT ({engine} engine)", real),
        ("warm", WARM_SCHEDULES, f"Warm schedules, from up to {WARM_RADIUS:g} px off ({engine} engine)", []),
    ):
        rows = []
        for text in schedules:
            changed = config.replace(**{which: text})
            rows.append((f"{which} {text}", (f"`{text}`", len(getattr(changed.schedules, which))), changed))
        _compare(report, title, ("schedule", "T"), rows, engine, cases, given, warm=which == "warm")


def _study_widths(config, engine, cases, real, report, **_):
    rows = []
    for widths in WIDTHS:
        name = ", ".join(map(str, widths))
        rows.append((f"widths {name}", (name,), config.replace(**dict(zip(WIDTH_FIELDS, widths, strict=True)))))
    heads = ("fraction bits: dt, v, position, weight, derivative, dither",)
    _compare(report, f"Word widths ({engine} engine)", heads, rows, engine, cases, real)


STUDIES = {
    "plain": _study_plain,
    "peaks": _study_peaks,
    "edges": _study_edges,
    "schedules": _study_schedules,
    "widths": _study_widths,
    "confidence": study_confidence,
    "bias": study_bias,
    "ambiguous": study_ambiguous,
    "large": study_large,
    **OF_RECORDINGS,
}

#: Those that use the real batches, and those that there are with a folder of recordings only.
REAL, OF_FOLDER = ("plain", "schedules", "widths"), ("slider", "auto")


def run_study(options, config, report):
    """Print the tables of ``options.study``."""
    if options.study in OF_FOLDER and options.data is None:
        raise ConfigError(f"--study {options.study}: --data, a folder of recordings, is needed")
    suite = {"count": options.batches, "seeds": options.seeds}
    cases = synthetic_cases(**suite)
    real = real_cases(options.data) if options.data and options.study in REAL else []
    engine = "model" if options.engine == "all" else options.engine
    STUDIES[options.study](config, engine, cases, real, report, data=options.data, **suite)
