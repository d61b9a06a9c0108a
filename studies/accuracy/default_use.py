"""Known recordings tracked in the default use: how many batches are answered, trusted, and wrong all the same."""

import math
from itertools import pairwise

import numpy as np

from cmfpga.api.track import track
from cmfpga.config import unread
from cmfpga.imaging.iwe import events_in_roi
from cmfpga.protocol.confidence import covariance
from cmfpga.protocol.flags import Flag

from .foreign import FOREIGN, find
from .known import recordings
from .table import decimal, percent
from .yardstick import ROI

WRONG = 0.6  # px per half batch
EVERY = 4  # hops of which one is kept; of these windows that share no time
HEADS = (
    "recording", "engine", "truth known to, px", "tracks", "batches", "answered, %", "trusted, %", "of them wrong, %",
    "median error, px", "motion, px", "in the 50, 68, 95 % ellipse, %",
)  # fmt: skip
SUM = "sum"


def batches(known, config, engine):
    """Every batch of the tracks of a recording: ``(events, result, truth, trusted)`` each; truth in px per half batch.

    Of windows that slide, those that share no time. Batches whose ROI reaches to where nothing is known are left out.
    """
    fields = config.to_dict()
    left_out = {*unread(fields), "sensor_width", "sensor_height"}
    fields = {name: value for name, value in fields.items() if name not in left_out}
    every = EVERY if config.slides else 1
    for roi in known.rois:
        tracking = track(known.events, sensor=known.sensor, roi=roi, engine=engine, every=every, **fields)
        for k, first, last in _windows(tracking, known.events):
            result, trusted = tracking.results[k], tracking.trusted[k]
            events, (left, top) = known.events[first:last], result.roi
            if left < known.left or not len(events):
                continue
            index, x, y = events_in_roi(events, (left, top), ROI, ROI)
            seen = (x + left, y + top) if len(index) else (left + ROI / 2, top + ROI / 2)
            begin, end = int(events.t[0]), int(events.t[-1])
            truth = known.truth(begin, end, *(np.atleast_1d(axis).astype(float) for axis in seen))
            yield events, result, np.asarray(truth) * (end - begin) / 2e6, bool(trusted)


def _windows(tracking, events):
    """``(index, first event, behind the last one)`` of each batch, or of windows that share no time."""
    if not tracking.config.slides:
        return [(k, *ends) for k, ends in enumerate(pairwise(np.cumsum([0, *tracking.events]).tolist()))]
    return [(k, *np.searchsorted(events.t, [begin, end + 1])) for k, begin, end in apart(tracking)]


def apart(tracking, kept=None):
    """``[(index, begin, end)]`` of windows that have no time in common, in order, in µs; ``kept``: of which."""
    found, last = [], -math.inf
    for k, (middle, result) in enumerate(zip(tracking.t_ref_us, tracking.results, strict=True)):
        if (kept is None or kept[k]) and middle - result.span / 2 >= last:
            last = middle + result.span / 2
            found.append((k, int(middle - result.span / 2), int(last)))
    return found


def sizes(off, found):
    """The square of an error (x, y) in deviations of a covariance (xx, yy, xy), px² both; NaN without one."""
    (x, y), (xx, yy, xy) = off, found or (math.nan,) * 3
    return (x * x * yy - 2 * x * y * xy + y * y * xx) / (xx * yy - xy * xy)


def in_ellipses(squares):
    """Shares of errors, squared and in deviations, in the ellipses that should hold 50, 68 and 95 % of them; or []."""
    shares = (0.5, 0.68, 0.95) if len(squares) else ()
    return [float((squares <= -2 * math.log(1 - share)).mean()) for share in shares]


def measure(known, config, engine, *, with_foreign=False):
    """``{engine: values}``, float64 [batches, 6]: answered, trusted, error, true motion, doubt of the truth (px), and
    the error in standard deviations, squared, NaN where none is stated.

    Answered is what is not degenerate. eventcv answers with two ROI events; trusted is what its score calls better
    than v = 0, as its documentation says.
    """
    values = {engine: [], **({FOREIGN: []} if with_foreign else {})}
    for events, result, truth, trusted in batches(known, config, engine):
        motion, doubt = np.hypot(*truth), known.doubt_px + known.doubt * (int(events.t[-1]) - int(events.t[0])) / 2e6
        rest, off = (motion, doubt), result.v - truth
        size = sizes(off, covariance(config, result))
        values[engine].append((Flag.DEGENERATE not in result.flags, trusted, np.hypot(*off), *rest, size))
        if with_foreign:
            v, gain = find(events, result.roi, ROI, ROI)
            values[FOREIGN].append((gain > 0, gain > 1, np.hypot(*(v - truth)), *rest, math.nan))
    return {name: np.array(rows, float).reshape(-1, 6) for name, rows in values.items()}


def scores(values, tracks):
    """The values as scores: shares, and errors in px per half batch; None where there is nothing to take it of."""
    answered, trusted = values[:, 0] > 0, values[:, 1] > 0
    wrong = trusted & (values[:, 2] > WRONG)
    return {
        "tracks": tracks,
        "batches": len(values),
        "answered": int(answered.sum()),
        "trusted": int(trusted.sum()),
        "wrong_of_trusted": int(wrong.sum()),
        "median_error_of_trusted_px": float(np.median(values[trusted, 2])) if trusted.any() else None,
        "median_motion_px": float(np.median(values[:, 3])) if len(values) else None,
        "truth_known_to_px": float(np.median(values[:, 4])) if len(values) else None,
        "in_ellipses": in_ellipses(values[trusted, 5]) if np.isfinite(values[trusted, 5]).all() else [],
    }


def _row(report, what, engine, values, tracks, **more):
    """Keep the scores, and return their cells; ``more`` scores take the place of those in the cells."""
    found = report.keep(f"known motion, {what}, {engine}", values, scores(values, tracks)) | more

    def share(part, whole):
        return f"{percent(found[part], found[whole])} ({found[part]})" if found[whole] else "–"

    return (
        what, engine, decimal(found["truth_known_to_px"]), found["tracks"], found["batches"],
        share("answered", "batches"), share("trusted", "answered"), share("wrong_of_trusted", "trusted"),
        *(decimal(found[name]) for name in ("median_error_of_trusted_px", "median_motion_px")),
        " / ".join(map(percent, found["in_ellipses"])) or "–",
    )  # fmt: skip


def run_known(engines, options, config, report):
    """Print the table of all known recordings, and of their sum."""
    lines, others, total = [], [], {}
    for one in report.progress(recordings(options.data), "recording"):
        tracks = len(one.rois)
        for engine in engines:
            with_foreign = options.eventcv and engine == engines[0]
            for name, values in measure(one, config, engine, with_foreign=with_foreign).items():
                (lines if one.in_sum else others).append(_row(report, one.name, name, values, tracks))
                if one.in_sum:
                    total.setdefault(name, []).append((values, tracks))
    for name, found in total.items():
        parts, tracks = zip(*found, strict=True)
        lines.append(_row(report, SUM, name, np.concatenate(parts), sum(tracks), truth_known_to_px=None))
    title = "Known motion, tracked without an option about batches (wrong: by more than 0.6 px)"
    report.table(title, HEADS, lines + others)
