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


def error_scores(values):
    """``errors`` as scores: shares of the batches that err by less than 0.3 and 0.6 px, median and largest error."""
    return {
        "batches": len(values),
        "below_0.3_px": float(np.mean(values < 0.3)),
        "below_0.6_px": float(np.mean(values < 0.6)),
        "median_px": float(np.median(values)),
        "largest_px": float(np.max(values)),
    }


def share_scores(values):
    """``contrast_shares`` as scores: shares of the batches that reach 97 % and 99 % of the best contrast, and so on."""
    spread, plain, dropped = values.T
    return {
        "batches": len(values),
        "at_least_97_percent": float(np.mean(spread >= 0.97)),
        "at_least_99_percent": float(np.mean(spread >= 0.99)),
        "median": float(np.median(spread)),
        "smallest": float(np.min(spread)),
        "articles_at_least_97_percent": float(np.mean(plain >= 0.97)),
        "batches_that_drop_events": int(np.count_nonzero(dropped)),
    }


ERROR_HEADS = ("batches", "< 0.3 px, %", "< 0.6 px, %", "median error, px", "largest error, px")
SHARE_HEADS = (
    "batches",
    "≥ 97 % of the best, %",
    "≥ 99 % of the best, %",
    "median share, %",
    "smallest share, %",
    "≥ 97 % of the article's best, %",
    "batches that drop events",
)

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
        """Keep the values of each batch, and their scores; returns the scores."""
        values = np.asarray(values).astype(object)
        values[values != values] = None  # JSON has no NaN
        self.results[name] = {"scores": scores, "values": values.tolist()}
        return scores

    def errors(self, name, values):
        """Keep errors; returns their cells."""
        return error_cells(self.keep(name, values, error_scores(values)))

    def shares(self, name, values):
        """Keep shares of the best contrast; returns their cells."""
        return share_cells(self.keep(name, values, share_scores(values)))

    def table(self, title, heads, rows):
        """Print a table in Markdown, so that it can go into a page as it is."""
        lines = [heads, *rows]
        widths = [max(len(line[column]) for line in lines) for column in range(len(heads))]
        rule = ["-" * width for width in widths]
        print(f"{title}\n")
        for line in (heads, rule, *rows):
            print("| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |")
        print()


def percent(share):
    """A share as text, in percent."""
    return f"{100 * share:.1f}"


def error_cells(scores):
    """Cells below :data:`ERROR_HEADS`."""
    shares = (percent(scores[f"below_{limit}_px"]) for limit in ("0.3", "0.6"))
    return str(scores["batches"]), *shares, f"{scores['median_px']:.3f}", f"{scores['largest_px']:.2f}"


def share_cells(scores):
    """Cells below :data:`SHARE_HEADS`."""
    names = ("at_least_97_percent", "at_least_99_percent", "median", "smallest", "articles_at_least_97_percent")
    dropping = str(scores["batches_that_drop_events"])
    return str(scores["batches"]), *(percent(scores[name]) for name in names), dropping


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
    return [(title, *error_cells(error_scores(values[chosen]))) for title, chosen in groups if chosen.any()]
