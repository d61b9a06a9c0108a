"""One window of a recording, and the flow that the hardware found in it."""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..imaging.camera import nearest
from ..imaging.iwe import dithered, image_of_warped_events
from ..imaging.survey.places import box_sums
from ..protocol.confidence import confidence, covariance
from ..protocol.flags import Flag
from ..tracking.loop import Measured

#: Columns of ``flow.csv``: format and meaning.
COLUMNS = {
    "window": ("{}", "number of the window, from 0"),
    "t_ref_us": ("{:.1f}", "middle of the window's time range, µs on the recording's clock; empty without events"),
    "x": ("{}", "left column of the tile, px"),
    "y": ("{}", "top row of the tile, px"),
    "width": ("{}", "width of the tile, px"),
    "height": ("{}", "height of the tile, px"),
    "events": ("{}", "events of the tile that the flow is found from"),
    "vx_px_per_s": ("{:.3f}", "flow to the right, px/s; empty of a degenerate tile"),
    "vy_px_per_s": ("{:.3f}", "flow downwards, px/s"),
    "confidence": ("{:.3f}", "κ, 1/px²: how sharp the contrast's peak is; empty where it was not measured"),
    "flags": ("{}", "names of the flags that are set, joined by `|`"),
}


@dataclass(frozen=True, eq=False)
class Window(Measured):
    """What was found in one window. ``n`` tiles are in the order of :attr:`Tiles.corners`.

    Parameters
    ----------
    tiles : Tiles
    cycles : int or None
        Clock cycles from the offer of its first event to the last result; None of engines without a clock.
    """

    tiles: Any
    cycles: int | None = None

    def _each(self, value, none):
        """``value(outcome)`` of each tile as float64; ``none`` where it is None."""
        outcomes = self.tiles.of(self.result)
        return np.array([none if (one := value(outcome)) is None else one for outcome in outcomes], np.float64)

    @functools.cached_property
    def flags(self):
        """Bits of :class:`Flag` of each tile: int64 [n]."""
        return self._each(lambda one: int(one.flags), 0).astype(np.int64)

    @property
    def trusted(self):
        """Which tiles are neither degenerate nor doubtful: bool [n]."""
        return (self.flags & (Flag.DEGENERATE | Flag.DOUBTFUL)) == 0

    @functools.cached_property
    def counts(self):
        """Events that the flow of each tile is found from: int64 [n]."""
        return self._each(lambda one: one.roi_events, 0).astype(np.int64)

    @functools.cached_property
    def v(self):
        """Flow of each tile, px per half window: float64 [n, 2]; NaN of degenerate ones."""
        return self._each(lambda one: None if Flag.DEGENERATE in one.flags else one.v, (np.nan, np.nan))

    @property
    def px_per_s(self):
        """The same in px/s."""
        return self.v / max(self.half_s, 1e-9)

    @functools.cached_property
    def kappa(self):
        """Confidence of each tile, 1/px²: float64 [n]; NaN where it was not measured."""
        return self._each(functools.partial(confidence, self.config), np.nan)

    @functools.cached_property
    def covariance(self):
        """Of each tile's flow, (px/s)²: xx, yy, xy, float64 [n, 3]; NaN of tiles that are not trusted."""
        found = self._each(functools.partial(covariance, self.config), (np.nan,) * 3)
        return found / max(self.half_s, 1e-9) ** 2

    @property
    def outside(self):
        """Events off the undistorted image; they are in no tile."""
        return int((~nearest(self.config, self.seen.x, self.seen.y)[2]).sum())

    @property
    def moved(self):
        """How far the image moves, px per half window: the median of the trusted tiles.

        None where fewer than a quarter of the tiles that were measured are trusted, or fewer than eight.
        """
        trusted = int(self.trusted.sum())
        if trusted < max(8, 0.25 * np.isfinite(self.v[:, 0]).sum()):
            return None
        return float(np.median(np.hypot(*self.v[self.trusted].T)))

    @property
    def centres(self):
        """Mean position of the events of each tile, px: float64 [n, 2]; of an empty one its middle."""
        size = self.config.sensor_height, self.config.sensor_width
        at = self.seen
        column, row, inside = nearest(self.config, at.x, at.y)
        pixel, x, y = (row * size[1] + column)[inside], at.x[inside], at.y[inside]
        left, top = np.array(self.tiles.corners).T
        sums = []
        for weight in (None, x, y):
            pixels = np.bincount(pixel, weight, size[0] * size[1]).reshape(size)
            sums.append(box_sums(pixels, self.tiles.width, self.tiles.height)[top, left])
        middle = np.array(self.tiles.corners) + (np.array([self.tiles.width, self.tiles.height]) - 1) / 2
        count, *sums = sums
        return np.where(count[:, None] > 0.5, np.transpose(sums) / np.maximum(count, 1)[:, None], middle)

    def rows(self):
        """Text of the window's rows of ``flow.csv``."""
        t_ref = "" if self.t_ref is None else COLUMNS["t_ref_us"][0].format(self.t_ref)
        told = zip(self.tiles.corners, self.counts, self.px_per_s, self.kappa, self.flags, strict=True)
        for (x, y), count, v, kappa, flags in told:
            numbers = {"vx_px_per_s": v[0], "vy_px_per_s": v[1], "confidence": kappa}
            texts = ("" if np.isnan(value) else COLUMNS[name][0].format(value) for name, value in numbers.items())
            yield (self.index, t_ref, x, y, self.tiles.width, self.tiles.height, count, *texts, Flag(int(flags)).text)

    def flow_at(self, x, y):
        """The flow between the middles of the tiles, px per half window: float64 [2, n].

        Tiles that are not trusted have the mean of the nearest four that are, nearer ones counting more; without a
        trusted tile there is no flow: 0.
        """
        field = np.where(self.trusted[:, None], self.v, 0.0)
        known = np.flatnonzero(self.trusted)
        if not len(known):
            return np.zeros((2, len(x)))
        corners = np.array(self.tiles.corners, np.float64)
        for k in np.flatnonzero(~self.trusted):
            away = np.hypot(*(corners[known] - corners[k]).T)
            near = np.argsort(away, kind="stable")[:4]
            field[k] = np.average(self.v[known[near]], axis=0, weights=1 / away[near])
        field = field.reshape(len(self.tiles.rows), len(self.tiles.columns), 2)
        (i, u), (j, w) = (
            _between(np.asarray(at, np.float64), np.array(places) + (side - 1) / 2)
            for at, places, side in (
                (x, self.tiles.columns, self.tiles.width),
                (y, self.tiles.rows, self.tiles.height),
            )
        )
        right, below = np.minimum(i + 1, field.shape[1] - 1), np.minimum(j + 1, field.shape[0] - 1)
        u, w = u[:, None], w[:, None]
        upper, lower = (field[row, i] * (1 - u) + field[row, right] * u for row in (j, below))
        return (upper * (1 - w) + lower * w).T

    def images(self):
        """All events of the window as they came, and moved back by the flow: two float64 [rows, columns].

        Dithered, or edges that lie on whole pixels would look sharp whatever the motion is.
        """
        size = {"width": self.config.sensor_width, "height": self.config.sensor_height}
        if not self.half_s:
            return (np.zeros((size["height"], size["width"])),) * 2
        x, y = dithered(np.asarray(self.seen.x, np.float64), np.asarray(self.seen.y, np.float64))
        dt = np.clip((2 * (self.events.t - self.events.t[0]) - self.result.span) / self.result.span, -1, 1)
        still = image_of_warped_events(x, y, dt, (0.0, 0.0), **size)
        return still, image_of_warped_events(x, y, dt, self.flow_at(x, y), **size)


def _between(at, places):
    """The last of ``places`` before, and how far it is to the next one, 0 … 1; outside the nearest place."""
    if len(places) == 1:
        return np.zeros(len(at), np.int64), np.zeros(len(at))
    index = np.clip(np.searchsorted(places, at) - 1, 0, len(places) - 2)
    return index, np.clip((at - places[index]) / (places[index + 1] - places[index]), 0, 1)
