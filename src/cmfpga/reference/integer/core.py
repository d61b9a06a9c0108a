"""Model of :mod:`cmfpga.rtl.core`: batches in, velocities and a moving ROI out."""

from dataclasses import dataclass

import numpy as np

from ...config.schedule import used
from ...protocol.confidence import beside, contrast, curvature, is_sharp, is_trusted, least_fall, probes_towards_zero
from ...protocol.flags import Flag
from ...protocol.results import not_judged
from ...protocol.trace import Trace
from ..sequence import Sequence
from .ascent import gain, lesser, newton, sign_updater, updater
from .event_path import dither, time_scaler
from .image import Images, Sums, accumulator, gradient, gradient_reader, voter, warp
from .motion import basis, flow, moments


def confidence(config, sums, last, probed, settings, n):
    """``(fields of the result, flags)`` after a batch's last iteration.

    ``sums`` are its own, of a round the means, floored. ``last`` and ``probed`` are each an :class:`IntegerIteration`
    of ``n`` events: the last iteration's evaluations, and those beside v of a motion beyond translation.
    """
    squares = sum(int((one.images.i**2).sum()) for one in last) // len(last)
    limit, found = settings.confidence_limit, not_judged(config) | {"sum_squares": squares}
    if not config.motion_model.basis:  # a round has its curvature, whether it is judged or not
        shape = curvature(*(one.g for one in last))
        found["curvature"] = tuple(shape)
        trusted = is_trusted(config, n, limit, shape, contrast(config.geometry.pixels, sums, squares))
    elif settings.judge:
        least = least_fall(last[0].v_next, last[0].g, [one.g for one in probed])
        found["curvature"] = (least,)
        trusted = is_sharp(config, n, limit, least, squares)
    if not settings.judge:
        return found, Flag(0)
    return found | {"confidence_limit": limit}, Flag(0) if trusted else Flag.DOUBTFUL


@dataclass(frozen=True)
class IntegerIteration:
    """Every intermediate of one iteration, or of one evaluation of a round, raw integers."""

    v: tuple[int, ...]
    images: Images
    sums: Sums
    g: tuple[int, ...]
    v_next: tuple[int, ...] | None  # None of an evaluation


class IntegerCore(Sequence):
    """The core's state between batches, and how a batch changes it, in raw integers."""

    def __init__(self, config):
        super().__init__(config, 1 << config.formats.roi_x.f)
        self.dt = None  #: scaled times of the last batch's ROI events, int64 tensor
        self.iterations = []  #: :class:`IntegerIteration` each, of the last batch, where ``run`` was asked to keep them
        self._keep = False

    def run(self, t, x, y, settings, *, cut=False, keep=False):
        """Process one batch; ``keep`` every iteration's images in ``iterations`` (memory: T images)."""
        self._keep, self.iterations = keep, []
        return super().run(t, x, y, settings, cut=cut)

    @property
    def velocity(self):
        return tuple(self.config.formats.v.real(one) for one in self.v)

    def number(self, fmt, raw):
        return raw

    def ascend(self, batch, settings, plan, roi, middle=None):
        config = self.config
        self.dt = time_scaler(config, batch.t, span=batch.counts["span"])
        x, y = dither(config, batch.x, batch.y, batch.phase)
        b = basis(config, x, y, roi=roi, camera=settings.camera, middle=middle)
        velocities, sums, flags, rounds = [self.v], [], Flag(0), config.ascent_rule.evaluations > 1
        for k, entry in enumerate(plan):
            part = used(entry, k, len(x))
            events = (axis[part] for axis in (x, y, self.dt))
            its = {name: member[part] for name, member in b.items()}
            if rounds:
                made, v, saturated = self.round(*events, velocities[-1], entry=entry)
            else:
                more = {"entry": entry, "eta": settings.eta, "b": its, "middle": middle}
                done, saturated = self.iterate(*events, velocities[-1], **more)
                made, v = (done,), done.v_next
            flags |= Flag.SATURATED if saturated else Flag(0)
            velocities.append(v)
            sums += [(*one.sums[:3], *one.sums.s) for one in made]
            if self._keep:
                self.iterations += made
        trace = Trace.of_table(np.array(velocities, np.int64), np.array(sums, np.int64))
        judged = {}
        if config.confidence:
            places = probes_towards_zero(done.v_next, 3 << config.v_frac - 2) if settings.judge and b else ()
            probed = [self.iterate(x, y, self.dt, v, entry=entry, b=b, middle=middle)[0] for v in places]
            judged, doubt = confidence(config, trace.last_sums, made, probed, settings, batch.counts["roi_events"])
            flags |= doubt
        return trace, flags, judged

    def round(self, x, y, dt, v, *, entry):
        """One round, parameters as of :meth:`iterate`: (its four evaluations, next v, saturated)."""
        made = tuple(
            IntegerIteration(one, *self.evaluate(x, y, dt, one, entry.level), v_next=None)
            for one in beside(v, entry.distance << (self.config.v_frac - 2))
        )
        return made, *newton(self.config, v, [one.g for one in made], entry)

    def iterate(self, x, y, dt, v, *, entry, eta=0, b=None, middle=None):
        """One iteration, of these events, from the raw velocity ``v``: (:class:`IntegerIteration`, saturated).

        ``x`` and ``y`` have ``dithered_frac`` fraction bits; ``entry`` is the iteration's :class:`ScheduleEntry`, and
        ``eta`` raw; ``b`` the events' :func:`basis`, about ``middle``.
        """
        config = self.config
        images, sums, g = self.evaluate(x, y, dt, v, entry.level, b, middle)
        if b:
            formats, step = (one.fmt for one in config.motion_model.parameters), entry.log2_step
            each = [
                sign_updater(fmt, *axis, log2_step=step, halved=halved)
                for fmt, *axis, halved in zip(formats, v, g, lesser(config, g), strict=True)
            ]
        else:
            each = [updater(config, *axis, gain=gain(config, eta)) for axis in zip(v, g, strict=True)]
        found, saturated = zip(*each, strict=True)
        return IntegerIteration(tuple(v), images, sums, g, found), any(saturated)

    def evaluate(self, x, y, dt, v, level, b=None, middle=None):
        """``(Images, Sums, G)`` at the raw velocity ``v``; other parameters as of :meth:`iterate`."""
        config = self.config
        votes = voter(config, *warp(config, x, y, dt, flow(config, v, b), level), dt, level)
        images = accumulator(config, votes)
        sums = gradient_reader(images)
        if b:
            sums = sums._replace(s=tuple(moments(config, votes, images, b, level, middle)))
        return images, sums, gradient(config, sums)
