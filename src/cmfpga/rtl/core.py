"""The core: events in, velocity and a moving ROI out. One instance tracks one object."""

from amaranth.hdl import Mux, Signal
from amaranth.lib import stream
from amaranth.lib.wiring import In, Out, connect, flipped

from ..config.regions import check_one_region
from ..protocol.flags import Flag
from ..protocol.results import fields_of, thins
from . import Block, payloads
from .arithmetic import is_short
from .ascent.roi_updater import RoiUpdater
from .ingest import connect_front, make_front, write_ports
from .ingest.ingest_control import IngestControl
from .ingest.reciprocal import Reciprocal
from .ingest.roi_filter import RoiFilter
from .ingest.thinner import Thinner
from .iterating import Iterating, boxes_of


class Core(Iterating, Block):
    """Contrast Maximization of batches of events::

        i ─► ingest control ─► filter ─► thinner ─► buffer ─► dither ─► scaler ─► warp ─► voter ─► image
                  │ batch        │ t_1, t_N            ▲ ▲ room           ▲         ▲ v              │ sums
                  ▼              └──► reciprocal ───────│─│────────────────┘         │                ▼
        o ◄── iteration control ─── replay, stride ─────┘ └─── image   ROI ◄─────── ascent ◄────── gradient

    The filter is that of the ROI; in front of it there may be a mask of hot pixels (``hot_pixels``), a filter of
    background activity (``background``), then a ``binning`` and what undistorts. How the image is summed is chosen by
    ``gradient`` (:data:`cmfpga.rtl.image.IMAGES`), how v ascends by ``ascent`` (:data:`cmfpga.rtl.ascent.ASCENTS`);
    there is a dither where ``dither_frac`` is not 0.

    One event per cycle at ingest and in every iteration; one every four cycles in a round of one evaluator. A batch of
    N events, n of them in the ROI, takes exactly :meth:`cycles` clock cycles from the offer of its first event to its
    result.

    Parameters
    ----------
    skips : bool
        Events outside the ROI may come several at once (:func:`payloads.event`), while ``far``.

    Members
    -------
    i : ``In``, stream of :func:`payloads.event`
    o : ``Out``, stream of :func:`payloads.result`
        One per batch; the next batch is accepted when it is taken. ``sums`` are those of the last
        iteration, and mean nothing where the ``DEGENERATE`` flag is set.
    settings : ``In``, :func:`payloads.settings`
        Taken over when a batch's first event is offered to the idle core, one cycle before it is accepted: hold them
        until then.
    roi, far : ``Out``
        :func:`payloads.roi_corner` of the batch that is taken in; as of :class:`~.ingest.ingest_control.IngestControl`.
        Only with ``skips``.
    opened, take : ``Out(1)``
        A batch begins, and takes over its settings; its events are complete. One cycle each.
    trace : ``Out``, flow of :func:`payloads.trace`
        Every iteration's v and sums, for verification.
    pixels : ``Out``, flow of an array of four :func:`payloads.pixel`
        Every iteration's images, for verification. Only where the image has it.
    schedule_write : ``In``, flow of :func:`payloads.schedule_write`
        Fills the table of schedules. Only where the ascent has it.
    mask_write, node_write : ``In``, flows of :func:`payloads.mask_write`, :func:`payloads.node_write`
        Fill the mask of hot pixels and the table that undistorts, whose contents a reset leaves. Only where there is
        one, and while no batch is under way.

    Raises
    ------
    ConfigError
        What the image needs does not hold (:meth:`~cmfpga.rtl.image.image_sums.ImageSums.check`), or the hardware is
        of many regions.
    """

    def __init__(self, config, *, skips=False):
        self.config, self.skips = config, skips
        check_one_region(config)
        self._make_blocks()
        self.image.check(self.iteration_latency)
        members = {
            "i": In(stream.Signature(payloads.event(config, skips))),
            **({"roi": Out(payloads.roi_corner(config)), "far": Out(1)} if skips else {}),
            "o": Out(stream.Signature(payloads.result(config))),
            "settings": In(payloads.settings(config)),
            "opened": Out(1),
            "take": Out(1),
            "trace": Out(payloads.flow(payloads.trace(config))),
        }
        for name, block in (("pixels", self.image), ("schedule_write", self.ascent)):
            if name in block.signature.members:
                members[name] = block.signature.members[name]
        super().__init__(**members, **write_ports(self.front))

    def _make_blocks(self):
        config = self.config
        self.front = make_front(config)
        self.roi_filter = RoiFilter(config, skips=self.skips)
        self.thinner = Thinner(
            payloads.roi_event(config),
            most_stored=config.buffer_events,
            most_events=config.max_batch_events,
            used=payloads.thinning_used(config) if thins(config) else None,
        )
        self.reciprocal = Reciprocal(span_bits=config.span_bits, reciprocal_bits=config.reciprocal_bits)
        self.roi_updater = RoiUpdater(config)
        self._make_iterating(move=self.roi_updater.latency, settle=self.roi_updater.settle)
        # From an event's acceptance until it is counted.
        self.drain = sum(block.latency for block in (*self.front.values(), self.roi_filter, self.thinner)) + 1
        self.ingest_control = IngestControl(config, drain=self.drain, skips=self.skips)

    @property
    def boxes(self):
        """What stands directly in the core, by name, in the order of data flow."""
        first = ("ingest_control", self.front, "roi_filter", "thinner", "event_buffer", "reciprocal", self.path.boxes)
        last = ("image", "gradient", "means", "ascent", "probe", "judge", "roi_updater", "iteration_control")
        return boxes_of(self, *first, *last)

    def elaborate(self, platform):
        m = self._with_boxes()
        batch = self.ingest_control.handover.batch
        self._ingest(m)
        self._iterate(m, batch, self.reciprocal)
        self._scale(m, batch)
        self._ascend(m)
        self._follow(m)
        self._confide(m, batch.roi_events)
        self._result(m)
        return m

    def _ingest(self, m):
        """Filter, undistort, crop, thin out, store, measure the time range."""
        control, opened = self.ingest_control, self.ingest_control.handover.opened
        connect(m, flipped(self.i), control.i)
        clear = control.clear
        connect_front(m, self, control.o, self.roi_filter.i, settings=self.settings, start=opened, clear=clear)
        connect(m, self.roi_filter.o, self.thinner.i)
        connect(m, self.thinner.o, self.event_buffer.i)
        connect(m, self.roi_filter.measured, control.measured)
        connect(m, self.event_buffer.stored, control.stored)
        connect(m, self.roi_updater.corner, control.corner)
        connect(m, control.handover, self.iteration_control.handover)
        m.d.comb += [
            control.settings.eq(self.settings),
            control.thinned.eq(self.thinner.thinned),
            self.roi_filter.start.eq(opened),
            self.roi_filter.roi.eq(self.roi_updater.corner.roi),
            self.thinner.start.eq(opened),
            self.thinner.thinning.eq(self.settings.thinning),
            self.thinner.target.eq(self.settings.thin_target),
            self.event_buffer.clear.eq(opened),
            self.event_buffer.take.eq(control.handover.take),
            self.opened.eq(opened),
            self.take.eq(control.handover.take),
        ]
        if self.skips:
            m.d.comb += [self.roi.eq(self.roi_updater.corner.roi), self.far.eq(control.far)]
        if thins(self.config):
            m.d.comb += [
                self.thinner.halved.eq(self.event_buffer.stored.halved),
                control.thinning_used.eq(self.thinner.used),
            ]

    def _cleared(self, m):
        """Image and cells are clear: who is first waits for the other."""
        if "background_filter" not in self.front:
            return self.image.cleared
        once = Signal()
        m.d.sync += once.eq(once | self.image.cleared)
        return (self.image.cleared | once) & self.front["background_filter"].cleared

    def _scale(self, m, batch):
        """Divide, once a batch; clear the image, once."""
        control, image = self.iteration_control, self.image
        m.d.comb += [
            self.reciprocal.start.eq(control.divide),
            self.reciprocal.span.eq(batch.span),
            control.divided.eq(self.reciprocal.done),
            image.clear.eq(self.ingest_control.clear),
            self.ingest_control.cleared.eq(self._cleared(m)),
        ]
        if hasattr(self, "pixels"):
            m.d.comb += self.pixels.valid.eq(image.pixels.valid & control.iterating)
            m.d.comb += self.pixels.payload.eq(image.pixels.payload)

    def _follow(self, m):
        """The ROI follows v."""
        control, roi = self.iteration_control, self.roi_updater
        m.d.comb += [
            roi.new_batch.eq(self.ingest_control.handover.opened),
            roi.load.eq(self.settings.roi_load),
            roi.x.eq(self.settings.roi_x),
            roi.y.eq(self.settings.roi_y),
            roi.v.eq(self.ascent.v),
            roi.roi_gain.eq(control.run.settings.roi_gain),
            roi.move.eq(control.move),
            roi.still.eq(control.run.degenerate),
        ]

    def _result(self, m):
        """Nothing of this changes while a result waits."""
        control, batch = self.iteration_control, self.ingest_control.handover.batch
        result, sums = self.o.payload, self.image.sums
        # With one buffer the ROI has moved already.
        corner = self.roi_updater.corner if self.config.buffers == 1 else batch
        flags = {
            Flag.DEGENERATE: control.run.degenerate,
            Flag.OVERFLOW: batch.overflow != 0,
            Flag.TIME_BACK: batch.time_back != 0,
            Flag.TIME_SPAN: batch.time_span != 0,
            Flag.CUT: batch.cut,
            Flag.SATURATED: self.ascent.saturated,
            Flag.ROI_CLAMPED: corner.clamped,
            Flag.SCHEDULE: self.ascent.limited,
            Flag.THINNED: batch.thinned != 0,
        }
        found = {
            **{f.name: batch[f.name] for f in fields_of("batch", "region", config=self.config) if f.taken_in},
            "roi_next": corner.roi_next,
            "v": self.ascent.v,
            "iterations": control.iterations,
            "sums": self.means.o if self.rounds else sums.payload,
            "cycles": control.cycles,
        }
        if self.config.confidence:
            flags[Flag.SHORT] = is_short(m, self.ascent.v) & ~control.run.degenerate
            judged = control.run.settings.judge & ~control.run.degenerate
            flags[Flag.DOUBTFUL] = judged & self.judge.doubtful if self.rounds else self.judge.doubtful
            found |= self._found_beside() | {
                "confidence_limit": Mux(judged, control.run.settings.confidence_limit, 0),
                "restarted": self.ascent.restarted,
            }
        m.d.comb += [
            self.o.valid.eq(control.run.done),
            control.taken.eq(self.o.ready),
            *(result[name].eq(found[name]) for name in result.shape().members if name != "flags"),
            *(result.flags[flag.bit_length() - 1].eq(value) for flag, value in flags.items()),
            self.trace.valid.eq(sums.valid & control.iterating),
            self.trace.payload.v.eq(self.ascent.v),
            self.trace.payload.sums.eq(sums.payload),
        ]

    @property
    def batch_latency(self):
        """Cycles of a batch that depend on neither N, n nor T."""
        move = self.roi_updater.latency if self.config.buffers == 1 else 1
        ahead = self.drain + self.iteration_control.hand_over + self.reciprocal.latency
        return ahead + min(self._feed, self._evaluate) + move

    @property
    def shortest_batch(self):
        """Events of the batches that take the longest of all short ones: those with fewer take as long.

        With two buffers, a batch is handed over when the ROI of the next one is known.
        """
        return 0 if self.config.buffers == 1 else self.roi_updater.settle + 2 - self.drain

    def cycles(self, *, events, roi_events, iterations, judge=None):
        """Clock cycles of a batch: N + Σ n_k + T·(sweep + L) + constant.

        n_k events of the batch's n are used in iteration k. ``iterations`` says how many there are, each of which
        uses all n; or it is the plan, a ``ScheduleEntry`` for each. If v's confidence is measured (setting ``judge``,
        by default the configuration's), there are four more, or one for each parameter of another motion than
        translation, which use all n, and :attr:`judge_latency`. From the cycle in which the first event is offered to
        the one in which the result is; events offered in every cycle, no other batch under way, batch not degenerate,
        at least :attr:`shortest_batch` events.
        """
        iterated = self.iterated_cycles(roi_events, iterations, judge)
        return max(events, self.shortest_batch) + iterated + self.batch_latency

    @property
    def cycle_formula(self):
        """:meth:`cycles` as text."""
        return f"N + {self.iterated_formula(self.batch_latency)}"
