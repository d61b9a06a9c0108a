"""Ingest control: takes batches in, and hands them over to the iterations."""

from amaranth.hdl import Module, Mux, Signal, signed
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for
from ...protocol.results import CYCLE_BITS, thins
from .. import Block, payloads
from ..ascent.roi_updater import corner
from .event_buffer import stored
from .roi_filter import measured


def handover(config):
    """Signature between ingest control and iteration control, which meet when a batch has been taken in.

    Members
    -------
    opened
        A batch begins: its first event is offered.
    loads
        Whether it loads its ROI; with ``opened``.
    take
        Its events are complete: it is handed over.
    batch
        :func:`payloads.batch`, from the cycle after ``take``.
    cycles
        Clock cycles since the first event was offered, with ``take``.
    free
        A batch may be handed over.
    settled
        The ROI of the next batch is known.
    finished
        A result is taken.
    """
    return wiring.Signature(
        {
            **dict.fromkeys(("opened", "loads", "take"), Out(1)),
            "batch": Out(payloads.batch(config)),
            "cycles": Out(CYCLE_BITS),
            **dict.fromkeys(("free", "settled", "finished"), In(1)),
        }
    )


#: Events that a batch still takes where those outside the ROI may be dropped at once: of two cycles, and one more.
FAR = 32


