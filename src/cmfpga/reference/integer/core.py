"""Model of :mod:`cmfpga.rtl.core`: batches in, velocities and a moving ROI out."""

from dataclasses import dataclass

import numpy as np

from ...protocol.flags import Flag
from ...protocol.results import BatchResult, not_judged
from ...protocol.trace import Trace
from ..ingest import take_in
from ..roi_follower import RoiFollower
from .accumulator import Images, accumulator
from .confidence import confidence
from .dither import dither
from .gradient import Sums, gradient, gradient_reader
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
    doubtful : bool
        Whether the last batch was flagged so.
    follower : RoiFollower
        Raw ROI position; the origin after a reset.
    thinning : int or None
        What would have brought the last batch down to its target.
    dt : int64 tensor
        Scaled times of the last batch's ROI events.
    iterations : list of IntegerIteration
        Intermediates of the last batch, where ``run`` was asked to keep them.
    """

    def __init__(self, config):
        self.config = config
        self.v = (0, 0)
        self.tracking = self.doubtful = False
        self.follower = RoiFollower(config, 1 << config.formats.roi_x.f)
        self.thinning = None
        self.dt = None
        self.iterations = []

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
        roi, limited = self.follower.crop(settings.roi)
        if settings.roi is not None:
            self.tracking = False
        batch = take_in(config, t, x, y, settings, roi=roi, last_thinning=self.thinning)
        self.thinning = batch.next_thinning
        flags = batch.flags | (Flag.CUT if cut else Flag(0))

        warm = settings.start_last and (self.tracking or config.ascent == "constant")
        restarted = warm and self.doubtful and bool(settings.cold_after_doubtful)
        warm = warm and not restarted
        plan = self._plan(settings, warm)
        judged = not_judged(config)
        self.iterations = []
        sums = []
        velocities = [self.v]
        step = None
        if not batch.enough(settings) or not plan:
            flags |= Flag.DEGENERATE
            self.tracking = False
        else:
            if not warm:
                self.v = settings.v_start
            velocities = [self.v]
            self.dt = time_scaler(config, batch.t, span=batch.counts["span"])
            positions = dither(config, batch.x, batch.y)
            batch_gain = gain(config, settings.eta)
            for entry in plan:
                done, saturated = self.iterate(*positions, self.dt, self.v, gain=batch_gain, entry=entry)
                flags |= Flag.SATURATED if saturated else Flag(0)
                self.v = done.v_next
                velocities.append(done.v_next)
                sums.append(done.sums)
                if keep:
                    self.iterations.append(done)
            if config.confidence:
                again = lambda v: self.iterate(*positions, self.dt, v, entry=entry)[0]  # noqa: E731
                judged, doubt = confidence(config, again, done, settings, batch.counts["roi_events"])
                judged["restarted"] = int(restarted)
                flags |= doubt
            self.tracking = True
            step = tuple(axis * settings.roi_gain for axis in self.v)
        self.doubtful = Flag.DOUBTFUL in flags
        limited |= self.follower.move(step)
        flags |= Flag.ROI_CLAMPED if limited else Flag(0)

        table = np.array(sums, np.int64).reshape(-1, 5)
        return BatchResult(
            **batch.counts,
            roi=roi,
            roi_next=self.follower.next_corner,
            v=(config.formats.v.real(self.v[0]), config.formats.v.real(self.v[1])),
            iterations=len(sums),
            flags=flags,
            **judged,
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
