"""The measuring loop: windows cut, run, and the next length chosen; of one object, of several, or of a field of flow.

It is the only one: the commands, the Python API, a sweep and the driver of a board run it, with whatever engine they
have. What is kept of the windows is up to the consumers that the caller chooses.
"""

import collections
import functools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..events import WAITING, Events
from ..events.batches import PIECE_EVENTS, Batch
from ..imaging.camera import rates, seen
from ..imaging.iwe import contrast, events_in_roi
from ..protocol.confidence import confidence, covariance, deviations, is_sure, is_trustworthy
from ..protocol.flags import Flag
from ..protocol.regions import Region
from ..protocol.results import BatchResult
from ..protocol.settings import BatchSettings
from ..reference.integer.filters import NoiseFilter
from .ambiguity import UNTRUSTED, Ambiguity, ambiguity
from .columns import columns, csv_writer, row
from .course import Course
from .fit import FittedCutter
from .sliding import FittedWindows, Newest, Overlapping, window_lengths, with_those_of


def windows(engine, cutter, table, batches=None):
    """Measure window after window; yields what ``table`` makes of each, or None where the source has no events yet.

    Parameters
    ----------
    engine : Engine
        Its configuration gives the run-time settings. With ``slices`` a window has the last so many that have events.
    cutter : BatchCutter
        Cuts the events; a :class:`~cmfpga.tracking.fit.FittedCutter` learns from each window how long the next one is.
    table : Table
        What is looked for: ``window(index, events, measured)`` makes what is yielded, and ``trial(events, settings)``
        measures events that come again, for the cutter's survey.
    batches : int, optional
        Stop after these; by default at the end of the events.
    """
    config, fitted, length, index = engine.config, isinstance(cutter, FittedCutter), None, 0
    size, recent = (config.roi_width, config.roi_height), collections.deque(maxlen=config.slices)
    usual = BatchSettings.from_config(config)
    cold = replace(usual, start_last=False)
    while batches is None or index < batches:
        rois = [(*place, *size) for place in table.places]
        if config.slides:
            yield from table.slide(cutter, rois, batches)
            return
        if fitted:
            yield from cutter.survey(lambda events: table.trial(events, cold), *rois)
        while (part := cutter.next(rois[0])) is WAITING:
            yield None
        if part is None:
            return
        if not len(part) and config.slices > 1:
            table.passed_over += 1  # nothing to send: the hardware's windows know nothing of it
            continue
        # v is per half batch: that of a batch of another length is no start.
        result = table.measure(part, cold if fitted and len(part) != length else usual)
        length = len(part)
        recent.append(part)
        if len(recent) < config.slices:
            continue
        if len(recent) > 1:
            every = Events.concatenate(recent)
            part = Batch(every.t, every.x, every.y, every.p, recent[0].first_event)
        window = table.window(index, part, result)
        if fitted:
            cutter.add(window)
        yield window
        index += 1


class Table:
    """Rows of an engine's table, and what is made of their results."""

    places = ((0, 0),)  #: left column and top row, px, of each ROI that lengths are chosen for
    passed_over = 0  #: slices without events

    def __init__(self, engine):
        self.engine, self.config = engine, engine.config

    def measure(self, events, settings):
        """Run events: what :meth:`window` needs of the result."""
        (result,) = self.engine.run(events, settings)
        return result


@dataclass(frozen=True, eq=False)
class Measured:
    """A window of events, numbered from 0, and what the engine found in it."""

    index: int
    config: Any
    events: Events
    result: BatchResult

    @property
    def half_s(self):
        """Half of the window's time range, s."""
        return self.result.span / 2e6

    @property
    def t_ref(self):
        """Middle of the window's time range (Eq. t_ref), µs; None without events."""
        return float(self.events.t[0]) + self.result.span / 2 if len(self.events) else None

    @property
    def t_us(self):
        """Time of the window's last event, µs; None without events."""
        return int(self.events.t[-1]) if len(self.events) else None

    @functools.cached_property
    def seen(self):
        """The events where ROI and v have them: in the undistorted image, where there is a camera."""
        return seen(self.config, self.events)


