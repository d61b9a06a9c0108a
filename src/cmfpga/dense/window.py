"""Windows of a recording, one after the other, and the flow that the hardware found in each."""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import ConfigError
from ..events import BatchCutter
from ..imaging.camera import nearest
from ..imaging.iwe import dithered, image_of_warped_events
from ..protocol.confidence import confidence, covariance, uncertainty
from ..protocol.flags import Flag
from ..tracking.columns import Column, declared
from ..tracking.fit import LOST_BATCHES, FittedCutter, fit
from ..tracking.loop import Measured, Table
from ..tracking.loop import windows as measured
from .neighbours import borne_out

#: The covariance of a tile is so many times that of an ROI that follows an object: edges cross its border all the time.
BORDER = 3.4

_MAY = {"text": "{:.3f}", "may_be_missing": True}

#: What ``flow.csv`` and ``flow.npz`` hold, of a :class:`Window`. Only what has a shape is in the arrays: of W windows,
#: n tiles, and the p parameters of a fit.
COLUMNS = declared(
    Column(name="window", dtype=int, doc="number of the window, from 0", value=lambda w: w.index),
    Column(name="t_ref_us", unit="µs", value=lambda w: w.t_ref, **_MAY | {"text": "{:.1f}"},
           doc="middle of the window's time range, on the recording's clock; empty without events"),
    Column(name="x", dtype=int, unit="px", shape="[n]", value=lambda w: np.array(w.tiles.corners)[:, 0],
           doc="left column of the tile; in the undistorted image, where there is a calibration"),
    Column(name="y", dtype=int, unit="px", shape="[n]", value=lambda w: np.array(w.tiles.corners)[:, 1],
           doc="top row of the tile"),
    Column(name="width", dtype=int, unit="px", doc="width of the tile", value=lambda w: w.tiles.width),
    Column(name="height", dtype=int, unit="px", doc="height of the tile", value=lambda w: w.tiles.height),
    Column(name="size", dtype=int, unit="px", text=None, shape="[2]", doc="width and height of the tiles",
           value=lambda w: (w.tiles.width, w.tiles.height)),
    Column(name="grid", dtype=int, text=None, shape="[2]", doc="rows and columns of the grid; tiles are row by row",
           value=lambda w: (len(w.tiles.rows), len(w.tiles.columns))),
    Column(name="t", dtype=int, unit="µs", text=None, shape="[W, 2]", doc="times of the window's first and last event",
           value=lambda w: [int(w.events.t[0]), int(w.events.t[-1])] if len(w.events) else [-1, -1]),
    Column(name="first_event", dtype=int, text=None, shape="[W]", value=lambda w: w.events.first_event,
           doc="number in the recording of the window's first event"),
    Column(name="window_events", dtype=int, text=None, shape="[W]", value=lambda w: len(w.events),
           doc="events of the window, of the whole sensor"),
    Column(name="events", dtype=int, shape="[W, n]", value=lambda w: w.counts,
           doc="events of the tile that the flow is found from; above `buffer_events` they are thinned evenly"),
    Column(name="vx_px_per_s", unit="px/s", value=lambda w: w.px_per_s[:, 0], **_MAY,
           doc="flow to the right; empty of a degenerate tile"),
    Column(name="vy_px_per_s", unit="px/s", value=lambda w: w.px_per_s[:, 1], **_MAY, doc="flow downwards"),
    *(Column(name=f"v{axis}_px_per_s_sd", unit="px/s", value=lambda w, k=k: np.sqrt(w.covariance[:, k]), **_MAY,
             doc="its standard deviation") for k, axis in enumerate("xy")),
    Column(name="v", unit="px/s", text=None, shape="[W, n, 2]", value=lambda w: w.px_per_s,
           doc="flow; NaN of degenerate tiles"),
    Column(name="confidence", unit="1/px²", shape="[W, n]", value=lambda w: w.kappa, **_MAY,
           doc="κ, how sharp the contrast's peak is; empty, or NaN, where it was not measured"),
    Column(name="covariance", unit="(px/s)²", text=None, shape="[W, n, 3]", value=lambda w: w.covariance,
           doc="of the flow: xx, yy, xy; in which direction an edge leaves v open; NaN of tiles in doubt"),
    Column(name="trusted", dtype=int, shape="[W, n]", value=lambda w: w.trusted, text=lambda yes: str(int(yes)),
           doc="1: neither degenerate nor doubtful nor short, and the tiles around agree"),
    Column(name="flags", dtype=int, shape="[W, n]", value=lambda w: w.flags, text=lambda bits: Flag(bits).text,
           doc="names of the flags that are set, joined by `|`, or their bits"),
    Column(name="centres", unit="px", text=None, shape="[W, n, 2]", value=lambda w: w.centres,
           doc="mean position of the events of the tile"),
    Column(name="fit", text=None, shape="[W, p]", doc="with a fit: its parameters, in the order of `fit.csv`"),
    Column(name="fit_errors", text=None, shape="[W, p]", doc="their standard deviations"),
)  # fmt: skip

