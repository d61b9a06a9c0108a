"""What an engine finds of each batch, and scores of that."""

import dataclasses
import math
from contextlib import closing

import numpy as np

from cmfpga.engines import make_engine
from cmfpga.protocol.settings import BatchSettings

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
