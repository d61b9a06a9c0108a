"""Tracking: batches in order, each cut with the ROI that the one before it left. The same for every engine."""

from dataclasses import dataclass

from ..events import Events
from ..imaging.iwe import contrast
from ..protocol.flags import Flag
from ..protocol.results import BatchResult
from ..protocol.settings import BatchSettings

COLUMNS = (
    "batch",
    "t_ref_us",
    "events",
    "roi_events",
    "roi_x",
    "roi_y",
    "vx",
    "vy",
    "vx_px_per_s",
    "vy_px_per_s",
    "iterations",
    "cycles",
    "contrast",
    "flags",
)


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
    flags : Flag
        The engine's, and ``CUT`` where the batch reached ``max_batch_events`` before it was complete.
    """

    index: int
    events: Events
    result: BatchResult
    t_ref: float | None
    contrast: float
    flags: Flag

    @property
    def v_px_per_s(self):
        """(vx, vy) in px/s; None for a degenerate batch, which measures nothing."""
        if Flag.DEGENERATE in self.flags:
            return None
        half_range = self.result.span / 2e6
        return self.result.v[0] / half_range, self.result.v[1] / half_range

    def row(self):
        """Text of the :data:`COLUMNS`; empty where there is no value. Equal results give equal text."""
        result = self.result
        speed = self.v_px_per_s
        return (
            str(self.index),
            "" if self.t_ref is None else f"{self.t_ref:.1f}",
            str(result.events),
            str(result.roi_events),
            str(result.roi[0]),
            str(result.roi[1]),
            repr(result.v[0]),
            repr(result.v[1]),
            *(("", "") if speed is None else (f"{axis:.3f}" for axis in speed)),
            str(result.iterations),
            "" if result.cycles is None else str(result.cycles),
            f"{self.contrast:.6f}",
            self.flags.text,
        )


def track(engine, cutter, *, roi, batches=None):
    """Follow one object.

    Parameters
    ----------
    engine : Engine
        Runs the batches; its configuration gives the run-time settings.
    cutter : BatchCutter
        Cuts the recording.
    roi : pair of int
        Left column and top row of the first batch's ROI, px.
    batches : int, optional
        Stop after these; by default at the end of the recording.

    Yields
    ------
    TrackedBatch
    """
    config = engine.config
    start = roi
    index = 0
    while batches is None or index < batches:
        at = engine.roi if index else roi
        batch = cutter.next((*at, config.roi_width, config.roi_height))
        if batch is None:
            return
        result = engine.run(batch, BatchSettings.from_config(config, start))
        start = None
        yield TrackedBatch(
            index,
            batch,
            result,
            t_ref=float(batch.t[0]) + result.span / 2 if len(batch) else None,
            contrast=contrast(config, batch, result.roi, result.v, thinned=bool(result.thinned)),
            flags=result.flags | (Flag.CUT if batch.cut_short else Flag(0)),
        )
        index += 1
