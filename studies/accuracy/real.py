"""Real recordings of DAVIS cameras: batches in :data:`WINDOWS`, of the ROIs with most events in each; and a track.

In each window the image moves by 3 to 5 px per half batch. The motion is not known, so the yardstick is the contrast at
the v found, as a share of the best that :mod:`.yardstick` finds. Where the configuration's buffer is too small for a
batch, events are dropped, and that is counted. The track is of a camera that is tilted at a constant speed.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from cmfpga.events import BatchCutter, open_recording
from cmfpga.imaging.survey.statistics import box_sums
from cmfpga.tracking.loop import track

from .known import between, read
from .yardstick import ROI, Case


@dataclass(frozen=True)
class Windows:
    """Consecutive windows of a recording: begin and length in µs from the recording's first event, and ROIs of each."""

    file: str
    begin: int
    length: int
    count: int
    rois: int
    hot: tuple[int, int] | None = None  # a pixel that emits by itself, px


# Lengths from the speeds that are known of each recording: about 4 px per half window.
WINDOWS = (
    Windows("davis240c_shapes_rotation_0.0s.h5", 760_000, 65_000, 6, 4),  # 120 px/s
    Windows("davis240c_shapes_rotation_2.1s_gtflow.h5", 0, 66_000, 1, 5),  # 120 px/s
    Windows("davis240c_shapes_translation_52.0s.h5", 0, 14_000, 3, 4),  # 560 px/s
    Windows("davis240c_slider_depth_0.0s.h5", 10_000, 80_000, 2, 4),  # 40 to 150 px/s
    Windows("davis240c_translboxes_imu.h5", 0, 300_000, 6, 2),  # 19 to 31 px/s
    Windows("davis240b_evbench_seq0002.h5", 0, 240_000, 8, 2, hot=(27, 70)),  # 32 px/s
)
REAL_ROI_EVENTS = (500, 4096)
ROI_STEP = 8  # px; ROIs are looked for at multiples of this


def real_cases(folder):
    """The real batches, a list of :class:`Case`. Raises :exc:`RecordingError` where a recording is missing."""
    made = []
    for windows in WINDOWS:
        events, sensor = read(Path(folder) / windows.file)
        ends = events.t[0] + windows.begin + windows.length * np.arange(windows.count + 1)
        for index, pair in enumerate(pairwise(ends)):
            batch = between(events, *pair)
            for roi, count in _busiest_rois(batch, sensor, windows):
                facts = {"file": windows.file, "window": index, "roi": roi, "roi_events": count}
                made.append(Case(batch, roi, None, None, facts))
    return made


def counts(events, sensor, size, step):
    """``{(x, y): events}`` of the ROIs of a size, every ``step`` px along x and y."""
    pixels = np.zeros(sensor[::-1], np.int64)
    np.add.at(pixels, (events.y, events.x), 1)
    sums = np.ndenumerate(box_sums(pixels, *size)[:: step[1], :: step[0]])
    return {(x * step[0], y * step[1]): int(n) for (y, x), n in sums}


def _busiest_rois(batch, sensor, windows):
    """``[((x, y), events)]`` of one window: that with most events, then of those that do not overlap it, and so on."""

    def holds(roi, pixel):
        return pixel is not None and all(0 <= at - corner < ROI for at, corner in zip(pixel, roi, strict=True))

    of_each, found = counts(batch, sensor, (ROI, ROI), (ROI_STEP, ROI_STEP)), []
    low, high = REAL_ROI_EVENTS
    of_each = {roi: n for roi, n in of_each.items() if low <= n <= high and not holds(roi, windows.hot)}
    while of_each and len(found) < windows.rois:
        x, y = best = max(of_each, key=of_each.get)
        found.append((best, of_each[best]))
        of_each = {(a, b): n for (a, b), n in of_each.items() if abs(a - x) >= ROI or abs(b - y) >= ROI}
    return found


TRACK_FILE = "davis240b_evbench_seq0002.h5"
TRACK_ROI = (92, 66)
TRACK_EVENTS = 20_000
TRACK_BATCHES = 10
#: Tracks: with a buffer that holds the ROI's 11,000 events; as the configuration is; thinned out to fewer than 1,024.
TRACKS = {"track": {"buffer_events": 1 << 14}, "track as it is": {}, "thinned track": {"thinning": 12}}
#: px/s, along x and y; fewer events are a noisier velocity.
TRACK_BOUNDS = dict.fromkeys(TRACKS, ((-7.0, 7.0), (-34.0, -28.0))) | {"track": ((-4.0, 4.0), (-34.0, -29.0))}


def track_config(config, what):
    """``config`` for one of :data:`TRACKS`, started from the last batch's v."""
    return config.replace(start="last", **TRACKS[what])


def track_checkerboard(engine, folder, *, batches=TRACK_BATCHES):
    """(vx, vy) of each batch in px/s; (nan, nan) of a degenerate one: float64 [batches, 2]."""
    with open_recording(Path(folder) / TRACK_FILE) as recording:
        cutter = BatchCutter(recording, events=TRACK_EVENTS, max_events=engine.config.max_batch_events)
        speeds = [batch.v_px_per_s for batch in track(engine, cutter, roi=TRACK_ROI, batches=batches)]
    return np.array([speed or (math.nan, math.nan) for speed in speeds])


def track_scores(speeds, what):
    """``track_checkerboard`` as scores."""
    (left, right), (top, bottom) = TRACK_BOUNDS[what]
    vx, vy = speeds.T
    good = (vx >= left) & (vx <= right) & (vy >= top) & (vy <= bottom)  # no NaN is
    return {
        "batches": len(speeds),
        "within_bounds": int(good.sum()),
        "vx_px_per_s": [float(np.fmin.reduce(vx)), float(np.fmax.reduce(vx))],
        "vy_px_per_s": [float(np.fmin.reduce(vy)), float(np.fmax.reduce(vy))],
    }
