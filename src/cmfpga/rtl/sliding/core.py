"""The core whose windows slide: events in, velocity and a moving ROI out, again and again."""

from types import SimpleNamespace

from amaranth.hdl import Cat, Mux, Shape, Signal
from amaranth.lib import data, stream
from amaranth.lib.fifo import SyncFIFO
from amaranth.lib.wiring import In, Out, connect, flipped

from ...protocol.flags import Flag
from ...protocol.results import fields_of
from .. import Block, payloads
from ..arithmetic import delay, is_short
from ..ingest import connect_front, make_front, write_ports
from ..ingest.reciprocal import Reciprocal
from ..iterating import Iterating, boxes_of
from .hop_control import HopControl
from .hop_evaluation import AFTER, HopEvaluation
from .roi_carrier import RoiCarrier
from .walker import Walker

#: Result fields of batches that are always 0 here: a ring drops the oldest, and a doubtful window restarts nothing.
NOTHING = ("overflow", "time_span", "restarted")


class SlidingCore(Iterating, Block):
    """Contrast Maximization of the newest events, as :mod:`cmfpga.reference.integer.sliding` says::

        i ─► hop control ─► ring ─► placer ─► scaler ─► evaluators ─► images
               ▲      │       ▲        ▲         ▲          ▲ v         │ sums
               │ crop │ hop   │ b      │ corner  │ unit     │           ▼
               │      ▼       │        │         │        ascent ◄── gradient
               │    walker ───┘      ROI carrier ┴ reciprocal │
               └─────────────────────────┴────────────────────┘
        o ◄── hop evaluation: replay, round, result

    One event a cycle at the input, while others are replayed. An event waits only if a hop would close before the last
    one is evaluated, or if the ring has no place. A result comes :attr:`tail` cycles after its hop's end, whatever the
    window holds, if the round that follows the writes has caught up by then. A window of n events that starts when its
    hop has ended takes :meth:`cycles`. In front of hop control may stand what :mod:`cmfpga.rtl.ingest` has, and
    then a FIFO, because hop control may let an event wait, and these blocks may not.

    Parameters
    ----------
    config : Config
        ``windows`` is ``sliding``.

    Members
    -------
    i : ``In``, stream of :func:`payloads.event`
        ``last`` is not looked at.
    o : ``Out``, stream of :func:`payloads.result`
        One of each hop; evaluations wait until it is taken.
    settings : ``In``, :func:`payloads.settings`
        Taken over with the first event after a reset, in the cycle of ``begins``. From then on only
        :data:`~cmfpga.protocol.settings.LENGTHS` are looked at. They may change while ``busy`` is low and no event is
        offered: the hop under way closes as it would have, and the next one has them.
    trace : ``Out``, flow of :func:`payloads.trace`
        Every round's v and sums, for verification; not of the one that judges.
    begins : ``Out(1)``
    busy : ``Out(1)``
        An event waits, or the result of a hop that has closed.
    schedule_write : ``In``, flow of :func:`payloads.schedule_write`
        Fills the table of schedules, before the first event.
    mask_write, node_write : ``In``, flows of :func:`payloads.mask_write`, :func:`payloads.node_write`
        As of :class:`~cmfpga.rtl.core.Core`; before the first event.
    """

    def __init__(self, config):
        self.config = config
        self.hop_control, self.walker, self.roi_carrier = HopControl(config), Walker(config), RoiCarrier(config)
        self.reciprocal = Reciprocal(span_bits=config.span_bits, reciprocal_bits=config.reciprocal_bits)
        self.front, self.queue = make_front(config), None
        if self.front:
            width = Shape.cast(payloads.undistorted_event(config)).width
            self.queue = SyncFIFO(width=width, depth=sum(block.latency for block in self.front.values()) + 4)
            self.waiting = Signal()
        self._make_iterating()
        self.image.check(self.iteration_latency)
        super().__init__(
            i=In(stream.Signature(payloads.event(config))),
            o=Out(stream.Signature(payloads.result(config))),
            settings=In(payloads.settings(config)),
            trace=Out(payloads.flow(payloads.trace(config))),
            **dict.fromkeys(("begins", "busy"), Out(1)),
            schedule_write=self.ascent.signature.members["schedule_write"],
            **write_ports(self.front),
        )

    def _make_control(self, move, settle):
        return HopEvaluation(self.config, replay_delay=self._replay_delay, move=self.roi_carrier.latency + 1)

    @property
    def tail(self):
        """Clock cycles from the end of a hop to its result, if its only round has caught up with the writes.

        One evaluator takes an event every four cycles, and may have begun one when the last comes: up to 3 fewer.
        """
        ring, turns = self.event_buffer, 1 << self.config.geometry.turn_bits
        latency = ring.write_latency + ring.latency + self.path.latency + self._evaluate + self.roi_carrier.latency
        return latency + 2 + 3 * (turns - 1)

    @property
    def _beside(self):
        """Cycles of :meth:`cycles` that depend on neither n nor T."""
        move = max(self.roi_carrier.latency + 1, self.judge_latency + 1)
        return 6 + self.reciprocal.latency + min(self._feed, self._evaluate) + move + 1

    def cycles(self, *, roi_events, iterations, events=0, judge=None):
        """Clock cycles from the end of a hop to its result, if all its rounds begin then: T·(n + L) + constant.

        ``events`` counts for nothing, because they are taken in before. For the other parameters see
        :meth:`~cmfpga.rtl.iterating.Iterating.iterated_cycles`.
        """
        count = iterations if isinstance(iterations, int) else len(iterations)
        votes = roi_events << self.config.geometry.turn_bits
        return count * (votes + self.iteration_latency) + self._beside

    @property
    def cycle_formula(self):
        """:meth:`cycles` as text."""
        events = "4·n" if self.config.geometry.turn_bits else "n"
        return f"T·({events} + {self.iteration_latency}) + {self._beside}"

    @property
    def boxes(self):
        """What stands directly in the core, by name, in the order of data flow."""
        first = (self.front, "hop_control", "event_buffer", "walker", "reciprocal", self.path.boxes)
        last = ("image", "gradient", "means", "ascent", "judge", "roi_carrier", "iteration_control")
        return boxes_of(self, *first, *last)

    def elaborate(self, platform):
        m = self._with_boxes()
        hop = self._take_in(m)
        control, walker, carrier = self.iteration_control, self.walker, self.roi_carrier
        settings, unit = control.run.settings, control.unit
        self._iterate(m, SimpleNamespace(span=unit), self.reciprocal)
        self._ascend(m)
        self._confide(m, hop.count)

        # The crops of the hop that is evaluated, and of the one that is taken in; where the image lies.
        crop, cropped, corner = (
            Signal(payloads.roi_corner(self.config), name=name) for name in ("crop", "cropped", "at")
        )
        with m.If(self.hop_control.closed):
            m.d.sync += cropped.eq(crop)
        with m.If(self.hop_control.closed | control.load | ~control.opened):
            m.d.sync += crop.eq(carrier.next_crop)
        with m.If(control.run.start & (control.run.plan != AFTER)):
            m.d.sync += corner.eq(Mux(control.cold, cropped, carrier.image))
        placer, scaler = self.path.blocks["placer"], self.path.blocks["time_scaler"]
        limits = {"x": self.config.geometry.roi_x_max, "y": self.config.geometry.roi_y_max}
        wanted = {axis: settings[f"roi_{axis}"] for axis in "xy"}
        loaded = {axis: Mux(settings.roi_load, Mux(wanted[axis] > most, most, wanted[axis]), 0)
                  for axis, most in limits.items()}  # fmt: skip
        moves = delay(m, settings.roi_gain != 0, 1, name="moves")
        m.d.comb += [
            self.reciprocal.start.eq(control.divide),
            self.reciprocal.span.eq(unit),
            control.divided.eq(self.reciprocal.done),
            placer.start.eq(control.replay),
            placer.phase_x.eq(walker.phase_x),
            placer.phase_y.eq(walker.phase_y),
            placer.t_first.eq(hop.t_first),
            placer.corner.eq(corner),
            scaler.i.payload.t.eq(Mux(placer.o.valid, placer.o.payload.t, control.since)),
            carrier.load.eq(control.load),
            carrier.move.eq(control.move & moves),
            carrier.cold.eq(control.cold),
            carrier.v.eq(self.ascent.v),
            carrier.since.eq(scaler.o.payload.dt),
            *(carrier.crop[axis].eq(Mux(control.opened, cropped[axis], loaded[axis])) for axis in "xy"),
        ]
        late, is_late = Signal.like(hop.count), Signal()  # a cycle after the event
        m.d.sync += is_late.eq(placer.o.valid & (placer.o.payload.t > unit))
        with m.If(control.replay):
            m.d.sync += late.eq(0)
        with m.Elif(is_late):
            m.d.sync += late.eq(late + 1)
        outside = settings.roi_load & ((wanted["x"] > limits["x"]) | (wanted["y"] > limits["y"]))
        self._result(m, hop, corner, cropped, late, outside, moves)
        return m

    def _take_in(self, m):
        """Hop control, ring and walker; what is known of the hop, as :func:`.hop_evaluation.hop` has it."""
        hops, ring, walker, control = self.hop_control, self.event_buffer, self.walker, self.iteration_control
        lengths, hop, settings = Signal(hops.lengths.shape()), control.hop, control.run.settings
        connect(m, hops.o, ring.i)
        cleared, clear = self._once(m, self.image.cleared), ~self._once(m, 1)
        if "background_filter" in self.front:
            cleared &= self.front["background_filter"].cleared
        m.d.comb += [
            *(lengths[name].eq(settings[name]) for name in lengths.shape().members),
            hops.lengths.eq(lengths),
            walker.lengths.eq(lengths),
            hops.thinning.eq(settings.thinning),
            *self._pass(m, control.opened, clear),
            hops.corner.eq(self.roi_carrier.next_crop),
            hops.free.eq(control.free),
            hops.oldest.eq(walker.begin),
            walker.closed.eq(hops.closed),
            walker.go.eq(control.walk),
            walker.end.eq(hops.end),
            walker.now.eq(hops.now),
            walker.stale.eq(hops.stale),
            walker.t.eq(ring.o.payload.t),
            ring.look.eq(walker.look),
            ring.first.eq(walker.begin),
            ring.end.eq(hops.end),
            ring.closed.eq(control.closed),
            control.offered.eq(self.i.valid),
            control.cleared.eq(cleared),
            self.image.clear.eq(clear),
            control.given.eq(self.settings),
            self.begins.eq(control.begins),
            control.walked.eq(walker.done),
            control.summed.eq(self.means.done),
            control.drained.eq(ring.idle),
            hop.closed.eq(hops.closed),
            hop.now.eq(hops.now),
            hop.step.eq(hops.step),
            hop.stale.eq(hops.stale),
            hop.empty.eq(walker.empty),
        ]
        # The first event that was stored after a hop had closed begins a window that is empty by then. None comes in
        # the two cycles after ``closed``, so that times are kept in the first of them.
        seen, ends, kept = Signal(), delay(m, hops.closed, 1, name="ends", valid=True), Signal()
        first_new, newest = (Signal.like(hop.t_first, name=n) for n in ("new", "newest"))
        with m.If(hops.o.valid):
            m.d.sync += newest.eq(hops.o.payload.t)
        with m.If(hops.o.valid & ~seen):
            m.d.sync += first_new.eq(hops.o.payload.t)
        m.d.sync += [seen.eq((seen | hops.o.valid) & ~hops.closed), kept.eq(ends | (kept & ~walker.done))]
        with m.If(ends):
            m.d.sync += hop.t_last.eq(newest)
        with m.If(walker.done | ~kept):
            m.d.sync += hop.t_first.eq(Mux(walker.empty, first_new, walker.t_first))
        m.d.sync += hop.count.eq(hops.end - walker.begin)
        return hop

    def _pass(self, m, opened, clear):
        """From the input to hop control: at once, or through what stands in front of it."""
        hops, control, queue = self.hop_control, self.iteration_control, self.queue
        if queue is None:
            return [
                hops.i.valid.eq(self.i.valid & opened),
                hops.i.payload.eq(self.i.payload),
                self.i.ready.eq(hops.i.ready & opened),
            ]
        m.submodules.queue = queue
        taken, come = (
            payloads.flow(shape(self.config)).create() for shape in (payloads.event, payloads.undistorted_event)
        )
        connect_front(m, self, taken, flipped(come), settings=control.run.settings, start=control.load, clear=clear)
        # Events on their way have a place in the queue already.
        count = Signal(range(queue.depth + 1))
        m.d.sync += count.eq(count + (self.i.valid & self.i.ready) - (hops.i.valid & hops.i.ready))
        m.d.comb += self.waiting.eq(count != 0)
        return [
            taken.valid.eq(self.i.valid & self.i.ready),
            taken.payload.eq(self.i.payload),
            self.i.ready.eq(opened & (count != queue.depth)),
            queue.w_en.eq(come.valid),
            queue.w_data.eq(come.payload),
            hops.i.valid.eq(queue.r_rdy),
            hops.i.payload.eq(queue.r_data),
            queue.r_en.eq(hops.i.ready),
        ]

    def _once(self, m, value):
        """From the cycle after ``value`` was high on."""
        been = Signal()
        m.d.sync += been.eq(been | value)
        return been

    def _result(self, m, hop, corner, cropped, late, outside, moves):
        """Nothing of this changes while a result waits."""
        control, hops, config, sums = self.iteration_control, self.hop_control, self.config, self.image.sums
        settings, counts, result = control.run.settings, hops.counts, self.o.payload
        degenerate, first = control.degenerate, Signal(init=1)
        pending = Signal()
        with m.If(control.taken):
            m.d.sync += first.eq(0)
        m.d.sync += pending.eq(hops.closed | (pending & ~control.taken))
        busy = hops.waits | hops.closed | pending
        m.d.comb += self.busy.eq(busy | self.waiting if self.front else busy)
        moved = ~degenerate & moves
        flags = {
            Flag.DEGENERATE: degenerate,
            Flag.TIME_BACK: counts.time_back != 0,
            Flag.SATURATED: self.ascent.saturated & ~degenerate,
            Flag.ROI_CLAMPED: (self.roi_carrier.clamped & moved) | (first & outside),
            Flag.SCHEDULE: self.ascent.limited & ~degenerate,
            Flag.THINNED: counts.thinned != 0,
        }
        own = {"sums": self.means.o}
        if config.confidence:
            own |= {"sum_squares": self.means.o_squares, "curvature": self.ascent.curvature}
        shape = data.StructLayout({name: result.shape()[name].shape for name in own} | {"doubtful": 1})
        kept, found = Signal(shape), Signal(shape)
        m.d.comb += [found[name].eq(value) for name, value in own.items()]
        if config.confidence:
            m.d.comb += found.doubtful.eq(self.judge.doubtful)
        with m.If(control.keep):
            m.d.sync += kept.eq(found)
        # The highest bits of the window's first time are those of its end, or one less.
        before = (hop.now - hop.t_first)[-1]
        values = {
            "t_first": Cat(hop.t_first, hops.now[config.span_bits :] - before),
            "span": Mux(degenerate, 0, control.unit),
            "t_us": hops.now,
            **{name: counts[name] for name in counts.shape().members},
            "roi_events": hop.count,
            "late": Mux(degenerate, 0, late),
            "roi": Mux(degenerate, cropped, corner),
            "roi_next": self.roi_carrier.next_crop,
            "v": self.ascent.v,
            "iterations": Mux(degenerate, 0, control.iterations),
            "cycles": control.cycles,
            **{name: kept[name] for name in own},
        }
        if config.confidence:
            judged = settings.judge & ~degenerate
            flags[Flag.DOUBTFUL] = judged & kept.doubtful
            flags[Flag.SHORT] = is_short(m, self.ascent.v) & ~degenerate
            values |= {"confidence_limit": Mux(judged, settings.confidence_limit, 0)}
        there = {f.name for f in fields_of("batch", "region", config=config)}
        if missing := there - {*values, *NOTHING, "flags"}:
            raise NotImplementedError(f"result fields without a value where windows slide: {', '.join(missing)}")
        m.d.comb += [
            self.o.valid.eq(control.run.done),
            control.taken.eq(self.o.ready & control.run.done),
            *(result[name].eq(values[name]) for name in values if name in there),
            *(result.flags[flag.bit_length() - 1].eq(value) for flag, value in flags.items()),
            self.trace.valid.eq(sums.valid & control.iterating & (control.run.plan != AFTER)),
            self.trace.payload.v.eq(self.ascent.v),
            self.trace.payload.sums.eq(sums.payload),
        ]
