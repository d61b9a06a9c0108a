"""The float reference's batches in a row: cropped, started and followed as in the integer model."""

from types import SimpleNamespace

import numpy as np

from ..protocol.flags import Flag
from ..protocol.trace import Trace
from . import flow
from .confidence import is_doubtful, of_round, probe_flow
from .float_ascent import ascend, ascend_by_rounds
from .floating import dither, float64, scaled_times
from .sequence import Sequence


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
        """``(x, y, dt)`` of the events of a :class:`~.ingest.TakenIn`, dithered and scaled: three float64 [n].

        Undistorted positions are those that the hardware stores.
        """
        x, y = (float64(axis) * 2.0**-self.config.formats.event_frac for axis in (batch.x, batch.y))
        if self.config.dither_frac:
            x, y = (axis + offset for axis, offset in zip((x, y), dither(len(x)), strict=True))
        return x, y, scaled_times(batch.t, 0, batch.counts["span"])

    def ascend(self, batch, settings, plan, roi, middle=None):
        config = self.config
        events = self.place(batch)
        if config.motion_model.basis:
            trace, judged = self._flow(events, settings, plan, roi, middle)
            return trace, self._doubt(judged, trace, batch), judged
        size = {"width": config.roi_width, "height": config.roi_height, "border": config.border}
        if config.ascent_rule.evaluations > 1:
            done = ascend_by_rounds(*events, **size, v_start=self.v, schedule=plan)
        else:
            eta = config.formats.eta.real(settings.eta)
            done = ascend(*events, **size, v_start=self.v, eta=eta, iterations=len(plan))
        trace = Trace(v=done.v.numpy(), sum_i=done.sum_i.numpy(), sum_d=done.sum_d.numpy(), s=done.s.numpy())
        if not config.confidence:
            return trace, Flag(0), {}
        judged = of_round(config.geometry.pixels, done, settings)
        return trace, self._doubt(judged, trace, batch), judged

    def _doubt(self, judged, trace, batch):
        """The flag that follows from what was ``judged``."""
        if not judged:
            return Flag(0)
        kept = {"sums": trace.last_sums, "roi_events": batch.counts["roi_events"], "flags": Flag(0)}
        doubtful = is_doubtful(self.config, SimpleNamespace(**judged, **kept))
        return Flag.DOUBTFUL if doubtful else Flag(0)

    def _flow(self, events, settings, plan, roi, middle):
        """The trace of a motion beyond translation, whose roll and zoom are limited as in the hardware, and how sure it
        is."""
        config = self.config
        b = flow.basis(config, *events[:2], roi=roi, camera=settings.camera, middle=middle)
        limits = float64([p.fmt.real(p.fmt.max) for p in config.motion_model.parameters])
        size = {"width": config.roi_width, "height": config.roi_height}

        def at_pixels(level):
            return flow.pixel_basis(config, level, middle) if config.motion_model.of_pixels else None

        done = flow.ascend(*events, b, v_start=self.v, schedule=plan, limits=limits, at_pixels=at_pixels, **size)
        none = np.zeros((len(plan), 2))
        trace = Trace(v=done.v.numpy(), sum_i=done.sum_i.numpy(), sum_d=none, s=done.s.numpy())
        if not config.confidence:
            return trace, {}
        size |= {"level": plan[-1].level, "at_pixels": at_pixels(plan[-1].level)}
        return trace, probe_flow(*events, *done.v[-2:].tolist(), b, settings, **size)
