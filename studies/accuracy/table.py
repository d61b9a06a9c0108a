"""What an engine finds of each batch, scores of that, and tables of them, printed and kept for ``--json``."""

import dataclasses
import math
from contextlib import closing

import numpy as np
from tqdm import tqdm

from cmfpga.engines import make_engine
from cmfpga.protocol.settings import BatchSettings

from .synthetic import SIZES
from .yardstick import contrasts


def measure(name, config, what, *arguments, **options):
    """``what(engine, …)`` by the engine called ``name``."""
    with closing(make_engine(name, config)) as engine:
        return what(engine, *arguments, **options)


def run_case(engine, case, *, warm=False):
    """Result of ``engine`` for ``case``: from v = 0 by the cold schedule, or from ``case.start`` by the warm one."""
    config = engine.config
    settings = BatchSettings.from_config(config, case.roi)
    start = case.start if warm else (0.0, 0.0)
    settings = dataclasses.replace(
        settings,
        start_last=False,
        v_start=tuple(config.formats.v.raw(axis) for axis in start),
        cold=settings.warm if warm else settings.cold,
    )
    return engine.run(case.events, settings)[0]


def errors(engine, cases, *, warm=False, progress=iter):
    """Euclidean distance of the v found from the truth, px per half batch: float64 [cases]."""
    return np.array([math.dist(run_case(engine, case, warm=warm).v, case.truth) for case in progress(cases)])


def contrast_shares(engine, cases, *, progress=iter):
    """Contrast at the v found as a share of the best, with events spread and as in the article: float64 [cases, 3].

    The contrast is of all events of the batch's ROI. The last column counts those that did not fit into the buffer.
    """
    shares = []
    for case in progress(cases):
        result = run_case(engine, case)
        spread, plain = (contrasts(*case.scaled, [result.v], spread=spread)[0] for spread in (True, False))
        shares.append((spread / case.best[1], plain / case.best_unspread[1], result.overflow))
    return np.array(shares)


def percent(part, whole=1):
    """A share as text, in percent; – of nothing."""
    return f"{100 * (part / whole):.1f}" if part is not None and whole else "–"


def decimal(value, digits=2):
    """A number as text; – of None and NaN."""
    return "–" if value is None or math.isnan(value) else f"{value:.{digits}f}"


#: What is told of :func:`errors`: ``{score: (head of the column, of float64 [batches], as text)}``.
ERRORS = {
    "batches": ("batches", len, str),
    "below_0.3_px": ("< 0.3 px, %", lambda found: np.mean(found < 0.3), percent),
    "below_0.6_px": ("< 0.6 px, %", lambda found: np.mean(found < 0.6), percent),
    "median_px": ("median error, px", np.median, "{:.3f}".format),
    "largest_px": ("largest error, px", np.max, decimal),
}
#: What is told of :func:`contrast_shares`.
SHARES = {
    "batches": ("batches", len, str),
    "at_least_97_percent": ("≥ 97 % of the best, %", lambda found: np.mean(found[:, 0] >= 0.97), percent),
    "at_least_99_percent": ("≥ 99 % of the best, %", lambda found: np.mean(found[:, 0] >= 0.99), percent),
    "median": ("median share, %", lambda found: np.median(found[:, 0]), percent),
    "smallest": ("smallest share, %", lambda found: np.min(found[:, 0]), percent),
    "articles_at_least_97_percent": (
        "≥ 97 % of the article's best, %", lambda found: np.mean(found[:, 1] >= 0.97), percent,
    ),
    "batches_that_drop_events": ("batches that drop events", lambda found: int(np.count_nonzero(found[:, 2])), str),
}  # fmt: skip


def heads_of(columns):
    """Heads of the cells that :func:`cells_of` gives."""
    return tuple(head for head, *_ in columns.values())


def scored(columns, values):
    """The values as scores: ``{name: score}``."""
    return {name: score(values) for name, (_, score, _) in columns.items()}


def cells_of(columns, scores):
    """The scores as text, a tuple."""
    return tuple(text(scores[name]) for name, (*_, text) in columns.items())


#: By what, and from where to where, the errors of the synthetic batches are told apart.
BINS = (
    ("speed", "speed, px per half batch", ((0, 1), (1, 3), (3, 6), (6, 9), (1, 9))),
    ("roi_events", "n, events", ((200, 600), (600, 1200), (1200, 2001))),
    ("noise", "noise, share of n", ((0, 0.1), (0.1, 0.2), (0.2, 0.3))),
)


class Report:
    """Prints tables, and keeps what ``--json`` writes."""

    def __init__(self):
        self.results = {}

    def progress(self, cases, unit="batch"):
        """``cases``, with a bar while they are gone through."""
        return tqdm(cases, unit=unit, disable=None, leave=False)

    def keep(self, name, values, scores):
        """Keep the values of each batch, and their scores; returns the scores, None in place of NaN."""
        values = np.asarray(values).astype(object)
        values[values != values] = None  # JSON has no NaN
        scores = {key: None if isinstance(one, float) and math.isnan(one) else one for key, one in scores.items()}
        self.results[name] = {"scores": scores, "values": values.tolist()}
        return scores

    def cells(self, name, columns, values):
        """Keep values and what ``columns`` tell of them, such as :data:`ERRORS`; returns the cells."""
        return cells_of(columns, self.keep(name, values, scored(columns, values)))

    def table(self, title, heads, rows):
        """Print a table in Markdown, so that it can go into a page as it is."""
        lines = [[str(cell) for cell in line] for line in (heads, *rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        lines.insert(1, ["-" * width for width in widths])
        print(f"{title}\n")
        for line in lines:
            print("| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |")
        print()


def binned(cases, values):
    """Rows of errors by what the synthetic batches are made of."""
    groups = []
    for name, title, bins in BINS:
        facts = np.array([case.facts[name] for case in cases])
        for low, high in bins:
            last = high - 1 if name == "roi_events" else high  # whole numbers
            groups.append((f"{title}: {low} to {last}", (facts >= low) & (facts < high)))
    textures = np.array([case.facts["texture"] for case in cases])
    groups += [(f"texture: {texture}", textures == texture) for texture in SIZES]
    return [(title, *cells_of(ERRORS, scored(ERRORS, values[chosen]))) for title, chosen in groups if chosen.any()]
