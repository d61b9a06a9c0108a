"""A recording made up; and what a track wrote: its rows as columns, and its picture."""

import matplotlib.image
import numpy as np

from cmfpga.events import Events, MemoryRecording


def recording(t, x=10, y=10):
    count = len(t)
    events = Events(t, np.broadcast_to(x, count), np.broadcast_to(y, count), np.zeros(count))
    return MemoryRecording(events, 40, 30, "made up")


def floats(rows, name):
    return np.array([float(row[name]) for row in rows])


def flags(rows):
    """Flags of each row but ``short``, which is a note."""
    return ["|".join(name for name in row["flags"].split("|") if name != "short") for row in rows]


def but_cycles(rows):
    return [{**row, "cycles": ""} for row in rows]


def looks_like_a_track(path, *, moves=True):
    """Large enough to read, and with what must be on it: the ROI in red, and in cyan its trail if it moves."""
    pixels = matplotlib.image.imread(path)[..., :3]
    height, width, _ = pixels.shape
    assert 800 <= height <= 1200 and 1300 <= width <= 1800
    assert 20_000 < path.stat().st_size < 2_000_000
    assert 0.1 < pixels.mean() < 0.95 and pixels.std() > 0.1

    def share(colour):
        return (np.abs(pixels - colour).max(axis=2) < 0.02).mean()

    assert share((0, 0, 0)) > 0.05  # sensor frames, black where no event was
    assert share((0.8392, 0.1529, 0.1569)) > 1e-4  # tab:red
    assert (share((0.0902, 0.7451, 0.8118)) > 1e-5) == moves  # tab:cyan
    return share
