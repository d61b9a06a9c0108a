"""The float reference: ascents of a translation, by the article's constant η and by Newton's rounds; batches in a row.

Batches are cropped, started and followed as in the integer model. See :mod:`.floating` for what ``x``, ``y``, ``dt``
and ``v`` are.
"""

from types import SimpleNamespace
from typing import NamedTuple

import torch

from ..config.schedule import ScheduleEntry
from ..fixed import saturate
from ..protocol.confidence import LIMIT_SCALE, PROBE, beside, confidence, curvature, least_fall, probes_towards_zero
from ..protocol.flags import Flag
from ..protocol.trace import Trace
from . import flow
from .floating import dither, evaluate, float64, scaled_times
from .sequence import Sequence


class Ascent(NamedTuple):
    """T iterations, float64. Of rounds all but ``v`` have an axis more behind T: four evaluations beside ``v[k]``."""

    v: torch.Tensor  # [T + 1, 2]: the start, then v after each iteration; v[-1] is the result
    contrast: torch.Tensor  # [T], C at v[k]; the contrast of the result itself is not part of an iteration
    gradient: torch.Tensor  # [T, 2], ∇C at v[k]
    sum_i: torch.Tensor  # [T], ΣI at v[k]
    sum_d: torch.Tensor  # [T, 2], ΣD at v[k], along x and y
    s: torch.Tensor  # [T, 2], S
    g: torch.Tensor  # [T, 2], G


def _follow(x, y, dt, v_start, plan, step, around=None, **size):
    """An :class:`Ascent`: v ← v + step(k, iteration k), for each entry of a plan.

    ``around(k, v)``: the velocities that are evaluated, where that is not v; ``step`` has a list then.
    """
    with torch.no_grad():  # a trace, not a graph
        x, y, dt = float64(x), float64(y), float64(dt)
        v = torch.empty(len(plan) + 1, 2, dtype=torch.float64, device=dt.device)
        v[0] = float64(v_start)
        scalars = [v.new_empty(0, *((4,) if around else ()), 10)]
        for k, entry in enumerate(plan):
            places = around(k, v[k]) if around else [v[k]]
            each = [evaluate(x, y, dt, one, level=entry.level, **size) for one in places]
            made = torch.stack(
                [torch.stack((now.contrast, *now.gradient, now.sum_i, *now.sum_d, *now.s, *now.g)) for now in each]
            )
            scalars.append(made[None] if around else made)
            v[k + 1] = v[k] + step(k, each if around else each[0])
    contrasts, gradients, sum_i, sum_d, s, g = torch.cat(scalars).split((1, 2, 1, 2, 2, 2), dim=-1)
    return Ascent(v, contrasts[..., 0], gradients, sum_i[..., 0], sum_d, s, g)


def ascend(x, y, dt, *, v_start, eta, iterations, **size):
    """Gradient ascent with constant step: v ← v + η·∇C, ``iterations`` times (Eq. v_update). An :class:`Ascent`.

    ``size`` is ``width``, ``height`` and ``border``, as for :func:`evaluate`. v does not saturate here, as it does in
    the hardware.
    """
    plan = [ScheduleEntry(0, None)] * iterations
    return _follow(x, y, dt, v_start, plan, lambda _, now: eta * now.gradient, **size)


def newton_step(gradients, distance, limit):
    """M⁻¹·g, a list of two, of (G_x, G_y) at four velocities ``distance`` beside v: see :mod:`.integer.ascent`."""
    x, y = (sum(axis) / 4 for axis in zip(*gradients, strict=True))
    xx, yy, cross = (one / (2 * distance) for one in curvature(*gradients))
    det, trace = xx * yy - cross * cross / 4, xx + yy
    if 4 * det < trace * trace / 2:
        xx, yy, det = xx + trace / 8, yy + trace / 8, det + trace * trace * 9 / 64
    if trace <= 0 or det <= 0:
        return [0 if 2 * abs(one) < max(abs(x), abs(y)) else limit * ((one > 0) - (one < 0)) for one in (x, y)]
    step = (yy * x - cross / 2 * y) / det, (xx * y - cross / 2 * x) / det
    least = min(limit, 2 * distance)
    return [saturate(one, -least, least) for one in step]


