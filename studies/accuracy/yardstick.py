"""A batch, what is known about it, and its yardstick: its best contrast, by a fine search, and where its peak lies.

The article's contrast is no fair yardstick. Events lie on whole pixels, so the image is sharper wherever vx or vy is
zero, whatever the motion is. Where events are spread, each votes from everywhere in its pixel, as it may have come from
anywhere in it. The image is then the mean over all dithers, and no dither is favoured.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cmfpga.config import preset
from cmfpga.events import Events
from cmfpga.imaging.iwe import dithered, image_of_votes, scaled_roi_events, votes_along

ROI = 64  # columns and rows of the ROI of all suites, px


def contrasts(x, y, dt, velocities, *, spread=True):
    """Population variance of the image of warped events at each of ``velocities``, float64 [k, 2]: float64 [k]."""
    velocities = np.asarray(velocities, float)
    along = [
        {v: votes_along(at, dt, v, ROI, spread=spread) for v in {*axis.tolist()}}
        for at, axis in zip((x, y), velocities.T, strict=True)
    ]
    return np.array([_variance(image_of_votes(along[0][vx], along[1][vy], ROI, ROI)) for vx, vy in velocities.tolist()])


def _variance(image):
    """As ``image.var()``, in a third of the time on an image of this size."""
    pixels = image.ravel()
    mean = pixels.sum() / pixels.size
    return pixels @ pixels / pixels.size - mean * mean


def best_contrast(x, y, dt, *, centre=(0.0, 0.0), radius=8.0, step=0.5, rounds=3, spread=True):
    """``(v, contrast)`` of a search on a grid of ``step`` px around ``centre``, refined ``rounds`` times by 4."""
    axis = np.arange(-radius, radius + step / 2, step)
    best, highest = np.asarray(centre, float), -1.0
    for _ in range(rounds + 1):
        grid = best + np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
        values = contrasts(x, y, dt, grid, spread=spread)
        if values.max() > highest:
            best, highest = grid[values.argmax()], float(values.max())
        axis = np.arange(-4, 5) * step / 4
        step /= 4
    return tuple(best.tolist()), highest


def peak_error(case, radius=1.5):
    """How far, in px per half batch, the dithered objective's own best v lies from the truth, within ``radius`` px.

    An ascent that found the peak exactly would err by this much. Peaks farther away are not looked for.
    """
    x, y, dt = case.scaled
    found, _ = best_contrast(*dithered(x, y), dt, centre=case.truth, radius=radius, step=0.25, spread=False)
    return math.dist(found, case.truth)


@dataclass(frozen=True, eq=False)
class Case:
    """A batch, and what is known about it; ``facts`` are what it is made of, by name."""

    events: Events  # all of the batch
    roi: tuple[int, int]  # left column and top row, px
    truth: tuple[float, float] | None  # true velocity, px per half batch
    start: tuple[float, float] | None  # where the warm suite starts, px per half batch
    facts: dict

    @cached_property
    def scaled(self):
        """Columns and rows in the ROI, and dt, of all of the ROI's events: no buffer drops any."""
        return scaled_roi_events(preset("paper").replace(buffer_events=1 << 14), self.events, self.roi)

    @cached_property
    def best(self):
        """``(v, contrast)`` that a fine search finds, with events spread over their pixels."""
        return best_contrast(*self.scaled)

    @cached_property
    def best_unspread(self):
        """The same by the article's contrast."""
        return best_contrast(*self.scaled, spread=False)