@dataclass(frozen=True, eq=False)
class TrackedBatch(Measured):
    """One batch of a track. Whatever it tells is in the sensor's pixels; ``result`` is in the image's, as the engine's.

    ``marks`` are two bool arrays: which events were dropped as hot and as noise; None where there are no such filters.
    """

    plan: tuple = ()  # a ScheduleEntry or a Round per iteration, None for a constant η
    thinning: int = 1  # the engine stored one ROI event in so many
    marks: tuple | None = None
    start: tuple | None = None  # where the next batch is cropped, px, if not where the engine moved the ROI
    borne_out: bool = True  # as :class:`~cmfpga.tracking.sliding.Overlapping` says of windows that overlap

    @property
    def flags(self):
        """The engine's, and ``CUT`` where the batch reached ``max_batch_events`` before it was complete."""
        return self.result.flags | (Flag.CUT if self.events.cut_short else Flag(0))

    @property
    def which(self):
        """Which ROI events an image shows, as :func:`~cmfpga.imaging.iwe.scaled_roi_events` takes it."""
        dropped = None if self.marks is None else self.marks[0] | self.marks[1]
        return {"thinned": bool(self.result.thinned), "dropped": dropped}

    @property
    def roi(self):
        """Left column and top row of the ROI."""
        return self._on_the_sensor(self.result.roi)

    @property
    def roi_next(self):
        """Where the next batch is cropped."""
        return self._on_the_sensor(self.start or self.result.roi_next)

    def _on_the_sensor(self, place):
        return tuple(at << self.config.binning for at in place)

    @property
    def v(self):
        """The motion's parameters, px per half batch; a zoom or roll at the same lever arm is as large in any px."""
        vx, vy, *more = self.result.v
        return vx * self.config.pixel, vy * self.config.pixel, *more

    @functools.cached_property
    def contrast(self):
        """Of the image of warped events at the found v, computed in float64 for every engine."""
        return contrast(self.config, self.seen, self.result.roi, self.result.v, **self.which)

    @property
    def confidence(self):
        """κ of :func:`cmfpga.protocol.confidence.confidence`, or None."""
        found = confidence(self.config, self.result)
        return found and found / self.config.pixel**2

    @property
    def covariance(self):
        """That of v, px²: (xx, yy, xy), as :func:`cmfpga.protocol.confidence.covariance` gives it, or None."""
        found = covariance(self.config, self.result)
        return found and tuple(one * self.config.pixel**2 for one in found)

    @functools.cached_property
    def ambiguity(self):
        """What the events leave open, an :class:`~cmfpga.tracking.ambiguity.Ambiguity`."""
        alone = Ambiguity.ALONE if is_sure(self.result) and not self.borne_out else Ambiguity(0)
        return alone | ambiguity(self.config, self.seen, self.result, **self.which)

    @property
    def trusted(self):
        """Whether v is to be trusted; False where that was not measured."""
        return is_trustworthy(self.config, self.result) and not self.ambiguity & UNTRUSTED

    @functools.cached_property
    def deviations(self):
        """Standard deviations in physical units, ``{name: value}``; empty where v is not sure."""
        if (found := deviations(self.config, self.result)) is None:
            return {}
        pixel = self.config.pixel
        told = {f"v{axis}_px_per_s": sd * pixel / self.half_s for axis, sd in zip("xy", found, strict=False)}
        return told | {name: abs(one) for name, one in rates(self.config, found, self.result.span).items()}

    @property
    def rates(self):
        """The motion in physical units, as :func:`cmfpga.imaging.camera.rates` gives it."""
        return rates(self.config, self.result.v, 0 if Flag.DEGENERATE in self.result.flags else self.result.span)

    @property
    def v_px_per_s(self):
        """(vx, vy) in px/s; None for a degenerate batch, which measures nothing."""
        if Flag.DEGENERATE in self.flags:
            return None
        return self.v[0] / self.half_s, self.v[1] / self.half_s

    def true_px_per_s(self, motion):
        """The true mean (vx, vy) of the batch in px/s; None without a ``motion`` or events."""
        if motion is None or not len(self.events):
            return None
        return tuple(motion.mean_velocity(int(self.events.t[0]), int(self.events.t[-1])).tolist())

    @functools.cached_property
    def values(self):
        """``{name: value}`` of the :func:`~cmfpga.tracking.columns.columns`; None where there is no value."""
        return {name: column.value(self) for name, column in columns(self.config.motion, self.config.slides).items()}

    def row(self):
        """The same as text, as in ``track.csv``."""
        return row(self.values)


class CsvConsumer:
    """A consumer that writes ``track.csv`` as the batches of a configuration come."""

    def __init__(self, file, config):
        self._write = csv_writer(file, columns(config.motion, config.slides), config.image)

    def add(self, batch):
        """Write a batch's line."""
        self._write(batch.row())


def track(engine, cutter, *, roi, batches=None, consumers=(), every=1):
    """:func:`follow` one object, whose ROI begins at ``roi``, for ``consumers``: yields each batch, or None."""
    for window in follow(engine, cutter, rois=[roi], batches=batches, consumers=[consumers], every=every):
        yield window and window[0]


def follow(engine, cutter, *, rois, batches=None, consumers=(), every=1):
    """Follow objects. After a doubtful batch an object's next one starts cold, where :class:`Course` has its ROI.

    Yields a list of each object's :class:`TrackedBatch` of the same events; None where the source has no events yet.

    Parameters
    ----------
    engine, cutter, batches
        As of :func:`windows`; each object is a row of the engine's table.
    rois : sequence of pair of int
        Of each object the left column and top row of its first ROI, px of the sensor.
    consumers : sequence of sequences
        Of each object: the method ``add`` of each takes every :class:`TrackedBatch`, before it is yielded.
    every : int
        Where windows slide: the first of so many is kept, and counts.
    """
    for window in windows(engine, cutter, _Objects(engine, rois, every), batches):
        for batch, takers in zip(window or (), consumers, strict=bool(window)):
            for consumer in takers:
                consumer.add(batch)
        yield window


