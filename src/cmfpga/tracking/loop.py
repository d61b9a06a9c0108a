"""The track loop: batches in order, each cut with the ROI that the one before it left.

It is the only one: the command, the Python API, a sweep and the driver of a board run it, with whatever engine they
have. What is kept of the batches is up to the consumers that the caller chooses.
"""

import functools
import itertools
from dataclasses import dataclass
from typing import Protocol

from ..events import WAITING, Events
from ..imaging.iwe import contrast
from ..protocol.confidence import confidence, covariance
from ..protocol.flags import Flag
from ..protocol.results import BatchResult
from ..protocol.settings import BatchSettings
from .columns import COLUMNS, csv_writer, row
from .replay import Replay


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
        """``{name: value}`` of the :data:`~cmfpga.tracking.columns.COLUMNS`; None where there is no value."""
        return {name: column.of(self) for name, column in COLUMNS.items()}

    def row(self):
        """The same as text, as in ``track.csv``."""
        return row(self.values)


class Consumer(Protocol):
    """Takes the batches of one track, in order."""

    def add(self, batch: TrackedBatch):
        """Take the next one."""


class CsvConsumer:
    """Writes ``track.csv`` into an open file as the batches come."""

    def __init__(self, file):
        self._writer = csv_writer(file)

    def add(self, batch):
        """Write a batch's line."""
        self._writer.writerow(batch.row())


def track(engine, cutter, *, roi, batches=None, consumers=()):
    """Follow one object.

    Parameters
    ----------
    engine : Engine
        Runs the batches; its configuration gives the run-time settings.
    cutter : BatchCutter
        Cuts the events.
    roi : pair of int
        Left column and top row of the first batch's ROI, px.
    batches : int, optional
        Stop after these; by default at the end of the events.
    consumers : sequence of Consumer
        Each takes every batch, before it is yielded.

    Yields
    ------
    TrackedBatch or None
        None where the source has no events yet.
    """
    config, replay = engine.config, Replay(engine.config)
    start = roi
    for index in itertools.count() if batches is None else range(batches):
        at = engine.roi if index else roi
        while (events := cutter.next((*at, config.roi_width, config.roi_height))) is WAITING:
            yield None
        if events is None:
            return
        result = engine.run(events, BatchSettings.from_config(config, start))
        start = None
        plan, thinning = replay.settings_of(result)
        batch = TrackedBatch(
            index,
            events,
            result,
            t_ref=float(events.t[0]) + result.span / 2 if len(events) else None,
            contrast=contrast(config, events, result.roi, result.v, thinned=bool(result.thinned)),
            flags=result.flags | (Flag.CUT if events.cut_short else Flag(0)),
            confidence=confidence(config, result),
            covariance=covariance(config, result),
            plan=plan,
            thinning=thinning,
        )
        for consumer in consumers:
            consumer.add(batch)
        yield batch


def in_turn(tracks):
    """Yields one batch of each track after the other, until the last track ends."""
    running = [*tracks]
    while running:
        for one in [*running]:
            batch = next(one, None)
            if batch is None:
                running.remove(one)
            else:
                yield batch
