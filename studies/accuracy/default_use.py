"""Recordings tracked in the default use: how many batches are answered, trusted, and wrong all the same.

Known ones; and whole ones with no option beside the ROI. The camera on the slider's rail sees everything move along x
only: vy = 0 is the truth of all its windows. Others' truth is that of :mod:`.known`, or else a search in float64 over
the events of a larger place in the same window: it shares the objective, not the ROI, the start or the arithmetic.
"""

import itertools
import math
import warnings
from pathlib import Path

import numpy as np

from cmfpga.api.track import track
from cmfpga.config import preset, unread
from cmfpga.errors import UserError
from cmfpga.imaging.iwe import events_in_roi
from cmfpga.protocol.confidence import covariance
from cmfpga.protocol.flags import Flag
from cmfpga.reference.global_search import search, translation

from .foreign import FOREIGN, find
from .known import DRAWN, DRAWN_SIZE, between, by_file, drawn, grid, read, recordings
from .table import decimal, percent
from .yardstick import ROI

WRONG = 0.6  # px per half batch
EVERY = 4  # hops of which one is kept; of these windows that share no time
HEADS = (
    "recording", "engine", "truth known to, px", "tracks", "batches", "answered, %", "trusted, %", "of them wrong, %",
    "median error, px", "motion, px", "in the 50, 68, 95 % ellipse, %",
)  # fmt: skip
SUM = "sum"

SLIDER = "davis240c_slider_depth_0.0s.h5"
PRESETS = ("sliding", "fast")
MARGIN = 8  # px around the ROI, of a search


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
            events = known.events[first:last]
            if result.roi[0] < known.left or not len(events):
                continue
            begin, end = int(events.t[0]), int(events.t[-1])
            yield events, result, _truth(known, events, result.roi, begin, end) * (end - begin) / 2e6, bool(trusted)


def _truth(known, events, roi, begin, end):
    """Of what is seen in an ROI between two times, px/s; ``events`` are those between them."""
    index, x, y = events_in_roi(events, roi, ROI, ROI)
    seen = (x + roi[0], y + roi[1]) if len(index) else np.add(roi, ROI / 2)
    return np.asarray(known.truth(begin, end, *(np.atleast_1d(axis).astype(float) for axis in seen)))


def _windows(tracking, events):
    """``(index, first event, behind the last one)`` of each batch, or of windows that share no time."""
    if not tracking.config.slides:
        return [(k, *ends) for k, ends in enumerate(itertools.pairwise(np.cumsum([0, *tracking.events]).tolist()))]
    return [(k, *np.searchsorted(events.t, [begin, end + 1])) for k, begin, end in apart(tracking)]


def apart(tracking, kept=None):
    """``[(index, begin, end)]`` of windows that have no time in common, in order, in µs; ``kept``: of which."""
    found, last = [], -math.inf
    for k, (middle, result) in enumerate(zip(tracking.t_ref_us, tracking.results, strict=True)):
        if (kept is None or kept[k]) and middle - result.span / 2 >= last:
            last = middle + result.span / 2
            found.append((k, int(middle - result.span / 2), int(last)))
    return found


def sizes(off, found, doubt=0.0):
    """The square of an error (x, y) in deviations of a covariance (xx, yy, xy), px² both; NaN without one.

    ``doubt``: the standard deviation of the truth, px, which adds to it.
    """
    (x, y), (xx, yy, xy) = off, found or (math.nan,) * 3
    xx, yy = xx + doubt**2, yy + doubt**2
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
        size = sizes(off, covariance(config, result), doubt)
        values[engine].append((Flag.DEGENERATE not in result.flags, trusted, np.hypot(*off), *rest, size))
        if with_foreign:
            v, gain = find(events, result.roi, ROI, ROI)
            values[FOREIGN].append((gain > 0, gain > 1, np.hypot(*(v - truth)), *rest, math.nan))
    return {name: np.array(rows, float).reshape(-1, 6) for name, rows in values.items()}


def scores(values, tracks):
    """The values as scores: shares, and errors in px per half batch; None where there is nothing to take it of."""
    answered, trusted = values[:, 0] > 0, values[:, 1] > 0
    columns = values[trusted, 2], values[:, 3], values[:, 4]
    error, motion, known_to = (float(np.median(each)) if len(each) else None for each in columns)
    return {
        "tracks": tracks, "batches": len(values), "answered": int(answered.sum()), "trusted": int(trusted.sum()),
        "wrong_of_trusted": int((values[trusted, 2] > WRONG).sum()), "median_error_of_trusted_px": error,
        "median_motion_px": motion, "truth_known_to_px": known_to,
        "in_ellipses": in_ellipses(values[trusted, 5]) if np.isfinite(values[trusted, 5]).all() else [],
    }  # fmt: skip


def _row(report, what, engine, values, tracks, **more):
    """Keep the scores, and return their cells; ``more`` scores take the place of those in the cells."""
    found = report.keep(f"known motion, {what}, {engine}", values, scores(values, tracks)) | more

    def share(part, whole):
        return f"{percent(found[part], found[whole])} ({found[part]})" if found[whole] else "–"

    return (
        what, engine, decimal(found["truth_known_to_px"]), found["tracks"], found["batches"],
        share("answered", "batches"), share("trusted", "answered"), share("wrong_of_trusted", "trusted"),
        *(decimal(found[name]) for name in ("median_error_of_trusted_px", "median_motion_px")),
        held(found),
    )  # fmt: skip


