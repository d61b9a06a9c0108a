"""Tables of scores: their cells, and how they are printed and kept for ``--json``."""

import numpy as np
from tqdm import tqdm

from .scores import error_scores, share_scores
from .synthetic import SIZES

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