def ascend_by_rounds(x, y, dt, *, v_start, schedule, **size):
    """Newton's ascent: v ← v + :func:`newton_step` of each of a ``schedule`` of :class:`cmfpga.config.schedule.Round`.

    Returns an :class:`Ascent`. ``size`` is as for :func:`ascend`; v does not saturate here, as it does in the hardware.
    """

    def around(k, v):
        return [v.new_tensor(one) for one in beside(v.tolist(), schedule[k].distance / 4)]

    def step(k, each):
        gradients = [now.g.tolist() for now in each]
        return each[0].g.new_tensor(newton_step(gradients, schedule[k].distance / 4, schedule[k].limit))

    return _follow(x, y, dt, v_start, schedule, step, around, **size)


class FloatCore(Sequence):
    """The equations in float64; see :class:`~.sequence.Sequence` for parameters and attributes."""

    def __init__(self, config):
        super().__init__(config, 1.0)

    @property
    def velocity(self):
        return self.v

    def number(self, fmt, raw):
        return fmt.real(raw)

    def place(self, batch):
        """``(x, y, dt)`` of a :class:`~.ingest.TakenIn`, dithered and scaled: three float64 [n]."""
        x, y = (float64(axis) * 2.0**-self.config.formats.event_frac for axis in (batch.x, batch.y))
        if self.config.dither_frac:
            x, y = (axis + offset for axis, offset in zip((x, y), dither(len(x)), strict=True))
        return x, y, scaled_times(batch.t, 0, batch.counts["span"])

    def ascend(self, batch, settings, plan, roi, middle=None):
        events, limit = self.place(batch), settings.confidence_limit if settings.judge else 0
        if self.config.motion_model.basis:
            trace, *shape = self._flow(events, settings, plan, roi, middle)
        else:
            trace, *shape = self._translation(events, settings, plan)
        if not self.config.confidence:
            return trace, Flag(0), {}
        judged = dict(zip(("sum_squares", "curvature"), shape, strict=True)) | {"confidence_limit": limit}
        of_batch = {"sums": trace.last_sums, "roi_events": batch.counts["roi_events"], "flags": Flag(0)}
        kappa = confidence(self.config, SimpleNamespace(**judged, **of_batch))
        doubtful = kappa is not None and LIMIT_SCALE * kappa < limit  # exactly
        return trace, Flag.DOUBTFUL if doubtful else Flag(0), judged

    def _translation(self, events, settings, plan):
        """The trace of a translation; of rounds the last one's mean Σ I² and curvature."""
        config, pixels = self.config, self.config.geometry.pixels
        size = {"width": config.roi_width, "height": config.roi_height, "border": config.border}
        if config.ascent_rule.evaluations > 1:
            done = ascend_by_rounds(*events, **size, v_start=self.v, schedule=plan)
        else:
            eta = config.formats.eta.real(settings.eta)
            done = ascend(*events, **size, v_start=self.v, eta=eta, iterations=len(plan))
        trace = Trace(v=done.v.numpy(), sum_i=done.sum_i.numpy(), sum_d=done.sum_d.numpy(), s=done.s.numpy())
        if not config.confidence:
            return (trace,)
        squares = pixels * (done.contrast[-1] + (done.sum_i[-1] / pixels) ** 2)
        return trace, float(squares.mean()), tuple(curvature(*done.g[-1].tolist()))

    def _flow(self, events, settings, plan, roi, middle):
        """The trace of another motion, whose roll and zoom are limited as in the hardware; Σ I² of its last iteration,
        and how much the gradient falls towards zero.
        """
        config = self.config
        b = flow.basis(config, *events[:2], roi=roi, camera=settings.camera, middle=middle)
        limits = float64([p.fmt.real(p.fmt.max) for p in config.motion_model.parameters])
        size = {"width": config.roi_width, "height": config.roi_height}

        def at_pixels(level):
            return flow.pixel_basis(config, level, middle) if config.motion_model.of_pixels else None

        trace = flow.ascend(*events, b, v_start=self.v, schedule=plan, limits=limits, at_pixels=at_pixels, **size)
        if not config.confidence:
            return (trace,)
        size["level"] = plan[-1].level
        last, found = trace.v[-2:].tolist()
        gradient, *probed = (
            flow.sums(*events, v, b, at_pixels=at_pixels(plan[-1].level), **size)[1].tolist()
            for v in (last, *(probes_towards_zero(tuple(found), PROBE) if settings.judge else ()))
        )
        fall = least_fall(found, gradient, probed) if probed else 0.0
        return trace, flow.squares(*events, last, b, **size), (fall,)
