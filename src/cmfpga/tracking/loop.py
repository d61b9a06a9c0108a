"""The track loop: batches in order, each cropped where the one before it left the ROI; of one object, or of several.

It is the only one: the command, the Python API, a sweep and the driver of a board run it, with whatever engine they
have. What is kept of the batches is up to the consumers that the caller chooses.
"""

import functools
import itertools
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from ..events import WAITING, Events
from ..imaging.camera import rates, seen
from ..imaging.iwe import contrast, events_in_roi
from ..protocol.confidence import confidence, covariance, is_sure
from ..protocol.flags import Flag
from ..protocol.regions import MOST_STRIDE, Region
from ..protocol.results import BatchResult, thins
from ..protocol.settings import BatchSettings, clamp_roi
from ..reference.integer.noise_filter import NoiseFilter
from .columns import columns, csv_writer, row
from .fit import LOST_BATCHES, FittedCutter
from .replay import Replay

_RESERVE = 1.3  # of events that a stride leaves room for: the rate is not the same in all batches


@dataclass(frozen=True)
class TrackedBatch:
    """One batch of a track.

    Parameters
    ----------
    index : int
        From 0.
    events : Events
        All events of the batch.
    result : BatchResult
        What the engine returned.
    t_ref : float or None
        Reference time in µs (Eq. t_ref); None for a batch without events.
    contrast : float
        Of the image of warped events at the found v, computed in float64 for every engine.
    confidence : float or None
        κ of :func:`cmfpga.protocol.confidence.confidence`.
    covariance : tuple or None
        Of v, px²: (xx, yy, xy), as :func:`cmfpga.protocol.confidence.covariance` gives it.
    flags : Flag
        The engine's, and ``CUT`` where the batch reached ``max_batch_events`` before it was complete.
    plan : tuple
        A ``ScheduleEntry`` per iteration, None for a constant η.
    thinning : int
        The engine stored one ROI event in so many.
    marks : pair of bool arrays, or None
        Which events were dropped as hot and as noise; None where there are no such filters.
    roi_next : pair of int or None
        Where the next batch is cropped, if not where the engine moved the ROI.
    undistorted : cmfpga.imaging.camera.undistortion.Seen or None
        The events in the undistorted image, where there is a camera.
    rates : dict
        The motion in physical units, as :func:`cmfpga.imaging.camera.rates` gives it.
    motion : str
        As of ``Config``.
    """

    index: int
    events: Events
    result: BatchResult
    t_ref: float | None
    contrast: float
    flags: Flag
    confidence: float | None = None
    covariance: tuple | None = None
    plan: tuple = ()
    thinning: int = 1
    marks: tuple | None = None
    roi_next: tuple | None = None
    undistorted: Any = None
    rates: dict = field(default_factory=dict)
    motion: str = "translation"

    @property
    def seen(self):
        """The events where ROI and v have them."""
        return self.events if self.undistorted is None else self.undistorted

    @property
    def which(self):
        """Which ROI events an image shows, as :func:`~cmfpga.imaging.iwe.scaled_roi_events` takes it."""
        return _which(self.result, self.marks)

    @property
    def v_px_per_s(self):
        """(vx, vy) in px/s; None for a degenerate batch, which measures nothing."""
        if Flag.DEGENERATE in self.flags:
            return None
        half_range = self.result.span / 2e6
        return self.result.v[0] / half_range, self.result.v[1] / half_range

    def true_px_per_s(self, motion):
        """The true mean (vx, vy) of the batch in px/s; None without a ``motion`` or events."""
        if motion is None or not len(self.events):
            return None
        return tuple(motion.mean_velocity(int(self.events.t[0]), int(self.events.t[-1])).tolist())

    @functools.cached_property
    def values(self):
        """``{name: value}`` of the :func:`~cmfpga.tracking.columns.columns`; None where there is no value."""
        return {name: column.of(self) for name, column in columns(self.motion).items()}

    def row(self):
        """The same as text, as in ``track.csv``."""
        return row(self.values)


class Consumer(Protocol):
    """Takes the batches of one track, in order."""

    def add(self, batch: TrackedBatch):
        """Take the next one."""


class CsvConsumer:
    """Writes ``track.csv`` into an open file as the batches come; ``how`` as of :func:`~.columns.csv_writer`."""

    def __init__(self, file, *how):
        self._write = csv_writer(file, *how)

    def add(self, batch):
        """Write a batch's line."""
        self._write(batch.values)


def track(engine, cutter, *, roi, batches=None, consumers=()):
    """:func:`follow` one object with the core of one ROI.

    Parameters
    ----------
    engine : Engine
    cutter, batches
        As of :func:`follow`.
    roi : pair of int
        Left column and top row of the first batch's ROI, px.
    consumers : sequence of Consumer
        Each takes every batch, before it is yielded.

    Yields
    ------
    TrackedBatch or None
        None where the source has no events yet.
    """
    for window in follow(engine, cutter, rois=[roi], batches=batches, consumers=[consumers]):
        yield window and window[0]


