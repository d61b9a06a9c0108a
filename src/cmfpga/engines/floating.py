"""The float64 reference as an engine."""

import math

import numpy as np
import torch

from ..batch import BatchResult, Flag, Trace
from ..fixed import saturate
from ..reference.floating import ascend, ascend_by_signs, dither, float64, scaled_times
from ..reference.integer.roi_filter import roi_filter
from .base import Engine


class FloatEngine(Engine):
    """Runs the equations in float64: what the arithmetic of the other engines is measured against.

    Cropping is the hardware's (it is exact); times, dither, votes, gradients, v and the ROI's position are not rounded,
    and v does not saturate. ``eta``, ``roi_gain`` and ``v_start`` are those that the hardware's formats can express.
    """

    name = "float"

    def __init__(self, config):
        super().__init__(config)
        torch.set_num_threads(1)  # tensors this small only get slower with more
        self._v = (0.0, 0.0)
        self._tracking = False  # as in the integer core: v is that of an object that is being followed
        self._position = (0.0, 0.0)

    @property
    def v(self):
        return self._v

    def _run(self, events, settings):
        config = self.config
        flags = Flag(0)
        if settings.roi is not None:
            self._position = tuple(map(float, settings.roi))
            self._tracking = False
        roi = self._crop()
        inside = roi_filter(config, events.t, events.x, events.y, roi=roi)
        n = min(len(inside.t), config.buffer_events)
        for count, flag in (
            (len(inside.t) - n, Flag.OVERFLOW),
            (inside.time_back, Flag.TIME_BACK),
            (inside.time_span, Flag.TIME_SPAN),
        ):
            flags |= flag if count else Flag(0)
        warm = settings.start_last and (self._tracking or config.ascent == "constant")
        if config.ascent == "sign":
            plan = settings.warm if warm else settings.cold
        else:
            plan = range(settings.iterations)
        if n < max(1, settings.min_roi_events) or not inside.span or not plan:
            flags |= Flag.DEGENERATE
            self._tracking = False
            trace = Trace(v=np.array([self._v]), sum_i=np.zeros(0), sum_d=np.zeros((0, 2)), s=np.zeros((0, 2)))
        else:
            if not warm:
                self._v = tuple(config.v.real(axis) for axis in settings.v_start)
            trace = self._ascend(inside, n, settings, plan)
            self._v = tuple(trace.v[-1].tolist())
            self._tracking = True
            flags |= self._move(config.roi_gain_format.real(settings.roi_gain))
        return BatchResult(
            events=inside.events,
            roi_events=n,
            outside=inside.outside,
            overflow=len(inside.t) - n,
            time_back=inside.time_back,
            time_span=inside.time_span,
            span=inside.span,
            roi=roi,
            roi_next=self._crop(),
            v=self._v,
            iterations=len(trace.sum_i),
            flags=flags,
            trace=trace,
        )

    def _ascend(self, inside, n, settings, plan):
        config = self.config
        x, y, dt = float64(inside.x[:n]), float64(inside.y[:n]), scaled_times(inside.t[:n], 0, inside.span)
        if config.dither_frac:
            x, y = (axis + offset for axis, offset in zip((x, y), dither(n), strict=True))
        start = {"width": config.roi_width, "height": config.roi_height, "v_start": self._v}
        if config.ascent == "sign":
            done = ascend_by_signs(x, y, dt, **start, schedule=plan)
        else:
            eta = config.eta_format.real(settings.eta)
            done = ascend(x, y, dt, **start, eta=eta, iterations=len(plan))
        return Trace(v=done.v.numpy(), sum_i=done.sum_i.numpy(), sum_d=done.sum_d.numpy(), s=done.s.numpy())

    def _crop(self):
        return tuple(math.floor(axis + 0.5) for axis in self._position)

    def _move(self, gain):
        limits = (self.config.roi_x_max, self.config.roi_y_max)
        target = tuple(p + gain * v for p, v in zip(self._position, self._v, strict=True))
        self._position = tuple(saturate(p, 0.0, float(limit)) for p, limit in zip(target, limits, strict=True))
        return Flag.ROI_CLAMPED if self._position != target else Flag(0)
