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
from cmfpga.events import Events, open_recording

from .default_use import WRONG, apart, measure, scores
from .known import DRAWN_SIZE, GRID, by_file, drawn
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


def grid(sensor):
    """ROIs over a whole sensor, to its borders."""
    columns, rows = (np.linspace(0, side - ROI, count) for side, count in zip(sensor, GRID, strict=True))
    return [(int(x), int(y)) for y in rows for x in columns]


def _needed(data, study):
    if data is None:
        raise ConfigError(f"--study {study}: --data, a folder of recordings, is needed")
    return Path(data)


def study_slider(config, engine, cases, real_, report, *, data, **_):
    """Print how many trusted windows on the rail are off along y, by more than :data:`WRONG`."""
    path, rows = _needed(data, "slider") / SLIDER, []
    with open_recording(path) as recording:
        sensor = recording.width, recording.height
    for name, rois in ((f"{len(grid(sensor))} of a grid", grid(sensor)), ("auto", ["auto"])):
        for which in PRESETS:
            found = [_tracked(path, engine, roi=roi, preset=which) for roi in report.progress(rois, "ROI")]
            trusted = np.concatenate([one.trusted for one in found])
            away = np.abs(np.concatenate([one.vy for one in found]))[trusted]
            wrong = int((away > WRONG).sum())
            scores = {"windows": len(trusted), "trusted": len(away), "wrong": wrong}
            report.keep(f"slider, {name}, {which}", away, scores)
            told = (percent(wrong / len(away)), f"{away.max():.2f}") if len(away) else ("–", "–")
            rows.append((name, which, str(len(trusted)), str(len(away)), str(wrong), *told))
    report.table(f"The slider, vy = 0: trusted windows with |vy| above {WRONG} px per half window", SLIDER_HEADS, rows)


def _searched(events, sensor):
    """Truth of recordings that have none, px/s."""
    from cmfpga.reference.global_search import search, translation  # torch

    def truth(begin, end, left, top):
        first, last = np.searchsorted(events.t, [begin, end + 1])
        part = events[first:last]
        lows = [max(at - MARGIN, 0) for at in (left, top)]
        highs = [min(at + ROI + MARGIN, side) - 1 for at, side in zip((left, top), sensor, strict=True)]
        near = (part.x >= lows[0]) & (part.x <= highs[0]) & (part.y >= lows[1]) & (part.y <= highs[1])
        part = part[near]
        return search(translation(part.x, part.y), part.t, window=(lows[0], highs[0], lows[1], highs[1])).at_middle

    return truth


def _known(one):
    def truth(begin, end, left, top):
        first, last = np.searchsorted(one.events.t, [begin, end + 1])
        part = one.events[first:last]
        inside = (part.x >= left) & (part.x < left + ROI) & (part.y >= top) & (part.y < top + ROI)
        seen = (axis[inside].astype(float) for axis in (part.x, part.y))
        return np.asarray(one.truth(begin, end, *seen))

    return truth


def study_auto(config, engine, cases, real_, report, *, data, **_):
    """Print how many trusted windows of ``track --roi auto`` are wrong, on each recording of the folder."""
    folder, rows = _needed(data, "auto"), []
    known = by_file(folder)
    for path in report.progress(sorted(folder.glob("*.h5")), "recording"):
        with open_recording(path) as recording:
            events, sensor = Events.concatenate(recording.chunks()), (recording.width, recording.height)
        try:
            tracking = _tracked(path, engine, roi="auto")
        except UserError as error:
            report.keep(f"auto, {path.name}", [], {"refused": str(error)})
            rows.append((path.stem, "–", *["0"] * 2, *["–"] * 4, str(error).split(": ")[-1]))
            continue
        one = known.get(path.name)
        truth, kind = (_known(one), "known") if one else (_searched(events, sensor), "search")
        errors = []
        for k, begin, end in apart(tracking, tracking.trusted):
            place = int(tracking.roi_x[k]), int(tracking.roi_y[k])
            v = (tracking.vx[k], tracking.vy[k])
            if path.name == SLIDER:
                kind, error = "rail", abs(v[1])
            else:
                error = math.dist(v, truth(begin, end, *place) * (end - begin) / 2e6)
            errors.append((error, math.hypot(*v)))
        errors = np.array(errors).reshape(-1, 2)
        wrong, many = int((errors[:, 0] > WRONG).sum()), len(errors)
        scores = {"windows": len(tracking), "trusted": int(tracking.trusted.sum()), "apart": many, "wrong": wrong}
        report.keep(f"auto, {path.name}", errors, scores)
        start = ",".join(str(int(axis[0])) for axis in (tracking.roi_x, tracking.roi_y))
        told = [f"{middle:.2f}" for middle in np.median(errors, axis=0)] if many else ["–", "–"]
        rows.append((path.stem, start, *map(str, (len(tracking), scores["trusted"], many, wrong)), *told, kind))
    report.table(f"track --roi auto (wrong: by more than {WRONG} px per half window)", AUTO_HEADS, rows)


def study_drawn(config, engine, cases, real_, report, *, count, seeds, **_):
    """Print how many batches, and windows that share no time, of scenes that are drawn are trusted, and wrong."""
    rows = []
    for name in PRESETS:
        scenes = [one for seed in seeds for one in drawn(count, seed)]
        values = [measure(one, preset(name), engine)[engine] for one in report.progress(scenes, "scene")]
        values = np.concatenate(values)
        found = report.keep(f"drawn, {name}", values, scores(values, len(scenes)))
        told = (percent(found["trusted"] / found["batches"]), percent(found["wrong_of_trusted"] / found["trusted"]))
        numbers = (found[key] for key in ("batches", "trusted", "wrong_of_trusted"))
        rows.append((name, str(len(scenes)), *map(str, numbers), *told))
    low, high = DRAWN_SIZE
    report.table(f"Drawn scenes, objects of {low} to {high - 1} px: off by more than {WRONG} px", DRAWN_HEADS, rows)


#: Those of whole recordings.
STUDIES = {"slider": study_slider, "auto": study_auto, "drawn": study_drawn}
