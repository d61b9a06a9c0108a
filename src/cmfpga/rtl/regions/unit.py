"""Unit: the iterating half of a core, for one region after the other."""

from amaranth.hdl import Signal
from amaranth.lib import stream
from amaranth.lib.wiring import In, Out

from ...protocol.flags import Flag
from ...protocol.results import thins
from .. import Block
from .. import payloads as common
from ..arithmetic import delay
from ..iterating import Iterating, boxes_of
from . import payloads


class Unit(Iterating, Block):
    """Takes a region's events and its job, iterates, and offers what came of it; meanwhile the next region is loaded.

    An event per cycle in, and an event per cycle in every iteration, which takes :attr:`iteration_latency` cycles more.
    From the hand-over of a region to its outcome it takes exactly :meth:`cycles` clock cycles.

    Members
    -------
    ready : ``Out(1)``
        A region may begin to be loaded.
    idle : ``Out(1)``
        None is iterated, and none waits for it.
    begin : ``In(1)``
        One begins to be loaded. No event in this cycle.
    i : ``In``, flow of :func:`~cmfpga.rtl.payloads.roi_event`
        Its events; those that come while none is loaded are another unit's.
    commit : ``In(1)``
        It is complete, at least two cycles after its last event.
    job : ``In``, :func:`payloads.job`
        With ``commit``.
    times : ``In``, :func:`payloads.times`
        With ``commit``.
    clear : ``In(1)``, cleared : ``Out(1)``
        Clear the image once, after a reset; it is clear from a pulse of ``cleared`` on.
    o : ``Out``, stream of :func:`payloads.outcome`
    schedule_write : ``In``, flow of :func:`~cmfpga.rtl.payloads.schedule_write`
    trace : ``Out``, flow of :func:`payloads.region_trace`
        Every iteration's v and sums, for verification.
    """

    _divide = 2  # cycles in place of a division

    def __init__(self, config):
        self.config = config
        self._make_iterating(verdict=False)
        self.image.check(self.iteration_latency)
        super().__init__(
            **dict.fromkeys(("ready", "idle", "cleared"), Out(1)),
            **dict.fromkeys(("begin", "commit", "clear"), In(1)),
            i=In(common.flow(common.roi_event(config))),
            job=In(payloads.job(config)),
            times=In(payloads.times(config)),
            o=Out(stream.Signature(payloads.outcome(config))),
            schedule_write=In(common.flow(common.schedule_write(config))),
            trace=Out(common.flow(payloads.region_trace(config))),
        )

    @property
    def boxes(self):
        """What stands directly in the unit, by name, in the order of data flow."""
        last = ("image", "gradient", "means", "ascent", "probe", "judge", "iteration_control")
        return boxes_of(self, "event_buffer", self.path.boxes, *last)

    @property
    def region_latency(self):
        """Cycles of a region that depend on neither n nor T."""
        return self.iteration_control.hand_over + self._divide + min(self._feed, self._evaluate)

    def cycles(self, *, roi_events, iterations, judge=None):
        """Clock cycles from the hand-over of a region to its outcome, unless it is degenerate.

        Parameters are those of :meth:`cmfpga.rtl.core.Core.cycles`.
        """
        return self.iterated_cycles(roi_events, iterations, judge) + self.region_latency

    def elaborate(self, platform):
        m = self._with_boxes()
        self._load(m)
        self._iterate(m, self._times, self._times)
        self.path.look_from(m, self._job)
        self._ascend(m)
        self._confide(m, self.iteration_control.handover.batch.roi_events)
        self._say(m)
        return m

    def _load(self, m):
        """Fill the other buffer, then hand the region over."""
        control, buffer, handover = self.iteration_control, self.event_buffer, self.iteration_control.handover
        loading, waiting, take = Signal(), Signal(), Signal()
        job, batch = Signal(payloads.job(self.config)), Signal(handover.batch.shape())
        halved = Signal(common.thinning_used(self.config), reset_less=True)
        times, self._times = (Signal(payloads.times(self.config), name=name) for name in ("times_next", "times_now"))
        self._job = Signal(payloads.job(self.config))
        self._thinning, self._overflow = Signal.like(halved), Signal.like(job.found)
        m.d.comb += [
            buffer.i.valid.eq(self.i.valid & loading),
            buffer.i.payload.eq(self.i.payload),
            buffer.clear.eq(self.begin),
            buffer.take.eq(take),
            handover.take.eq(take),
            handover.batch.eq(batch),
            # Once for all regions of a batch, elsewhere; but the schedule has to be looked up.
            control.divided.eq(delay(m, control.divide, self._divide, name="divide", valid=True)),
            self.ready.eq(~(loading | waiting | take)),
            self.idle.eq(handover.free & ~(waiting | take)),
            self.image.clear.eq(self.clear),
            self.cleared.eq(self.image.cleared),
        ]
        with m.If(self.begin):
            m.d.sync += loading.eq(1)
        with m.If(self.commit):
            m.d.sync += [loading.eq(0), waiting.eq(1), job.eq(self.job), times.eq(self.times)]
        m.d.sync += take.eq(0)
        with m.If(waiting & handover.free & ~take):
            m.d.sync += [take.eq(1), waiting.eq(0)]
        if thins(self.config):
            with m.If(self.begin):
                m.d.sync += halved.eq(1)
            with m.Elif(buffer.stored.halved):
                m.d.sync += halved.eq(halved << 1)
        with m.If(take):
            m.d.sync += [
                self._job.eq(job),
                self._times.eq(times),
                batch.settings.eq(job.settings),
                batch.roi_events.eq(buffer.stored.count),
                batch.span.eq(times.span),
                self._thinning.eq(halved),
            ]
            if not thins(self.config):
                m.d.sync += self._overflow.eq(buffer.stored.overflow)
        self._batch = batch

    def _say(self, m):
        """Nothing of this changes while an outcome waits."""
        control, o, job, sums = self.iteration_control, self.o.payload, self._job, self.image.sums
        thinned, is_thinned, overflows = Signal.like(o.thinned), Signal(), Signal()
        # Registers: known long before the outcome.
        m.d.sync += [
            thinned.eq(job.found - self._batch.roi_events - self._overflow),
            is_thinned.eq(thinned != 0),
            overflows.eq(self._overflow != 0),
        ]
        thinning = delay(m, self._thinning << job.stride, 1, name="thinning")
        flags = {
            Flag.DEGENERATE: control.run.degenerate,
            Flag.OVERFLOW: overflows,
            Flag.SATURATED: self.ascent.saturated,
            Flag.SCHEDULE: self.ascent.limited,
            Flag.THINNED: is_thinned,
        }
        found = {
            "number": job.number,
            "turn": job.turn,
            "degenerate": control.run.degenerate,
            "v": self.ascent.v,
            "roi_events": self._batch.roi_events,
            "overflow": self._overflow,
            "thinned": thinned,
            "thinning_used": thinning,
            "iterations": control.iterations,
            "sums": self.means.o if self.rounds else sums.payload,
            "cycles": control.cycles,
        }
        if self.config.confidence:
            if self.judge:
                flags[Flag.DOUBTFUL] = self.judge.doubtful
            judged = control.run.settings.judge & ~control.run.degenerate
            found |= self._found_beside() | {
                "confidence_limit": self._batch.settings.confidence_limit & judged.replicate(len(o.confidence_limit)),
                "restarted": job.restarted & ~control.run.degenerate,
            }
        m.d.comb += [
            self.o.valid.eq(control.run.done),
            control.taken.eq(self.o.ready),
            *(o[name].eq(found[name]) for name in o.shape().members if name in found),
            *(o.flags[flag.bit_length() - 1].eq(value) for flag, value in flags.items()),
            o.outside.eq(job.found),  # those inside; the collector knows how many there are
            self.trace.valid.eq(sums.valid & control.iterating),
            self.trace.payload.region.eq(job.number),
            self.trace.payload.v.eq(self.ascent.v),
            self.trace.payload.sums.eq(sums.payload),
        ]