def held(found):
    """What the ellipses of some scores hold, as text."""
    return " / ".join(map(percent, found["in_ellipses"])) or "–"


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


def _tracked(path, engine, **options):
    """A :class:`~cmfpga.api.track_result.Tracking`; its remarks are for people at a terminal."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return track(path, engine=engine, **options)


def study_slider(config, engine, cases, real_, report, *, data, **_):
    """Print how many trusted windows on the rail are off along y, by more than :data:`WRONG`."""
    path, rows = Path(data) / SLIDER, []
    places = grid(read(path)[1])
    for name, rois in ((f"{len(places)} of a grid", places), ("auto", ["auto"])):
        for which in PRESETS:
            found = [_tracked(path, engine, roi=roi, preset=which) for roi in report.progress(rois, "ROI")]
            trusted = np.concatenate([one.trusted for one in found])
            away = np.abs(np.concatenate([one.vy for one in found]))[trusted]
            wrong = int((away > WRONG).sum())
            scores = {"windows": len(trusted), "trusted": len(away), "wrong": wrong}
            report.keep(f"slider, {name}, {which}", away, scores)
            largest = f"{away.max():.2f}" if len(away) else "–"
            rows.append((name, which, len(trusted), len(away), wrong, percent(wrong, len(away)), largest))
    heads = ("ROIs", "preset", "windows", "trusted", "of these wrong", "wrong, %", "largest, px")
    report.table(f"The slider, vy = 0: trusted windows with |vy| above {WRONG} px per half window", heads, rows)


def _searched(events, sensor, place):
    """Truth of recordings that have none, px/s: of the events of a window, in and around an ROI."""
    lows = [max(at - MARGIN, 0) for at in place]
    highs = [min(at + ROI + MARGIN, side) - 1 for at, side in zip(place, sensor, strict=True)]
    near = (events.x >= lows[0]) & (events.x <= highs[0]) & (events.y >= lows[1]) & (events.y <= highs[1])
    part = events[near]
    return search(translation(part.x, part.y), part.t, window=(lows[0], highs[0], lows[1], highs[1])).at_middle


def study_auto(config, engine, cases, real_, report, *, data, **_):
    """Print how many trusted windows of ``track --roi auto`` are wrong, on each recording of the folder."""
    known, rows = by_file(data), []
    for path in report.progress(sorted(Path(data).glob("*.h5")), "recording"):
        events, sensor = read(path)
        try:
            tracking = _tracked(path, engine, roi="auto")
        except UserError as error:
            report.keep(f"auto, {path.name}", [], {"refused": str(error)})
            rows.append((path.stem, "–", 0, 0, *["–"] * 4, str(error).split(": ")[-1]))
            continue
        one, errors = known.get(path.name), []
        kind = "known" if one else "rail" if path.name == SLIDER else "search"
        for k, begin, end in apart(tracking, tracking.trusted):
            place = int(tracking.roi_x[k]), int(tracking.roi_y[k])
            v = (tracking.vx[k], tracking.vy[k])
            part = between(one.events if one else events, begin, end + 1)
            if one:
                truth = _truth(one, part, place, begin, end)
            elif kind == "search":
                truth = _searched(part, sensor, place)
            off = abs(v[1]) if kind == "rail" else math.dist(v, truth * (end - begin) / 2e6)
            errors.append((off, math.hypot(*v)))
        errors = np.array(errors).reshape(-1, 2)
        wrong, many = int((errors[:, 0] > WRONG).sum()), len(errors)
        scores = {"windows": len(tracking), "trusted": int(tracking.trusted.sum()), "apart": many, "wrong": wrong}
        report.keep(f"auto, {path.name}", errors, scores)
        start = ",".join(str(int(axis[0])) for axis in (tracking.roi_x, tracking.roi_y))
        told = [f"{middle:.2f}" for middle in np.median(errors, axis=0)] if many else ["–", "–"]
        rows.append((path.stem, start, len(tracking), scores["trusted"], many, wrong, *told, kind))
    heads = (
        "recording", "ROI", "windows", "trusted", "apart in time", "of these wrong", "median error, px",
        "median motion, px", "truth",
    )  # fmt: skip
    report.table(f"track --roi auto (wrong: by more than {WRONG} px per half window)", heads, rows)


def study_drawn(config, engine, cases, real_, report, *, count, seeds, **_):
    """Print how many batches, and windows that share no time, of scenes that are drawn are trusted, and wrong."""
    rows = []
    for name, kind in itertools.product(PRESETS, DRAWN):
        scenes = [one for seed in seeds for one in drawn(count, seed, kind)]
        values = [measure(one, preset(name), engine)[engine] for one in report.progress(scenes, "scene")]
        values = np.concatenate(values)
        found = report.keep(f"drawn, {kind}, {name}", values, scores(values, len(scenes)))
        whole, trusted, wrong = (found[key] for key in ("batches", "trusted", "wrong_of_trusted"))
        shares = percent(trusted, whole), percent(wrong, trusted), held(found)
        rows.append((name, kind, len(scenes), whole, trusted, wrong, *shares))
    low, high = DRAWN_SIZE
    heads = ("preset", "kind", "scenes", "windows", "trusted", "of these wrong", "trusted, %", "wrong, %", HEADS[-1])
    report.table(f"Drawn scenes, objects of {low} to {high - 1} px: off by more than {WRONG} px", heads, rows)


#: The studies of whole recordings.
STUDIES = {"slider": study_slider, "auto": study_auto, "drawn": study_drawn}
