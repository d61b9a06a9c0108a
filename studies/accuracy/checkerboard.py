"""A real recording of a camera that is tilted at a constant speed, tracked batch by batch with a moving ROI."""

import math
from pathlib import Path

import numpy as np

from cmfpga.events import BatchCutter, open_recording
from cmfpga.tracking.loop import track

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
