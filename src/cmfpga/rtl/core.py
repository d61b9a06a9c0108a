"""The core: events in, velocity and a moving ROI out. One instance tracks one object."""

import itertools

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out, connect

from ..protocol.flags import Flag
from ..protocol.results import RESULTS
from . import payloads
from .ascent.gradient import Gradient
from .ascent.roi_updater import RoiUpdater
from .ascent.schedule import Schedule
from .ascent.sign_updater import SignUpdater
from .ascent.updater import Updater
from .batch_control import BatchControl
from .image.accumulator import Accumulator
from .image.dither import Dither
from .image.gradient_reader import GradientReader
from .image.one_pass_gradient import OnePassGradient
from .image.tagged_accumulator import TaggedAccumulator
from .image.time_scaler import TimeScaler
from .image.voter import BilinearVoter
from .image.warp import Warp
from .ingest.event_buffer import EventBuffer
from .ingest.reciprocal import Reciprocal
from .ingest.roi_filter import RoiFilter
from .ingest.thinner import Thinner


class Core(wiring.Component):
    """Contrast Maximization of batches of events.

    With ``gradient="sweep"`` and ``ascent="constant"`` this is the article's architecture::

        i ─► control ─► filter ─► buffer ─► scaler ─► warp ─► voter ─► accumulator
                          │ t_1, t_N          ▲        ▲ v                 │ ▲ sweep, clear
                          └──► reciprocal ────┘        │                   ▼ │
             o ◄── result ◄── roi_updater ◄── updater ─┴──── gradient ◄── reader

    With ``gradient="one_pass"`` a tagged accumulator and the one-pass gradient take the place of accumulator and
    reader; with ``ascent="sign"`` a sign updater and its schedule that of the updater; with ``dither_frac`` a dither
    stands before the scaler. All other blocks are the same.

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
        Taken over when a batch's first event is offered to the idle core, one cycle before it is accepted: hold them
        until then.
    trace : ``Out``, flow of :func:`payloads.trace`
        Every iteration's v and sums, for verification.
    pixels : ``Out``, flow of an array of four :func:`payloads.pixel`
        Every iteration's images as the sweep reads them, for verification. Only with ``gradient="sweep"``.
    schedule_write : ``In``, flow of :func:`payloads.schedule_write`
        Fills the table of schedules. Only with ``ascent="sign"``.
    """

    def __init__(self, config):
        self.config = config
        self.one_pass = config.gradient == "one_pass"
        self.signs = config.ascent == "sign"
        self._make_blocks()
        members = {
            "i": In(stream.Signature(payloads.event(config))),
            "o": Out(stream.Signature(payloads.result(config))),
            "settings": In(payloads.settings(config)),
            "trace": Out(payloads.flow(payloads.trace(config))),
        }
        if not self.one_pass:
            members["pixels"] = Out(payloads.flow(data.ArrayLayout(payloads.pixel(config), 4)))
        if self.signs:
            members["schedule_write"] = In(payloads.flow(payloads.schedule_write(config)))
        super().__init__(members)

    def _make_blocks(self):
        config = self.config
        self.roi_filter = RoiFilter(config)
        self.thinner = Thinner(config)
        self.event_buffer = EventBuffer(config)
        self.reciprocal = Reciprocal(config)
        self.dither = Dither(config) if config.dither_frac else None
        self.time_scaler = TimeScaler(config)
        self.warp = Warp(config)
        self.voter = BilinearVoter(config)
        if self.one_pass:
            self.tagged_accumulator = TaggedAccumulator(config)
            self.one_pass_gradient = OnePassGradient(config, accumulator_latency=self.tagged_accumulator.latency)
            summing = self.one_pass_gradient.latency
        else:
            self.accumulator = Accumulator(config)
            self.gradient_reader = GradientReader(config, accumulator_latency=self.accumulator.latency)
            summing = self.gradient_reader.latency
        self.gradient = Gradient(config)
        self.updater = SignUpdater(config) if self.signs else Updater(config)
        self.schedule = Schedule(config) if self.signs else None
        self.roi_updater = RoiUpdater(config)
        self.drain = self.roi_filter.latency + self.thinner.latency + 1
        self._feed = self.event_buffer.latency + self.time_scaler.latency + (self.dither.latency if self.dither else 0)
        self._evaluate = summing + self.gradient.latency + self.updater.latency
        self.batch_control = BatchControl(
            config,
            drain=self.drain,
            replay_delay=self._evaluate - self._feed,
            move=self.roi_updater.latency,
            settle=self.roi_updater.settle,
        )

    @property
    def blocks(self):
        """The blocks by name, in the order of data flow."""
        names = (
            "batch_control", "roi_filter", "thinner", "event_buffer", "reciprocal", "dither", "time_scaler", "warp",
            "voter", "accumulator", "gradient_reader", "tagged_accumulator", "one_pass_gradient", "gradient",
            "updater", "schedule", "roi_updater",
        )  # fmt: skip
        return {name: block for name in names if (block := getattr(self, name, None)) is not None}

    @property
    def iteration_latency(self):
        """L: an iteration takes n + P/4 + L cycles with the sweep, n + L in one pass, from one v to the next.

        The sweep's first address follows the last vote by one cycle; what is evaluated is its last address, or
        in one pass the last vote.
        """
        return self.warp.latency + self.voter.latency - 1 + self._evaluate

    @property
    def batch_latency(self):
        """Cycles of a batch that depend on neither N, n nor T."""
        move = self.roi_updater.latency if self.config.buffers == 1 else 1
        return self.drain + self.batch_control.hand_over + self.reciprocal.latency + self._feed + move

    @property
    def shortest_batch(self):
        """Events of the batches that take the longest of all short ones: those with fewer take as long.

        With two buffers, a batch is handed over when the ROI of the next one is known.
        """
        return 0 if self.config.buffers == 1 else self.roi_updater.settle + 2 - self.drain

    def cycles(self, *, events, roi_events, iterations):
        """Clock cycles of a batch: N + T·(n + P/4 + L) + constant; without P/4 in one pass.

        From the cycle in which the first event is offered to the one in which the result is; events offered in every
        cycle, no other batch under way, batch not degenerate, at least :attr:`shortest_batch` events.
        """
        per_iteration = roi_events + self.sweep_cycles + self.iteration_latency
        return max(events, self.shortest_batch) + iterations * per_iteration + self.batch_latency

    @property
    def sweep_cycles(self):
        """P/4 with the sweep, 0 in one pass."""
        return 0 if self.one_pass else self.config.geometry.bank_words

    @property
    def cycle_formula(self):
        """:meth:`cycles` as text."""
        sweep = f" + {self.sweep_cycles}" if self.sweep_cycles else ""
        return f"N + T·(n{sweep} + {self.iteration_latency}) + {self.batch_latency}"

    @property
    def latencies(self):
        """Clock cycles from input to output of each block that the events or the sums go through, by name."""
        return {name: block.latency for name, block in self.blocks.items() if hasattr(block, "latency")}

    def elaborate(self, platform):
        m = Module()
        for name, block in self.blocks.items():
            m.submodules[name] = block
        self._ingest(m)
        self._iterate(m)
        if self.one_pass:
            self._sum_in_one_pass(m)
        else:
            self._sum_by_sweep(m)
        self._ascend(m)
        self._follow(m)
        return m

    def _ingest(self, m):
        """Crop, thin out, store, measure the time range."""
        control, current = self.batch_control, self.settings
        connect(m, wiring.flipped(self.i), control.i)
        connect(m, control.o, self.roi_filter.i)
        connect(m, self.roi_filter.o, self.thinner.i)
        connect(m, self.thinner.o, self.event_buffer.i)
        taken_in = control.taken_in
        m.d.comb += [
            control.settings.eq(self.settings),
            self.roi_filter.start.eq(control.open),
            self.roi_filter.roi.eq(self.roi_updater.roi),
            self.thinner.start.eq(control.open),
            self.thinner.thinning.eq(current.thinning),
            self.thinner.target.eq(current.thin_target),
            self.event_buffer.clear.eq(control.open),
            self.event_buffer.take.eq(control.take),
            taken_in.t_first.eq(self.roi_filter.t_first),
            taken_in.span.eq(self.roi_filter.span),
            taken_in.roi_events.eq(self.event_buffer.count),
            taken_in.outside.eq(self.roi_filter.outside),
            taken_in.overflow.eq(self.event_buffer.overflow),
            taken_in.thinned.eq(self.thinner.thinned),
            taken_in.time_back.eq(self.roi_filter.time_back),
            taken_in.time_span.eq(self.roi_filter.time_span),
            taken_in.roi.eq(self.roi_updater.roi),
            taken_in.roi_next.eq(self.roi_updater.roi_next),
            taken_in.clamped.eq(self.roi_updater.clamped),
            self.reciprocal.start.eq(control.divide),
            self.reciprocal.span.eq(control.batch.span),
            control.divided.eq(self.reciprocal.done),
        ]

    def _iterate(self, m):
        """Replay, scale, warp, vote."""
        path = [self.event_buffer, self.dither, self.time_scaler, self.warp, self.voter]
        path = [block for block in path if block is not None]
        for block, following in itertools.pairwise(path):
            connect(m, block.o, following.i)
        m.d.comb += [
            self.event_buffer.replay.eq(self.batch_control.replay),
            self.time_scaler.span.eq(self.batch_control.batch.span),
            self.time_scaler.shift.eq(self.reciprocal.shift),
            self.time_scaler.mantissa.eq(self.reciprocal.mantissa),
            self.warp.v.eq(self.updater.v),
        ]
        if self.schedule:
            m.d.comb += [self.warp.level.eq(self.schedule.level), self.voter.level.eq(self.schedule.level)]

    def _sum_by_sweep(self, m):
        """The article's way: sweep as soon as the last vote has entered."""
        control, reader = self.batch_control, self.gradient_reader
        voted = Signal()
        m.d.sync += voted.eq(self.voter.o.valid & self.voter.o.payload.last)
        connect(m, self.voter.o, self.accumulator.i)
        connect(m, reader.sweep, self.accumulator.sweep)
        connect(m, self.accumulator.o, reader.i)
        connect(m, reader.o, self.gradient.i)
        m.d.comb += [
            reader.start.eq(voted | control.sweep),
            control.evaluate.eq(reader.sweep.valid & reader.sweep.payload.last),
            control.cleared.eq(reader.o.valid),  # not before: a result must not see the sums of this sweep change
            self.pixels.valid.eq(self.accumulator.o.valid & control.iterating),
            self.pixels.payload.eq(self.accumulator.o.payload),
        ]

    def _sum_in_one_pass(self, m):
        """The sums are complete with the last vote; another tag for the next iteration."""
        control, sums = self.batch_control, self.one_pass_gradient
        connect(m, self.voter.o, self.tagged_accumulator.i)
        connect(m, sums.o, self.gradient.i)
        m.d.comb += [
            sums.votes.valid.eq(self.voter.o.valid),
            sums.votes.payload.eq(self.voter.o.payload),
            sums.steps.eq(self.tagged_accumulator.o),
            self.tagged_accumulator.next_tag.eq(control.updated),
            control.evaluate.eq(self.voter.o.valid & self.voter.o.payload.last),
            control.cleared.eq(self.tagged_accumulator.swept),
        ]

    def _ascend(self, m):
        """The gradient moves v."""
        control = self.batch_control
        current = control.batch.settings
        m.d.comb += [
            self.updater.i.valid.eq(self.gradient.o.valid & control.iterating),
            self.updater.i.payload.eq(self.gradient.o.payload),
            self.updater.new_batch.eq(control.take),
            self.updater.start.eq(current.v_start),
            control.updated.eq(self.updater.done),
        ]
        if not self.signs:
            m.d.comb += [
                self.updater.load.eq(control.start & ~current.start_last),
                self.updater.eta.eq(current.eta),
                control.planned.eq(current.iterations),
            ]
            return
        # Warm only while an object is followed: a new ROI, or a batch that found nothing, begins cold.
        schedule = self.schedule
        tracking = Signal()
        warm = Signal()
        with m.If(control.done):
            m.d.sync += tracking.eq(~control.degenerate)
        m.d.comb += [
            warm.eq(current.start_last & tracking & ~current.roi_load),
            control.planned.eq(Mux(warm, current.warm.count, current.cold.count)),
            self.updater.load.eq(control.start & ~warm),
            self.updater.shift.eq(schedule.shift),
            schedule.new_batch.eq(control.take),
            schedule.load.eq(control.start),
            schedule.first.eq(Mux(warm, current.warm.first, current.cold.first)),
            schedule.advance.eq(self.updater.updating),
            schedule.write.valid.eq(self.schedule_write.valid),
            schedule.write.payload.eq(self.schedule_write.payload),
        ]

    def _follow(self, m):
        """The ROI follows; the result goes out."""
        control, roi = self.batch_control, self.roi_updater
        m.d.comb += [
            roi.new_batch.eq(control.open),
            roi.load.eq(self.settings.roi_load),
            roi.x.eq(self.settings.roi_x),
            roi.y.eq(self.settings.roi_y),
            roi.v.eq(self.updater.v),
            roi.roi_gain.eq(control.batch.settings.roi_gain),
            roi.move.eq(control.move),
            roi.still.eq(control.degenerate),
        ]
        self._result(m)

    def _result(self, m):
        """Nothing of this changes while a result waits."""
        control, batch = self.batch_control, self.batch_control.batch
        result = self.o.payload
        serial = self.config.buffers == 1  # then the ROI has moved already
        flags = {
            Flag.DEGENERATE: control.degenerate,
            Flag.OVERFLOW: batch.overflow != 0,
            Flag.TIME_BACK: batch.time_back != 0,
            Flag.TIME_SPAN: batch.time_span != 0,
            Flag.CUT: batch.cut,
            Flag.SATURATED: self.updater.saturated,
            Flag.ROI_CLAMPED: self.roi_updater.clamped if serial else batch.clamped,
            Flag.SCHEDULE: self.schedule.limited if self.schedule else 0,
            Flag.THINNED: batch.thinned != 0,
        }
        sums = (self.one_pass_gradient if self.one_pass else self.gradient_reader).o
        found = {
            **{f.name: batch[f.name] for f in RESULTS if f.taken_in},
            "v": self.updater.v,
            "roi_next": self.roi_updater.roi_next if serial else batch.roi_next,
            "iterations": control.iterations,
            "sums": sums.payload,
            "cycles": control.cycles,
        }
        m.d.comb += [
            self.o.valid.eq(control.done),
            control.taken.eq(self.o.ready),
            *(result[name].eq(found[name]) for name in result.shape().members if name != "flags"),
            *(result.flags[flag.bit_length() - 1].eq(value) for flag, value in flags.items()),
        ]
        m.d.comb += [
            self.trace.valid.eq(sums.valid & control.iterating),
            self.trace.payload.v.eq(self.updater.v),
            self.trace.payload.sums.eq(sums.payload),
        ]
