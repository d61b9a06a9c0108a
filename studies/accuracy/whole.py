"""``track`` on whole recordings, with no option beside the ROI: a grid of ROIs on the slider, and ``--roi auto``.

The camera on the slider's rail sees everything move along x only: vy = 0 is the truth of all its windows. The other
recordings' truth is that of :mod:`.known`, or else a search in float64 over the events of a larger place in the same
window: it shares the objective, not the ROI, the start or the arithmetic.
"""

import math
import warnings
from pathlib import Path

import numpy as np

from cmfpga.api.track import track
from cmfpga.config import preset
from cmfpga.errors import ConfigError, UserError
from cmfpga.imaging.iwe import events_in_roi

from .default_use import WRONG, apart, measure, scores
from .known import DRAWN_SIZE, between, by_file, drawn, grid, read
from .table import percent
from .yardstick import ROI

SLIDER = "davis240c_slider_depth_0.0s.h5"
PRESETS = ("sliding", "fast")
MARGIN = 8  # px around the ROI, of a search
SLIDER_HEADS = ("ROIs", "preset", "windows", "trusted", "of these wrong", "wrong, %", "largest, px")
DRAWN_HEADS = ("preset", "scenes", "windows", "trusted", "of these wrong", "trusted, %", "wrong, %")
AUTO_HEADS = (
    "recording", "ROI", "windows", "trusted", "apart in time", "of these wrong", "median error, px",
    "median motion, px", "truth",
)  # fmt: skip


def _tracked(path, engine, **options):
    """A :class:`~cmfpga.api.track_result.Tracking`; its remarks are for people at a terminal."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return track(path, engine=engine, **options)


def _needed(data, study):
    if data is None:
        raise ConfigError(f"--study {study}: --data, a folder of recordings, is needed")
    return Path(data)


def study_slider(config, engine, cases, real_, report, *, data, **_):
    """Print how many trusted windows on the rail are off along y, by more than :data:`WRONG`."""
    path, rows = _needed(data, "slider") / SLIDER, []
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
    report.table(f"The slider, vy = 0: trusted windows with |vy| above {WRONG} px per half window", SLIDER_HEADS, rows)


def _searched(events, sensor, place):
    """Truth of recordings that have none, px/s: of the events of a window, in and around an ROI."""
    from cmfpga.reference.global_search import search, translation  # torch

    lows = [max(at - MARGIN, 0) for at in place]
    highs = [min(at + ROI + MARGIN, side) - 1 for at, side in zip(place, sensor, strict=True)]
    near = (events.x >= lows[0]) & (events.x <= highs[0]) & (events.y >= lows[1]) & (events.y <= highs[1])
    part = events[near]
    return search(translation(part.x, part.y), part.t, window=(lows[0], highs[0], lows[1], highs[1])).at_middle


def study_auto(config, engine, cases, real_, report, *, data, **_):
    """Print how many trusted windows of ``track --roi auto`` are wrong, on each recording of the folder."""
    folder, rows = _needed(data, "auto"), []
    known = by_file(folder)
    for path in report.progress(sorted(folder.glob("*.h5")), "recording"):
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
                _, x, y = events_in_roi(part, place, ROI, ROI)
                truth = np.asarray(one.truth(begin, end, x + float(place[0]), y + float(place[1])))
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
    report.table(f"track --roi auto (wrong: by more than {WRONG} px per half window)", AUTO_HEADS, rows)


def study_drawn(config, engine, cases, real_, report, *, count, seeds, **_):
    """Print how many batches, and windows that share no time, of scenes that are drawn are trusted, and wrong."""
    rows = []
    for name in PRESETS:
        scenes = [one for seed in seeds for one in drawn(count, seed)]
        values = [measure(one, preset(name), engine)[engine] for one in report.progress(scenes, "scene")]
        values = np.concatenate(values)
        found = report.keep(f"drawn, {name}", values, scores(values, len(scenes)))
        whole, trusted, wrong = (found[key] for key in ("batches", "trusted", "wrong_of_trusted"))
        rows.append((name, len(scenes), whole, trusted, wrong, percent(trusted, whole), percent(wrong, trusted)))
    low, high = DRAWN_SIZE
    report.table(f"Drawn scenes, objects of {low} to {high - 1} px: off by more than {WRONG} px", DRAWN_HEADS, rows)


#: Those of whole recordings.
STUDIES = {"slider": study_slider, "auto": study_auto, "drawn": study_drawn}
