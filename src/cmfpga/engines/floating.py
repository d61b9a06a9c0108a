"""The float64 reference as an engine."""

import dataclasses

import torch

from ..protocol.flags import Flag
from ..protocol.results import BatchResult, not_judged
from ..protocol.trace import Trace
from ..reference.confidence import is_doubtful, probe
from ..reference.floating import ascend, ascend_by_signs, dither, float64, scaled_times
from ..reference.ingest import take_in
from ..reference.roi_follower import RoiFollower
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
        # As in the integer core: v is that of an object that is being followed; it is not sure.
        self._tracking = self._doubtful = False
        self._follower = RoiFollower(config, 1.0)
        self._thinning = None

    @property
    def v(self):
        return self._v

    def _trace_v(self):
        return self._v

    def _run(self, events, settings):
        config = self.config
        roi, limited = self._follower.crop(settings.roi)
        if settings.roi is not None:
            self._tracking = False
        batch = take_in(config, events.t, events.x, events.y, settings, roi=roi, last_thinning=self._thinning)
        self._thinning = batch.next_thinning
        flags = batch.flags
        warm = settings.start_last and (self._tracking or config.ascent == "constant")
        restarted = warm and self._doubtful and bool(settings.cold_after_doubtful)
        warm, judged, self._doubtful = warm and not restarted, not_judged(config), False
        if config.ascent == "sign":
            plan = settings.warm if warm else settings.cold
        else:
            plan = range(settings.iterations)
        step = None
        if not batch.enough(settings) or not plan:
            flags |= Flag.DEGENERATE
            self._tracking = False
            trace = Trace.without_iterations(self._trace_v())
        else:
            if not warm:
                self._v = tuple(config.formats.v.real(axis) for axis in settings.v_start)
            trace, judged = self._ascend(batch, settings, plan)
            if judged:
                judged["restarted"] = int(restarted)
            self._v = tuple(trace.v[-1].tolist())
            self._tracking = True
            gain = config.formats.roi_gain.real(settings.roi_gain)
            step = tuple(gain * axis for axis in self._v)
        limited |= self._follower.move(step)
        flags |= Flag.ROI_CLAMPED if limited else Flag(0)
        result = BatchResult(
            **batch.counts,
            roi=roi,
            roi_next=self._follower.next_corner,
            v=self._v,
            iterations=len(trace.sum_i),
            flags=flags,
            **judged,
            trace=trace,
        )
        self._doubtful = is_doubtful(config, result)
        return dataclasses.replace(result, flags=flags | Flag.DOUBTFUL) if self._doubtful else result

    def _ascend(self, batch, settings, plan):
        config = self.config
        x, y, dt = float64(batch.x), float64(batch.y), scaled_times(batch.t, 0, batch.counts["span"])
        if config.dither_frac:
            x, y = (axis + offset for axis, offset in zip((x, y), dither(len(x)), strict=True))
        size = {"width": config.roi_width, "height": config.roi_height}
        start = {**size, "v_start": self._v}
        if config.ascent == "sign":
            done = ascend_by_signs(x, y, dt, **start, schedule=plan)
        else:
            eta = config.formats.eta.real(settings.eta)
            done = ascend(x, y, dt, **start, eta=eta, iterations=len(plan))
        judged = {}
        if config.confidence:
            judged = probe(x, y, dt, *done.v[-2:].tolist(), settings, level=plan[-1].level, **size)
        return Trace(v=done.v.numpy(), sum_i=done.sum_i.numpy(), sum_d=done.sum_d.numpy(), s=done.s.numpy()), judged