#: Those of the CSV.
TABLE = {name: column for name, column in COLUMNS.items() if column.text}


@dataclass(frozen=True, eq=False)
class Window(Measured):
    """What was found in one window. ``n`` tiles are in the order of :attr:`Tiles.corners`."""

    tiles: Any
    cycles: int | None = None  # from the offer of its first event to the last result; None of engines without a clock

    def each(self, value, none=None, dtype=np.float64):
        """``value(outcome)`` of each tile as an array; ``none`` where it is None."""
        found = map(value, self.tiles.of(self.result))
        return np.array([none if one is None else one for one in found], dtype)

    @functools.cached_property
    def flags(self):
        """Bits of :class:`Flag` of each tile: int64 [n]."""
        return self.each(lambda one: int(one.flags), dtype=np.int64)

    @property
    def sure(self):
        """Which tiles are neither degenerate nor doubtful: bool [n]."""
        return (self.flags & (Flag.DEGENERATE | Flag.DOUBTFUL)) == 0

    @property
    def short(self):
        """Which tiles move so little that v is found too large: bool [n]."""
        return (self.flags & Flag.SHORT) > 0

    @functools.cached_property
    def trusted(self):
        """Which of the sure ones are not short either, and agree with the tiles around them: bool [n]."""
        return borne_out(self) & ~self.short

    @functools.cached_property
    def counts(self):
        """Events that the flow of each tile is found from: int64 [n]."""
        return self.each(lambda one: one.roi_events, dtype=np.int64)

    @functools.cached_property
    def v(self):
        """Flow of each tile, px per half window: float64 [n, 2]; NaN of degenerate ones."""
        return self.each(lambda one: None if Flag.DEGENERATE in one.flags else one.v, (np.nan, np.nan))

    @property
    def px_per_s(self):
        """The same in px/s."""
        return self.v / max(self.half_s, 1e-9)

    @functools.cached_property
    def kappa(self):
        """Confidence of each tile, 1/px²: float64 [n]; NaN where it was not measured."""
        return self.each(functools.partial(confidence, self.config), np.nan)

    @functools.cached_property
    def covariance(self):
        """Of each tile's flow, (px/s)²: xx, yy, xy, float64 [n, 3]; NaN of tiles in doubt."""
        return BORDER * self._px2_per_s2(covariance)

    @functools.cached_property
    def uncertainty(self):
        """The inverse of each tile's information, (px/s)²: which tile is the better one; as :attr:`covariance`."""
        return self._px2_per_s2(uncertainty)

    def _px2_per_s2(self, what):
        return self.each(functools.partial(what, self.config), (np.nan,) * 3) / max(self.half_s, 1e-9) ** 2

    @property
    def outside(self):
        """Events off the undistorted image; they are in no tile."""
        return int((~nearest(self.config, self.seen.x, self.seen.y)[2]).sum())

    @property
    def moved(self):
        """How far the image moves, px per half window: the median of the :attr:`sure` tiles.

        None where fewer than a quarter of the tiles that were measured are sure, or fewer than two: of one small
        object few tiles are measured at all.
        """
        sure = int(self.sure.sum())
        if sure < max(2, 0.25 * np.isfinite(self.v[:, 0]).sum()):
            return None
        return float(np.median(np.hypot(*self.v[self.sure].T)))

    @property
    def centres(self):
        """Mean position of the events of each tile, px: float64 [n, 2]; of an empty one its middle."""
        size, at = (self.config.sensor_height, self.config.sensor_width), self.seen
        column, row, inside = nearest(self.config, at.x, at.y)
        pixel = (row * size[1] + column)[inside]
        weights = (None, at.x[inside], at.y[inside])
        images = (np.bincount(pixel, weight, size[0] * size[1]).reshape(size) for weight in weights)
        count, *sums = self.tiles.sums(*images)
        middle = np.array(self.tiles.corners) + (np.array([self.tiles.width, self.tiles.height]) - 1) / 2
        return np.where(count[:, None] > 0.5, np.transpose(sums) / np.maximum(count, 1)[:, None], middle)

    def rows(self):
        """Text of the window's rows of ``flow.csv``."""
        values = ((column, np.asarray(column.value(self))) for column in TABLE.values())
        every = ((column, np.broadcast_to(value, len(self.tiles)).tolist()) for column, value in values)
        return zip(*([*map(column.shown, each)] for column, each in every), strict=True)

    def flow_at(self, x, y):
        """The flow between the middles of the tiles, px per half window: float64 [2, n].

        Tiles that are not :attr:`sure` have the mean of the nearest four that are, nearer ones counting more; without
        one there is no flow: 0.
        """
        field = np.where(self.sure[:, None], self.v, 0.0)
        known = np.flatnonzero(self.sure)
        if not len(known):
            return np.zeros((2, len(x)))
        corners = np.array(self.tiles.corners, np.float64)
        for k in np.flatnonzero(~self.sure):
            away = np.hypot(*(corners[known] - corners[k]).T)
            near = np.argsort(away, kind="stable")[:4]
            field[k] = np.average(self.v[known[near]], axis=0, weights=1 / away[near])
        field = field.reshape(len(self.tiles.rows), len(self.tiles.columns), 2)
        (i, u), (j, w) = (
            _between(np.asarray(at, np.float64), np.array(places) + (side - 1) / 2)
            for at, places, side in ((x, self.tiles.columns, self.tiles.width), (y, self.tiles.rows, self.tiles.height))
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


#: Events of the first window that is tried, where their number is to suit the motion, on a sensor of so many pixels;
#: on a larger one as many more. And of the shortest one.
FIRST_EVENTS, FIRST_PIXELS, FEWEST_EVENTS = 4000, 240 * 180, 1000


class FieldCutter(FittedCutter):
    """Cuts windows in half of which the image moves by 3 to 5 px, in the median of the trusted tiles."""

    def __init__(self, source, config, start_event):
        super().__init__(source, config, start_event=start_event, max_events=config.slice_events)
        self.limited = False  # some window would have been longer, had the hardware room for its events
        self._doubtful = LOST_BATCHES

    def survey(self, trial, *_):
        """Choose the first length, or the next one of a motion that is lost.

        Windows on trial grow until the image moves far enough: ``trial(events)`` says how far, in px, or None. Where
        none of them says it, they were too long, as for something small that leaves its tiles: shorter ones follow.
        """
        if not self._doubtful or self._doubtful % LOST_BATCHES:
            return
        share = max(1, self._config.sensor_width * self._config.sensor_height // FIRST_PIXELS)
        count, shorter = min(FIRST_EVENTS * share, self.max_events), None
        while True:
            ahead = yield from self.ahead(count)
            shorter = shorter or len(ahead) // 2
            moved = trial(ahead)
            wanted = 2 * count if moved is None else fit(count, moved, True)
            if len(ahead) < count or count == self.max_events or (moved is not None and wanted <= count):
                break
            count = min(wanted, self.max_events)
        size = max(1, min(wanted, len(ahead)))
        while moved is None and shorter >= FEWEST_EVENTS:
            moved = trial((yield from self.ahead(shorter)))
            size = size if moved is None else fit(shorter, moved, True)
            shorter //= 2
        self.limited |= size == self.max_events < wanted
        self.size = size

    def add(self, window):
        """Take a :class:`~.window.Window`, and choose the length of the next ones."""
        self._doubtful = 0 if window.moved is not None else self._doubtful + 1
        wanted = fit(len(window.events), window.moved or 0.0, window.moved is not None)
        self.limited |= wanted > self.max_events
        self.size = min(wanted, self.max_events)


class Run(Table):
    """Measures the windows of a source; with ``slices`` a new one ends with every slice, and has the last so many.

    No stream: the events of the first windows are looked at before they are cut. Without ``window_events`` or
    ``window_us`` a window has as many events as suit the motion, as far as ``max_batch_events`` allows; not with
    slices. ``windows``: stop after these.
    """

    def __init__(self, source, engine, tiles, *, window_events=None, window_us=None, start_event=0, windows=None):
        super().__init__(engine)
        config = self.config
        self._source, self._tiles, self._count = source, tiles, windows
        mode, size, unit = ("duration_us", window_us, "µs") if window_us else ("events", window_events or 0, "events")
        if mode == "events" and size > (most := config.slice_events * config.slices):
            raise ConfigError(f"windows of {size} events: at most {most} are allowed (max_batch_events)")
        if config.slices > 1 and (not size or size % config.slices):
            wanted = f"a multiple of {config.slices} {unit}" if size else "a length (window_events, window_us)"
            raise ConfigError(f"windows of {config.slices} slices: {wanted} is needed")
        if size:
            size = {mode: size // config.slices}
            self.cutter = BatchCutter(source, start_event=start_event, max_events=config.slice_events, **size)
        else:
            self.cutter = FieldCutter(source, config, start_event)
        engine.write(tiles.regions)

    @property
    def leftover(self):
        """Events after the last window, as far as their number can be known without reading them all."""
        extent = None if self.cutter.leftover else self._source.extent()
        return extent[0] - self.cutter.position if extent else self.cutter.leftover

    @property
    def limited(self):
        """Whether some window would have been longer, had the hardware room for its events."""
        return isinstance(self.cutter, FieldCutter) and self.cutter.limited

    def __iter__(self):
        return measured(self.engine, self.cutter, self, self._count)

    def trial(self, events, settings):
        return self.window(0, events, self.measure(events, settings)).moved

    def window(self, index, events, result):
        return Window(index, self.config, events, result, self._tiles, self.engine.cycles)