class IngestControl(Block):
    """Decides when a batch begins and ends, in a state machine.

    CLEAR
        After a reset: wait until image and cells have been cleared once, because a reset does not clear a RAM.
    OPEN
        Wait for a batch's first event to be offered; take over the settings. One cycle.
    INGEST
        Accept one event per cycle until one is ``last`` or the batch's length is reached.
    DRAIN
        Wait until the last event is counted, then until the iterations are free.
    TAKE
        Hand the batch over. One cycle.
    WAIT
        With one event buffer: until the result is taken.

    Four events, stored a few cycles (``drain``) after they are accepted::

        state     OPEN  INGEST             DRAIN              OPEN, or WAIT
        i.valid   ─┐████████████████████┐_________________________________
        i.ready   ______┌───────────────┐_________________________________
        opened    ─┐____________________________________________________     one cycle before the first is accepted
        take      ___________________________________┌────┐______________     drain + 1 cycles after the last
        batch     ────────────────────────────────────────╳══════════════     until the next take

    Parameters
    ----------
    drain : int
        Cycles from the acceptance of an event until it is counted in the event buffer.
    skips : bool
        Events outside the ROI may come several at once, while ``far``.

    Members
    -------
    i : ``In``, stream of :func:`payloads.event`
    o : ``Out``, flow of :func:`payloads.event`
        The events of the batch.
    settings : ``In``, :func:`payloads.settings`
    measured, stored, thinned, corner : ``In``
        What filter, buffer, thinner and ROI updater say of the batch; ``thinning_used`` too, where the buffer thins.
    clear : ``Out(1)``
        Clear the image, and the cells of the noise filter. One cycle.
    cleared : ``In(1)``
    far : ``Out(1)``
        The batch began before the last cycle, and no number of events ends it within :data:`FAR`. Only with ``skips``.
    handover : ``Out``, :func:`handover`
    """

    def __init__(self, config, *, drain, skips=False):
        self._drain, self._skips = drain, skips
        super().__init__(
            config,
            i=In(stream.Signature(payloads.event(config, skips))),
            o=Out(payloads.flow(payloads.event(config, skips))),
            **({"far": Out(1)} if skips else {}),
            settings=In(payloads.settings(config)),
            measured=In(measured(config)),
            stored=In(stored(config)),
            thinned=In(bits_for(config.max_batch_events)),
            **({"thinning_used": In(payloads.thinning_used(config))} if thins(config) else {}),
            corner=In(corner(config)),
            clear=Out(1),
            cleared=In(1),
            handover=Out(handover(config)),
        )

    def elaborate(self, platform):
        config, handover = self.config, self.handover
        m = Module()
        current = Signal(payloads.settings(config))
        events, cut = Signal(bits_for(config.max_batch_events)), Signal()
        cleared_once = Signal()
        # Registers, so that little stands between an event's arrival and all that hangs on it: a batch may be opened,
        # events are taken in.
        may_open, ingesting = Signal(), Signal()
        timer = Signal(range(self._drain))
        accepts, ends = Signal(), Signal()
        # What the next event will be: the last by number, that of the longest batch. Found when the one before it is
        # accepted, so that no event waits for a comparison.
        left, counted, limit, full = Signal.like(current.batch_events), Signal(), Signal(), Signal()
        # How many more may be accepted, less one, so that none that is may be one too many: those that have been stored
        # are, and those that may yet be. ``count`` tells ``drain`` cycles after an event whether it was stored.
        count, by_roi, reached = self.stored.count, Signal(), Signal()
        room, pending, parity = Signal(signed(len(count) + 1)), Signal(self._drain), Signal()
        m.d.comb += [
            self.o.payload.eq(self.i.payload),
            ends.eq(self.i.payload.last | limit | full),
            accepts.eq(ingesting & ~(by_roi & room[-1])),
            self.i.ready.eq(accepts),
            self.o.valid.eq(self.i.valid & accepts),
            handover.opened.eq(self.i.valid & may_open),
            handover.loads.eq(self.settings.roi_load),
        ]
        stored, number = self.o.valid, 1  # perhaps; of how many events
        if self._skips:
            skip, stored = self.o.payload.skip, self.o.valid & (self.o.payload.skip == 0)
            number = Mux(skip == 0, 1, skip)
            # Those of this cycle are not in it yet.
            many = left[FAR.bit_length() - 1 :].any()
            m.d.sync += self.far.eq(ingesting & (~counted | many) & (events < max(0, config.max_batch_events - FAR)))
        m.d.sync += [
            pending.eq((pending << 1) | stored),
            parity.eq(count[0]),
            reached.eq(by_roi & (count == current.batch_roi_events)),
        ]
        dropped = pending[-1] & (parity == count[0])
        with m.If(dropped ^ stored):
            m.d.sync += room.eq(room + Mux(dropped, 1, -1))
        m.d.sync += [handover.take.eq(0), may_open.eq(0)]
        # Outside the state machine, so that these are the registers' resets and enables, and no logic.
        m.d.sync += handover.cycles.eq(handover.cycles + 1)
        with m.If(handover.opened):
            m.d.sync += [current.eq(self.settings), events.eq(0), cut.eq(0), handover.cycles.eq(1)]
            m.d.sync += [
                left.eq(self.settings.batch_events),
                counted.eq(self.settings.batch_events != 0),
                limit.eq(self.settings.batch_events == 1),
                full.eq(config.max_batch_events == 1),
                by_roi.eq(self.settings.batch_roi_events != 0),
                room.eq(self.settings.batch_roi_events - 1),
                reached.eq(0),
            ]
        with m.Elif(self.o.valid):
            m.d.sync += [events.eq(events + number), cut.eq(full & ~limit & ~self.i.payload.last)]
            m.d.sync += [
                left.eq(left - number),
                limit.eq(counted & (left == 2)),
                full.eq(events == config.max_batch_events - 2),
            ]
        with m.If(handover.take):
            known = {
                **{name: getattr(self.measured, name) for name in self.measured.signature.members},
                **{name: getattr(self.corner, name) for name in self.corner.signature.members},
                "settings": current,
                "events": events,
                "cut": cut,
                "roi_events": self.stored.count,
                "overflow": 0,
                "thinned": self.thinned,
            }
            if thins(config):
                known |= {"thinned": self.thinned + self.stored.thinned, "thinning_used": self.thinning_used}
            else:
                known["overflow"] = self.stored.overflow
            m.d.sync += [handover.batch[name].eq(known[name]) for name in handover.batch.shape().members]
        with m.FSM(name="ingest"):
            with m.State("CLEAR"):
                m.d.comb += self.clear.eq(~cleared_once)
                m.d.sync += cleared_once.eq(1)
                with m.If(self.cleared):
                    m.d.sync += may_open.eq(handover.settled)
                    m.next = "OPEN"
            with m.State("OPEN"):
                m.d.sync += may_open.eq(handover.settled)
                with m.If(handover.opened):
                    m.d.sync += [may_open.eq(0), ingesting.eq(1)]
                    m.next = "INGEST"
            with m.State("INGEST"):
                m.d.sync += timer.eq(self._drain - 1)
                with m.If(self.o.valid):
                    with m.If(ends):
                        m.d.sync += ingesting.eq(0)
                        m.next = "DRAIN"
                with m.Elif(reached):
                    m.d.sync += [timer.eq(0), ingesting.eq(0)]
                    m.next = "DRAIN"
            with m.State("DRAIN"):
                m.d.sync += timer.eq(Mux(timer == 0, 0, timer - 1))
                with m.If((timer == 0) & handover.free & handover.settled):
                    m.d.sync += handover.take.eq(1)
                    m.next = "TAKE"
            with m.State("TAKE"):  # a register, because many wait for it
                m.d.sync += may_open.eq(handover.settled if config.buffers == 2 else 0)
                m.next = "WAIT" if config.buffers == 1 else "OPEN"
            if config.buffers == 1:
                with m.State("WAIT"):
                    with m.If(handover.finished):
                        m.d.sync += may_open.eq(handover.settled)
                        m.next = "OPEN"
        return m