def follow(engine, cutter, *, rois, batches=None, consumers=()):
    """Follow objects. After a doubtful batch an object's next one starts cold, where :class:`_Course` has its ROI.

    Parameters
    ----------
    engine : Engine
        Runs the batches, each object a row of its table; its configuration gives the run-time settings.
    cutter : BatchCutter
        Cuts the events; a :class:`~cmfpga.tracking.fit.FittedCutter` learns from each batch how long the next one is.
    rois : sequence of pair of int
        Of each object the left column and top row of its first ROI, px.
    batches : int, optional
        Stop after these; by default at the end of the events.
    consumers : sequence of sequences of Consumer
        Of each object: each takes every batch, before it is yielded.

    Yields
    ------
    list of TrackedBatch, or None
        Of the same events, each object's; None where the source has no events yet.
    """
    config, courses = engine.config, [_Course(engine.config, roi) for roi in rois]
    size, usual = (config.roi_width, config.roi_height), BatchSettings.from_config(config)
    noise, filters = NoiseFilter(config), config.hot_pixels or config.background
    fitted, length = isinstance(cutter, FittedCutter), None

    def run(events, cold):
        settings = replace(usual, start_last=False) if cold else usual
        # A core takes start_last, and keeps where its ROI is between pixels; a table has rows that begin anew.
        restarted = config.regions and settings != usual
        anew = {k for k, course in enumerate(courses) if course.start or restarted}
        for k in anew:
            courses[k].begin(events, courses[k].start or engine.places[k])
        engine.write([course.row for course in courses], anew)
        marks = noise.judge(events.t, events.x, events.y, settings) if filters else None
        (together,) = engine.run(events, settings)
        results = together.split()
        asked = zip(courses, results, strict=True)
        plans = [one.replay.settings_of(result, replace(settings, roi=one.start)) for one, result in asked]
        return results, marks, plans

    if fitted:
        yield from cutter.survey(lambda events: run(events, True)[0], *((*roi, *size) for roi in rois))
    for index in itertools.count() if batches is None else range(batches):
        while (events := cutter.next((*(courses[0].start or engine.places[0]), *size))) is WAITING:
            yield None
        if events is None:
            return
        # v is per half batch: that of a batch of another length is no start.
        results, marks, plans = run(events, fitted and len(events) != length)
        length, placed, window = len(events), seen(config, events), []
        for course, result, (plan, thinning) in zip(courses, results, plans, strict=True):
            start = course.go_on(result)
            batch = TrackedBatch(
                index,
                events,
                result,
                t_ref=float(events.t[0]) + result.span / 2 if len(events) else None,
                contrast=contrast(config, placed, result.roi, result.v, **_which(result, marks)),
                flags=result.flags | (Flag.CUT if events.cut_short else Flag(0)),
                confidence=confidence(config, result),
                covariance=covariance(config, result),
                plan=plan,
                thinning=thinning * course.row.stride,
                marks=marks,
                roi_next=start or result.roi_next,
                undistorted=placed if config.lens else None,
                rates=rates(config, result.v, 0 if Flag.DEGENERATE in result.flags else result.span),
                motion=config.motion,
            )
            window.append(batch)
        if fitted:
            cutter.add(*window)
        for batch, takers in zip(window, consumers, strict=True):
            for consumer in takers:
                consumer.add(batch)
        yield window


def _which(result, marks):
    return {"thinned": bool(result.thinned), "dropped": None if marks is None else marks[0] | marks[1]}


class _Course:
    """One object: where its ROI goes after a doubtful batch.

    On at the last trusted velocity; nowhere once the object is lost. With ``cold_after_doubtful=0`` a doubtful batch is
    like any other.

    Attributes
    ----------
    start : pair of int or None
        Left column and top row of the next batch's ROI, px; None where the engine moves it.
    row : Region
        Its row of the engine's table.
    replay : Replay
    """

    def __init__(self, config, roi):
        self._config, self.start, self.row, self.replay = config, roi, None, Replay(config)
        self._doubtful, self._speed = 0, (0.0, 0.0)  # batches not trusted in a row; px per half µs

    def begin(self, events, place):
        """A new row at a place; of the events in it every so many are stored, so that the buffer holds them."""
        config, stride = self._config, 1
        if config.regions and not thins(config):
            inside, _, _ = events_in_roi(seen(config, events), place, config.roi_width, config.roi_height)
            while len(inside) * _RESERVE > stride * config.buffer_events and stride < 1 << MOST_STRIDE:
                stride *= 2
        self.row = Region.roi(config, place, stride)

    def go_on(self, result):
        """Choose ``start`` by the last batch's result, and return it."""
        self.start = None
        if Flag.DEGENERATE in result.flags:  # not to be trusted either, but nothing moves
            self._doubtful += 1
            return None
        if Flag.DOUBTFUL not in result.flags or not self._config.cold_after_doubtful:
            self._doubtful = 0
            if is_sure(result):
                moved = zip(self._config.motion_model.parameters[:2], result.v, strict=False)
                self._speed = tuple(axis / result.span if one.moves_roi else 0.0 for one, axis in moved)
            return None
        self._doubtful += 1
        share = self._config.roi_gain * result.span * (self._doubtful < LOST_BATCHES)
        ahead = (round(at + share * axis) for at, axis in zip(result.roi, self._speed, strict=True))
        self.start = clamp_roi(self._config, tuple(ahead))[0]
        return self.start