class _Objects(Table):
    """Rows that each follow an object; or the newest events of one, evaluated again and again."""

    def __init__(self, engine, rois, every):
        super().__init__(engine)
        self._every = every
        self._courses = [Course(self.config, tuple(at >> self.config.binning for at in roi)) for roi in rois]
        self._usual = BatchSettings.from_config(self.config)
        self._noise = NoiseFilter(self.config) if self.config.hot_pixels or self.config.background else None

    @property
    def places(self):
        return [course.start or self.engine.places[k] for k, course in enumerate(self._courses)]

    def measure(self, events, settings):
        """``(result, plan, thinning)`` of each object; what was dropped is kept."""
        # A core takes start_last, and keeps where its ROI is between pixels; a table has rows that begin anew.
        restarted = self.config.regions and settings != self._usual
        anew = {k for k, course in enumerate(self._courses) if course.start or restarted}
        for k in anew:
            self._courses[k].begin(events, self.places[k])
        self.engine.write([course.row for course in self._courses], anew)
        self._marks = self._noise.judge(events.t, events.x, events.y, settings) if self._noise else None
        return [
            (result, *course.replay.settings_of(result, replace(settings, roi=course.start)))
            for course, result in zip(self._courses, super().measure(events, settings).split(), strict=True)
        ]

    def trial(self, events, settings):
        if self.config.slides:
            (course,) = self._courses
            self.engine.write([Region.roi(self.config, course.start)], {0})
            near, most = self._near(events, course.start), self.config.max_batch_events
            return self.engine.trial(near[:: max(1, -(-len(near) // most))], settings)
        return [result for result, *_ in self.measure(events, settings)]

    def _near(self, events, place):
        """What a window's v depends on: the ROI's events, those whose filters see them, and both ends in time."""
        beside = 2 << self.config.background_cell  # px: wider than a cell of the noise filter
        left, top = (at - beside for at in place)
        size = self.config.roi_width + 2 * beside, self.config.roi_height + 2 * beside
        kept = np.zeros(len(events), bool)
        kept[events_in_roi(seen(self.config, events), (left, top), *size)[0]] = kept[:1] = kept[-1:] = True
        return events[kept]

    def slide(self, cutter, rois, most):
        """What :func:`windows` yields where windows slide: :class:`TrackedBatch`, one of each hop.

        Hops before the first full window are passed over.
        """
        (course,), index, hop = self._courses, 0, -1
        lengths, way = yield from window_lengths(self.config, cutter, lambda events: self.trial(events, None), rois[0])
        given, pieces, sent = replace(self._usual, **lengths), cutter.piece, 0
        fitted = FittedWindows(self.config, given, way)
        self.engine.write([Region.roi(self.config, course.start)], {0})
        newest, passed, overlapping = Newest(self.config, cutter.position), None, Overlapping()
        try:
            while most is None or index < most:
                if (piece := pieces()) is WAITING:
                    yield None
                    continue
                if piece is None:
                    return
                newest.add(piece, self._noise and self._noise.judge(piece.t, piece.x, piece.y, given))
                sent += len(piece)
                for result in self.engine.run(piece, given):
                    fitted.add(result)
                    events, marks = newest.window(result)
                    degenerate = Flag.DEGENERATE in result.flags
                    hop += not degenerate or hop >= 0
                    borne_out = hop < 0 or overlapping.bear_out(events, is_sure(result))
                    self.passed_over += hop < 0
                    plan = given.cold if not self._warm else given.follow or given.warm
                    self._warm = not degenerate
                    result = passed = with_those_of(passed, result)
                    if hop < 0 or hop % self._every:
                        continue
                    how = {"plan": plan[: result.iterations], "borne_out": borne_out}
                    how |= {"marks": marks if self._noise else None}
                    passed = None
                    yield [TrackedBatch(index, self.config, events, result, **how)]
                    index += 1
                    if index == most:
                        break
                if not sent % PIECE_EVENTS:  # so that it does not depend on how a stream comes
                    given = fitted.fit()
        finally:
            cutter.give_back(newest.left)

    _warm = False  # the hop before gave the v from which this one starts

    def window(self, index, events, measured):
        made = []
        for course, (result, plan, thinning) in zip(self._courses, measured, strict=True):
            how = {"plan": plan, "thinning": thinning * course.row.stride, "marks": self._marks}
            made.append(TrackedBatch(index, self.config, events, result, start=course.go_on(result), **how))
        return made
