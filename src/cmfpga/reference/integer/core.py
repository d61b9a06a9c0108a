"""Model of :mod:`cmfpga.rtl.core`: batches in, velocities and a moving ROI out."""

from dataclasses import dataclass, field

import numpy as np
import torch

from ...batch import BatchResult, Flag, Trace, clamp_roi, crop_position
from .accumulator import Images, accumulator
from .dither import dither
from .gradient import Sums, gradient, gradient_reader
from .roi_filter import roi_filter
from .roi_updater import roi_updater
from .time_scaler import time_scaler
from .updater import gain, sign_updater, updater
from .voter import voter
from .warp import warp


@dataclass(frozen=True)
class IntegerIteration:
    """Every intermediate of one iteration, raw integers."""

    v: tuple[int, int]
    images: Images
    sums: Sums
    g: tuple[int, int]
    v_next: tuple[int, int]


@dataclass
class IntegerCore:
    """The core's state between batches, and how a batch changes it.

    Parameters
    ----------
    config : Config
        Formats and sizes.

    Attributes
    ----------
    v : pair of int
        Raw velocity of the last batch; zero after a reset.
    tracking : bool
        Whether ``v`` is that of an object that is being followed: the sign ascent's warm schedule applies. A new ROI,
        a degenerate batch or a reset ends it.
    position : pair of int
        Raw ROI position, ``config.roi_x_format`` and ``config.roi_y_format``; the origin after a reset.
    dt : int64 tensor
        Scaled times of the last batch's ROI events.
    iterations : list of IntegerIteration
        Intermediates of the last batch, where ``run`` was asked to keep them.
    """

    config: object
    v: tuple[int, int] = (0, 0)
    tracking: bool = False
    position: tuple[int, int] = (0, 0)
    dt: torch.Tensor = field(default=None, repr=False)
    iterations: list = field(default_factory=list, repr=False)

    def run(self, t, x, y, settings, *, cut=False, keep=False):
        """Process one batch.

        Parameters
        ----------
        t, x, y : integer arrays
            All N events of the batch.
        settings : BatchSettings
            Run-time inputs.
        cut : bool
            Whether the batch ended because it reached ``max_batch_events``.
        keep : bool
            Keep every iteration's images in ``iterations`` (memory: T images).

        Returns
        -------
        BatchResult
        """
        config = self.config
        flags = Flag.CUT if cut else Flag(0)
        if settings.roi is not None:
            roi, clamped = clamp_roi(config, settings.roi)
            self.position = tuple(c << config.roi_x_format.f for c in roi)
            self.tracking = False
            flags |= Flag.ROI_CLAMPED if clamped else Flag(0)
        roi = tuple(crop_position(config, p) for p in self.position)

        events = roi_filter(config, t, x, y, roi=roi)
        n = min(len(events.t), config.buffer_events)
        overflow = len(events.t) - n
        for count, flag in (
            (overflow, Flag.OVERFLOW),
            (events.time_back, Flag.TIME_BACK),
            (events.time_span, Flag.TIME_SPAN),
        ):
            flags |= flag if count else Flag(0)

        warm = settings.start_last and (self.tracking or config.ascent == "constant")
        plan = self._plan(settings, warm)
        self.iterations = []
        sums = []
        velocities = [self.v]
        if n < max(1, settings.min_roi_events) or not events.span or not plan:
            flags |= Flag.DEGENERATE
            self.tracking = False
        else:
            if not warm:
                self.v = settings.v_start
            velocities = [self.v]
            self.dt = time_scaler(config, events.t[:n], span=events.span)
            positions = dither(config, events.x[:n], events.y[:n])
            batch_gain = gain(config, settings.eta)
            for entry in plan:
                step, saturated = self.iterate(*positions, self.dt, self.v, gain=batch_gain, entry=entry)
                flags |= Flag.SATURATED if saturated else Flag(0)
                self.v = step.v_next
                velocities.append(step.v_next)
                sums.append(step.sums)
                if keep:
                    self.iterations.append(step)
            self.tracking = True
            self.position, clamped = roi_updater(config, self.position, self.v, roi_gain=settings.roi_gain)
            flags |= Flag.ROI_CLAMPED if clamped else Flag(0)

        table = np.array(sums, np.int64).reshape(-1, 5)
        return BatchResult(
            events=events.events,
            roi_events=n,
            outside=events.outside,
            overflow=overflow,
            time_back=events.time_back,
            time_span=events.time_span,
            span=events.span,
            roi=roi,
            roi_next=tuple(crop_position(config, p) for p in self.position),
            v=(config.v.real(self.v[0]), config.v.real(self.v[1])),
            iterations=len(sums),
            flags=flags,
            trace=Trace(v=np.array(velocities, np.int64), sum_i=table[:, 0], sum_d=table[:, 1:3], s=table[:, 3:5]),
        )

    def _plan(self, settings, warm):
        """One :class:`ScheduleEntry` per iteration; None for a constant η."""
        if self.config.ascent == "sign":
            return settings.warm if warm else settings.cold
        return (None,) * settings.iterations

    def iterate(self, x, y, dt, v, *, gain=0, entry=None):
        """One iteration from the raw velocity ``v``: (:class:`IntegerIteration`, saturated).

        ``x`` and ``y`` have ``dither_frac`` fraction bits; ``entry`` is the iteration's :class:`ScheduleEntry`, None
        for a constant η, whose ``gain`` then counts.
        """
        config = self.config
        level = entry.level if entry else 0
        images = accumulator(config, voter(config, *warp(config, x, y, dt, v, level), dt, level))
        sums = gradient_reader(images)
        g = gradient(config, sums)
        steps = [
            sign_updater(config, axis_v, axis_g, log2_step=entry.log2_step)
            if entry
            else updater(config, axis_v, axis_g, gain=gain)
            for axis_v, axis_g in zip(v, g, strict=True)
        ]
        (vx, saturated_x), (vy, saturated_y) = steps
        return IntegerIteration(tuple(v), images, sums, g, (vx, vy)), saturated_x or saturated_y
