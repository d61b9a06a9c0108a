"""Whether confidence tells right batches from wrong ones: batches cut anywhere, at 0.25 to 2 times the fitting length.

Of synthetic batches 20 to 100 % are kept, and six in ten are moved, so that the ROI's border cuts the object. Of
recordings of known motion, ROI and time are drawn.
"""

import math

import numpy as np

from cmfpga.events import Events
from cmfpga.imaging.iwe import events_in_roi
from cmfpga.protocol.confidence import confidence, covariance, is_trustworthy

from .default_use import WRONG, in_ellipses, sizes
from .known import recordings
from .synthetic import WARM_RADIUS
from .table import measure, percent, run_case
from .yardstick import ROI, Case

FIT = 4.0  # px per half batch
FEWEST = 30  # ROI events
MIDDLE = (88, 58)  # where synthetic batches are put on a sensor of 240×180 px
FALSE_ALARMS = 0.05
HEADS = (
    "batches", "start", "results", "wrong, %", "AUC", "wrong ones caught at 5 % false alarms, %", "trusted, %",
    "of them wrong, %", "in the 50, 68, 95 % ellipse, %",
)  # fmt: skip


def cut(cases):
    """Synthetic batches, each cut twice; those that move less or more than the study wants are left out."""
    rng, made = np.random.default_rng(11), []
    for case in cases * 2:
        share, begin = rng.uniform(0.2, 1), rng.uniform()
        shift = rng.integers(-36, 37, 2) * (rng.random() < 0.6)
        events, length = case.events, len(case.events)
        first = int(begin * (1 - share) * length)
        part = events[first : first + max(int(share * length), 2)]
        part = Events(part.t, part.x + MIDDLE[0], part.y + MIDDLE[1], part.p)
        truth, roi = np.array(case.truth) / _span(events) * _span(part), tuple((shift + MIDDLE).tolist())
        made.append(_case(part, roi, truth, rng, moved=bool(shift.any())))
    return [case for case in made if case and FIT / 4 <= math.hypot(*case.truth) <= 2 * FIT]


def drawn(known, count):
    """``count`` batches of a recording of known motion at most."""
    rng, made, events = np.random.default_rng([11, *known.name.encode()]), [], known.events
    for _ in range(20 * count):
        left, top = (
            8 * int(rng.integers(-(-low // 8), (side - ROI) // 8 + 1))
            for low, side in zip((known.left, 0), known.sensor, strict=True)
        )
        where = np.array([left + ROI / 2]), np.array([top + ROI / 2])
        middle = int(rng.integers(events.t[0], events.t[-1]))
        speed = np.hypot(*known.truth(middle - 1, middle + 1, *where))
        length = min(2 ** rng.uniform(-2, 1) * 2e6 * FIT / max(speed, 1e-9), float(_span(events)) - 1)
        begin = rng.uniform(events.t[0], events.t[-1] - length)
        first, last = np.searchsorted(events.t, [begin, begin + length])
        part = events[int(first) : int(last)]
        index, x, y = events_in_roi(part, (left, top), ROI, ROI)
        if len(index) < FEWEST:
            continue
        truth = known.truth(int(part.t[0]), int(part.t[-1]), x + float(left), y + float(top))
        half_s = _span(part) / 2e6
        made.append(_case(part, (left, top), np.asarray(truth) * half_s, rng, doubt=known.doubt * half_s))
        if len(made) == count:
            break
    return [case for case in made if case]


def _span(events):
    return int(events.t[-1]) - int(events.t[0])


def _case(events, roi, truth, rng, **facts):
    """None where too few events are in the ROI. ``facts``: as of a :class:`Case`."""
    if len(events_in_roi(events, roi, ROI, ROI)[0]) < FEWEST or not _span(events):
        return None
    radius, angle = WARM_RADIUS * math.sqrt(rng.uniform()), rng.uniform(0, 2 * math.pi)
    start = truth + radius * np.array([math.cos(angle), math.sin(angle)])
    return Case(events, roi, tuple(truth.tolist()), tuple(start.tolist()), facts)


def judge(engine, cases, *, warm, progress):
    """Error in px per half batch, confidence, whether it is trusted, error in deviations²: float64 [cases, 4]."""
    found = []
    for case in progress(cases):
        result = run_case(engine, case, warm=warm)
        kappa = confidence(engine.config, result)
        sure, (x, y) = is_trustworthy(engine.config, result), np.subtract(result.v, case.truth)
        size = sizes((x, y), covariance(engine.config, result), case.facts.get("doubt", 0.0))
        found.append((math.hypot(x, y), -math.inf if kappa is None else kappa, sure, size))
    return np.array(found, float).reshape(-1, 4)


def separation(values):
    """``(AUC, caught)`` by confidence: the probability that a right batch has a higher one than a wrong one, and the
    share of the wrong ones below what 5 % of the right ones fall below. NaN where there are not both."""
    wrong = values[:, 0] > WRONG
    bad, good = values[wrong, 1], np.sort(values[~wrong, 1])
    if not len(bad) or not len(good):
        return math.nan, math.nan
    below = np.searchsorted(good, bad, "left"), np.searchsorted(good, bad, "right")
    auc = 1 - (below[0] + below[1]).mean() / 2 / len(good)
    return float(auc), float(np.mean(bad < np.quantile(good, FALSE_ALARMS)))


def study_confidence(config, engine, cases, real, report, *, data, count, **_):
    """Print AUC and verdicts: synthetic batches, cut; and, with a folder, as many of each real recording."""
    batches = {"synthetic": cut(cases)}
    if data is not None:
        known = [one for one in recordings(data) if one.in_sum and one.doubt]
        batches["real, known motion"] = [case for one in known for case in drawn(one, count)]
    rows = []
    for name, made in batches.items():
        parts = [measure(engine, config, judge, made, warm=warm, progress=report.progress) for warm in (False, True)]
        rows += [_row(report, name, start, values) for start, values in zip(("cold", "warm"), parts, strict=True)]
        rows.append(_row(report, name, "both", np.concatenate(parts)))
        whole = np.array([not case.facts.get("moved", True) for case in made])
        if whole.any():
            values = np.concatenate([part[whole] for part in parts])
            rows.append(_row(report, f"{name}, whole objects", "both", values))
    report.table("Confidence against the true error (wrong: by more than 0.6 px)", HEADS, rows)


def judgement(values):
    """What :func:`judge` found, as scores: how κ separates, and shares that are wrong, trusted, and wrong of these."""
    sure, wrong = values[:, 2] > 0, values[:, 0] > WRONG
    of_trusted = float(wrong[sure].mean()) if sure.any() else None
    auc, caught = separation(values)
    told = {"results": len(values), "auc": auc, "caught": caught, "wrong": float(wrong.mean())}
    return told | {"trusted": float(sure.mean()), "wrong_of_trusted": of_trusted}


def _row(report, name, start, values):
    sure = values[values[:, 2] > 0]
    told = judgement(values) | ({"in_ellipses": in_ellipses(sure[:, 3])} if len(sure) else {})
    auc = f"{told['auc']:.3f}"
    told = report.keep(f"confidence, {name}, {start}", np.where(np.isfinite(values), values, np.nan), told)
    shares = (percent(told[key]) for key in ("caught", "trusted", "wrong_of_trusted"))
    ellipses = " / ".join(map(percent, told.get("in_ellipses", ())))
    return name, start, len(values), percent(told["wrong"]), auc, *shares, ellipses
