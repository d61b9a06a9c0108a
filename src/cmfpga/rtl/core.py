"""The core: events in, velocity and a moving ROI out. One instance tracks one object."""

from amaranth.hdl import Module, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out, connect

from ..batch import Flag
from . import payloads
from .accumulator import Accumulator
from .batch_control import BatchControl
from .event_buffer import EventBuffer
from .gradient import Gradient
from .gradient_reader import GradientReader
from .reciprocal import Reciprocal
from .roi_filter import RoiFilter
from .roi_updater import RoiUpdater
from .time_scaler import TimeScaler
from .updater import Updater
from .voter import BilinearVoter
from .warp import Warp


class Core(wiring.Component):
    """Contrast Maximization of batches of events: the article's architecture.

    ::

        i ─► control ─► filter ─► buffer ─► scaler ─► warp ─► voter ─► accumulator
                          │ t_1, t_N          ▲        ▲ v                 │ ▲ sweep, clear
                          └──► reciprocal ────┘        │                   ▼ │
             o ◄── result ◄── roi_updater ◄── updater ─┴──── gradient ◄── reader

    One event per cycle at ingest and in every iteration. A batch of N events, n of them in the ROI, takes
    exactly :meth:`cycles` clock cycles from the offer of its first event to its result.

    Parameters
    ----------
    config : Config
        Everything.

    Members
    -------
    i : ``In``, stream of :func:`payloads.event`
    o : ``Out``, stream of :func:`payloads.result`
        One per batch; the next batch is accepted when it is taken. ``sums`` are those of the last
        iteration, and mean nothing where the ``DEGENERATE`` flag is set.
    settings : ``In``, :func:`payloads.settings`
        Taken over in the cycle in which a batch's first event is offered; may change at any other time.
    trace : ``Out``, flow of :func:`payloads.trace`
        Every iteration's v and sums, for verification.
    pixels : ``Out``, flow of an array of four :func:`payloads.pixel`
        Every iteration's images as the sweep reads them, for verification.
    """

    def __init__(self, config):
        self.config = config
        self._control_blocks()
        super().__init__(
            {
                "i": In(stream.Signature(payloads.event(config))),
                "o": Out(stream.Signature(payloads.result(config))),
                "settings": In(payloads.settings(config)),
                "trace": Out(payloads.flow(payloads.trace(config))),
                "pixels": Out(payloads.flow(data.ArrayLayout(payloads.pixel(config), 4))),
            }
        )

    def _control_blocks(self):
        config = self.config
        self.roi_filter = RoiFilter(config)
        self.event_buffer = EventBuffer(config)
        self.reciprocal = Reciprocal(config)
        self.time_scaler = TimeScaler(config)
        self.warp = Warp(config)
        self.voter = BilinearVoter(config)
        self.accumulator = Accumulator(config)
        self.gradient_reader = GradientReader(config, accumulator_latency=self.accumulator.latency)
        self.gradient = Gradient(config)
        self.updater = Updater(config)
        self.roi_updater = RoiUpdater(config)
        self._drain = self.roi_filter.latency + 1
        self._feed = self.event_buffer.latency + self.time_scaler.latency
        self._evaluate = self.gradient_reader.latency + self.gradient.latency + self.updater.latency
        self.batch_control = BatchControl(
            config,
            drain=self._drain,
            replay_delay=self._evaluate - self._feed,
            move=self.roi_updater.latency,
        )

    @property
    def iteration_latency(self):
        """L: an iteration takes n + P/4 + L cycles, from one v to the next.

        The sweep's first address follows the last vote by one cycle; the last of its P/4 addresses is evaluated.
        """
        return self.warp.latency + self.voter.latency - 1 + self._evaluate

    @property
    def batch_latency(self):
        """Cycles of a batch that depend on neither N, n nor T."""
        return self._drain + self.reciprocal.latency + self._feed + self.roi_updater.latency

    def cycles(self, *, events, roi_events, iterations):
        """Clock cycles of a batch: N + T·(n + P/4 + L) + constant.

        From the cycle in which the first event is offered to the one in which the result is; events offered in every
        cycle, batch not degenerate.
        """
        return events + iterations * (roi_events + self.config.bank_words + self.iteration_latency) + self.batch_latency

    @property
    def cycle_formula(self):
        """:meth:`cycles` as text."""
        return f"N + T·(n + {self.config.bank_words} + {self.iteration_latency}) + {self.batch_latency}"

    @property
    def latencies(self):
        """Clock cycles from input to output of each block that the events or the sums go through, by name."""
        names = (
            "roi_filter", "event_buffer", "reciprocal", "time_scaler", "warp", "voter", "accumulator",
            "gradient_reader", "gradient", "updater", "roi_updater",
        )  # fmt: skip
        return {name: getattr(self, name).latency for name in names}

    def elaborate(self, platform):
        m = Module()
        for name in (
            "batch_control", "roi_filter", "event_buffer", "reciprocal", "time_scaler", "warp", "voter", "accumulator",
            "gradient_reader", "gradient", "updater", "roi_updater",
        ):  # fmt: skip
            m.submodules[name] = getattr(self, name)
        control, roi = self.batch_control, self.roi_updater
        current = control.current

        # Ingest: crop, store, measure the time range.
        connect(m, wiring.flipped(self.i), control.i)
        connect(m, control.o, self.roi_filter.i)
        connect(m, self.roi_filter.o, self.event_buffer.i)
        m.d.comb += [
            control.settings.eq(self.settings),
            self.roi_filter.start.eq(control.open),
            self.roi_filter.roi.eq(roi.roi),
            self.event_buffer.clear.eq(control.open),
            control.stored.eq(self.event_buffer.count),
            control.span.eq(self.roi_filter.span),
            self.reciprocal.start.eq(control.divide),
            self.reciprocal.span.eq(self.roi_filter.span),
            control.divided.eq(self.reciprocal.done),
        ]

        # Iterations: replay, scale, warp, vote, accumulate.
        connect(m, self.event_buffer.o, self.time_scaler.i)
        connect(m, self.time_scaler.o, self.warp.i)
        connect(m, self.warp.o, self.voter.i)
        connect(m, self.voter.o, self.accumulator.i)
        m.d.comb += [
            self.event_buffer.replay.eq(control.replay),
            self.time_scaler.span.eq(self.roi_filter.span),
            self.time_scaler.shift.eq(self.reciprocal.shift),
            self.time_scaler.mantissa.eq(self.reciprocal.mantissa),
            self.warp.v.eq(self.updater.v),
        ]

        # Sweep as soon as the last vote has entered; gradient; new v.
        voted = Signal()
        m.d.sync += voted.eq(self.voter.o.valid & self.voter.o.payload.last)
        connect(m, self.gradient_reader.sweep, self.accumulator.sweep)
        connect(m, self.accumulator.o, self.gradient_reader.i)
        connect(m, self.gradient_reader.o, self.gradient.i)
        m.d.comb += [
            self.gradient_reader.start.eq(voted | control.sweep),
            control.swept.eq(self.gradient_reader.sweep.valid & self.gradient_reader.sweep.payload.last),
            self.updater.i.valid.eq(self.gradient.o.valid & control.iterating),
            self.updater.i.payload.eq(self.gradient.o.payload),
            self.updater.load.eq(control.start & ~current.start_last),
            self.updater.new_batch.eq(control.open),
            self.updater.start.eq(current.v_start),
            self.updater.eta.eq(current.eta),
            control.updated.eq(self.updater.done),
        ]

        # The ROI follows.
        roi_used = Signal(payloads.roi_corner(self.config))
        m.d.comb += [
            roi.new_batch.eq(control.open),
            roi.load.eq(self.settings.roi_load),
            roi.x.eq(self.settings.roi_x),
            roi.y.eq(self.settings.roi_y),
            roi.v.eq(self.updater.v),
            roi.roi_gain.eq(current.roi_gain),
            roi.move.eq(control.move),
        ]
        with m.If(control.o.valid):
            m.d.sync += roi_used.eq(roi.roi)

        self._result(m, roi_used)
        m.d.comb += [
            self.trace.valid.eq(self.gradient_reader.o.valid & control.iterating),
            self.trace.payload.v.eq(self.updater.v),
            self.trace.payload.sums.eq(self.gradient_reader.o.payload),
            self.pixels.valid.eq(self.accumulator.o.valid & control.iterating),
            self.pixels.payload.eq(self.accumulator.o.payload),
        ]
        return m

    def _result(self, m, roi_used):
        """Nothing of this changes while a result waits, so it needs no registers of its own."""
        control = self.batch_control
        result = self.o.payload
        flags = {
            Flag.DEGENERATE: control.degenerate,
            Flag.OVERFLOW: self.event_buffer.overflow != 0,
            Flag.TIME_BACK: self.roi_filter.time_back != 0,
            Flag.TIME_SPAN: self.roi_filter.time_span != 0,
            Flag.CUT: control.cut,
            Flag.SATURATED: self.updater.saturated,
            Flag.ROI_CLAMPED: self.roi_updater.clamped,
        }
        m.d.comb += [
            self.o.valid.eq(control.done),
            control.taken.eq(self.o.ready),
            result.v.eq(self.updater.v),
            result.t_first.eq(self.roi_filter.t_first),
            result.span.eq(self.roi_filter.span),
            result.events.eq(control.events),
            result.roi_events.eq(self.event_buffer.count),
            result.outside.eq(self.roi_filter.outside),
            result.overflow.eq(self.event_buffer.overflow),
            result.time_back.eq(self.roi_filter.time_back),
            result.time_span.eq(self.roi_filter.time_span),
            result.roi.eq(roi_used),
            result.roi_next.eq(self.roi_updater.roi),
            result.iterations.eq(control.iterations),
            result.sums.eq(self.gradient_reader.o.payload),
            result.cycles.eq(control.cycles),
            *(result.flags[flag.bit_length() - 1].eq(value) for flag, value in flags.items()),
        ]
