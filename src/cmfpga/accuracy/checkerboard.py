"""A real recording of a camera that is tilted at a constant speed, tracked batch by batch with a moving ROI."""

import math
from pathlib import Path

import numpy as np

from ..events import BatchCutter, open_recording
from ..tracking.loop import track

TRACK_FILE = "davis240b_evbench_seq0002.h5"
TRACK_ROI = (92, 66)
TRACK_EVENTS = 20_000
TRACK_BATCHES = 10
TRACK_THINNING = 12  # of the second track; brings the ROI's 11,000 events below 1,024
#: px/s, along x and y, of the track of all events and of the thinned one: fewer events are a noisier velocity.
TRACK_BOUNDS = {False: ((-4.0, 4.0), (-34.0, -29.0)), True: ((-7.0, 7.0), (-34.0, -28.0))}


def track_config(config, *, thinned=False):
    """``config`` with a buffer that holds the checkerboard, or thinned out, started from the last batch's v."""
    config = config.replace(start="last")
    if thinned:
        return config.replace(thinning=TRACK_THINNING)
    return config.replace(buffer_events=max(config.buffer_events, 1 << 14))


def track_checkerboard(engine, folder, *, batches=TRACK_BATCHES):
    """(vx, vy) of each batch in px/s; (nan, nan) of a degenerate one: float64 [batches, 2]."""
    with open_recording(Path(folder) / TRACK_FILE) as recording:
        cutter = BatchCutter(recording, events=TRACK_EVENTS, max_events=engine.config.max_batch_events)
        speeds = [batch.v_px_per_s for batch in track(engine, cutter, roi=TRACK_ROI, batches=batches)]
    return np.array([speed or (math.nan, math.nan) for speed in speeds])


def track_scores(speeds, *, thinned=False):
    """``track_checkerboard`` as scores."""
    (left, right), (top, bottom) = TRACK_BOUNDS[thinned]
    vx, vy = speeds.T
    good = (vx >= left) & (vx <= right) & (vy >= top) & (vy <= bottom)  # no NaN is
    return {
        "batches": len(speeds),
        "within_bounds": int(good.sum()),
        "vx_px_per_s": [float(np.fmin.reduce(vx)), float(np.fmax.reduce(vx))],
        "vy_px_per_s": [float(np.fmin.reduce(vy)), float(np.fmax.reduce(vy))],
    }
