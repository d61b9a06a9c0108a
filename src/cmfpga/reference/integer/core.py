"""Model of :mod:`cmfpga.rtl.core`: batches in, velocities and a moving ROI out."""

from dataclasses import dataclass

import numpy as np

from ...config.schedule import used
from ...protocol.flags import Flag
from ...protocol.trace import Trace
from ..sequence import Sequence
from .accumulator import Images, accumulator
from .confidence import confidence
from .constant import gain, updater
from .dither import dither
from .gradient import Sums, gradient, gradient_reader
from .lanes import waits
from .sign import sign_updater
from .time_scaler import time_scaler
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


#: By the value of ``ascent``: the step of one axis from raw v, ``(next v, saturated)``.
STEPS = {
    "constant": lambda config, v, g, eta, entry: updater(config, v, g, gain=gain(config, eta)),
    "sign": lambda config, v, g, eta, entry: sign_updater(config, v, g, log2_step=entry.log2_step),
}


class IntegerCore(Sequence):
    """The core's state between batches, and how a batch changes it, in raw integers.

    See :class:`~cmfpga.reference.sequence.Sequence` for parameters and the other attributes.

    Attributes
    ----------
    dt : int64 tensor
        Scaled times of the last batch's ROI events.
    iterations : list of IntegerIteration
        Intermediates of the last batch, where ``run`` was asked to keep them.
    count_waits : bool
        Count ``waited``: cycles for which the last batch's votes wait for each other, where there are lanes. Off at
        first, because it takes as long as all else.
    """

    def __init__(self, config):
        super().__init__(config, 1 << config.formats.roi_x.f)
        self.dt = None
        self.iterations = []
        self.count_waits, self.waited = False, 0
        self._keep = False

    def run(self, t, x, y, settings, *, cut=False, keep=False):
        """Process one batch; ``keep`` every iteration's images in ``iterations`` (memory: T images)."""
        self._keep, self.iterations, self.waited = keep, [], 0
        return super().run(t, x, y, settings, cut=cut)

    @property
    def velocity(self):
        return tuple(self.config.formats.v.real(axis) for axis in self.v)

    def number(self, fmt, raw):
        return raw

    def ascend(self, batch, settings, plan):
        config = self.config
        self.dt = time_scaler(config, batch.t, span=batch.counts["span"])
        x, y = dither(config, batch.x, batch.y)
        velocities, sums, flags = [self.v], [], Flag(0)
        for k, entry in enumerate(plan):
            events = (axis[used(entry, k, len(x))] for axis in (x, y, self.dt))
            done, saturated = self.iterate(*events, velocities[-1], entry=entry, eta=settings.eta)
            flags |= Flag.SATURATED if saturated else Flag(0)
            velocities.append(done.v_next)
            sums.append(done.sums)
            if self._keep:
                self.iterations.append(done)
        judged = {}
        if config.confidence:
            judged, doubt = confidence(
                config,
                lambda v: self.iterate(x, y, self.dt, v, entry=entry)[0],
                done,
                settings,
                batch.counts["roi_events"],
            )
            flags |= doubt
        table = np.array(sums, np.int64)
        v = np.array(velocities, np.int64)
        return Trace(v=v, sum_i=table[:, 0], sum_d=table[:, 1:3], s=table[:, 3:5]), flags, judged

    def iterate(self, x, y, dt, v, *, entry, eta=0):
        """One iteration, of these events, from the raw velocity ``v``: (:class:`IntegerIteration`, saturated).

        ``x`` and ``y`` have ``dithered_frac`` fraction bits; ``entry`` is the iteration's :class:`ScheduleEntry`, and
        ``eta`` raw.
        """
        config, level = self.config, entry.level
        votes = voter(config, *warp(config, x, y, dt, v, level), dt, level)
        if self.count_waits and config.lanes > 1:
            self.waited += waits(config, votes)
        images = accumulator(config, votes)
        sums = gradient_reader(images)
        g = gradient(config, sums)
        step = STEPS[config.ascent]
        steps = [step(config, axis_v, axis_g, eta, entry) for axis_v, axis_g in zip(v, g, strict=True)]
        (vx, saturated_x), (vy, saturated_y) = steps
        return IntegerIteration(tuple(v), images, sums, g, (vx, vy)), saturated_x or saturated_y
