"""Batch control: takes batches in, runs their iterations, hands their results out."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from ..fixed import bits_for
from ..protocol.results import CYCLE_BITS
from . import payloads
from .arithmetic import delay


class BatchControl(wiring.Component):
    """Sequences the core with two state machines, which meet when a batch has been taken in.

    Ingest:

    CLEAR
        After a reset: wait until the banks have been swept once, because a reset does not clear a RAM.
    OPEN
        Wait for a batch's first event to be offered; take over the settings. One cycle.
    INGEST
        Accept one event per cycle until one is ``last`` or the batch's length is reached.
    DRAIN
        Wait until the last event is counted, then until the iterations are free.
    WAIT
        With one event buffer: until the result is taken.

    Iterations:

    IDLE, JUDGE
        Wait for a batch; a degenerate one goes to RESULT.
    DIVIDE
        Wait for the reciprocal.
    ITERATE
        Replay the buffer T times. Each replay is started while the iteration before is still being
        evaluated, so that its first event meets the new v in the cycle in which v appears.
    MOVE
        With one event buffer: wait for the ROI's update.
    RESULT
        Offer the result until it is taken.

    With two buffers the ROI's update waits until the next batch has been opened, however long that takes: what a
    batch is cropped with never depends on how fast events arrive.

    Parameters
    ----------
    config : Config
    drain : int
        Cycles from the acceptance of an event until it is counted in the event buffer.
    replay_delay : int
        Cycles from ``evaluate`` to the next replay.
    move, settle : int
        Cycles of the ROI's update, and until the next ROI is known after it.

    Members
    -------
    i : ``In``, stream of :func:`payloads.event`
    o : ``Out``, flow of :func:`payloads.event`
        The events of the batch.
    settings : ``In``, :func:`payloads.settings`
    taken_in : ``In``, :func:`payloads.batch`
        What the ingest's blocks say of the batch; ``events``, ``settings`` and ``cut`` are filled in here.
    batch : ``Out``, :func:`payloads.batch`
        The batch whose iterations run.
    open, take, divide, start, replay, move, sweep : ``Out(1)``
        Begin a batch; its events are complete; begin the division; load v; replay the event buffer; move the ROI;
        clear the banks (after a reset). One cycle each.
    planned : ``In``
        Iterations of the batch.
    divided, evaluate, updated, cleared : ``In(1)``
        The division is done; all that the next v needs is on its way; v is updated; the banks are swept.
    iterating : ``Out(1)``
        Updates of v count.
    iterations, cycles : ``Out``
        Iterations done, clock cycles since the first event was offered.
    degenerate : ``Out(1)``
    done : ``Out(1)``
        The result is valid.
    taken : ``In(1)``
        The result is taken.
    """

    def __init__(self, config, *, drain, replay_delay, move, settle):
        if replay_delay < 0:
            raise ValueError(f"the replay would have to start {-replay_delay} cycles before the last event is counted")
        self.config = config
        self._drain, self._replay_delay, self._move, self._settle = drain, replay_delay, move, settle
        super().__init__(
            {
                "i": In(stream.Signature(payloads.event(config))),
                "o": Out(payloads.flow(payloads.event(config))),
                "settings": In(payloads.settings(config)),
                "taken_in": In(payloads.batch(config)),
                "batch": Out(payloads.batch(config)),
                **dict.fromkeys(("open", "take", "divide", "start", "replay", "move", "sweep"), Out(1)),
                "planned": In(config.widths.iteration_bits),
                **dict.fromkeys(("divided", "evaluate", "updated", "cleared"), In(1)),
                "iterating": Out(1),
                "iterations": Out(config.widths.iteration_bits),
                "cycles": Out(CYCLE_BITS),
                "degenerate": Out(1),
                "done": Out(1),
                "taken": In(1),
            }
        )

    #: Cycles between the last event's count and the division: hand over, judge.
    hand_over = 1

    def elaborate(self, platform):
        m = Module()
        idle = Signal()  # the iterations are free
        unsettled = Signal()  # the next ROI is not known yet
        ingest_cycles = Signal(CYCLE_BITS, reset_less=True)
        self._ingest(m, idle, unsettled, ingest_cycles)
        self._iterate(m, idle, ingest_cycles)
        if self.config.buffers == 2:
            self._move_later(m, unsettled)
        return m

    def _ingest(self, m, idle, unsettled, cycles):
        config = self.config
        current = Signal(payloads.settings(config))
        events, cut = Signal(bits_for(config.max_batch_events), name="events"), Signal()
        swept = Signal()
        timer = Signal(range(self._drain), name="drain_timer")
        full, limit, roi_limit, ends, may_accept = Signal(), Signal(), Signal(), Signal(), Signal()
        accepted = events + 1
        # Events that have been accepted but may yet be stored. None is accepted if they could be one too many.
        pending = Signal(self._drain)
        m.d.sync += pending.eq((pending << 1) | self.o.valid)
        by_roi = current.batch_roi_events != 0
        waiting = sum(pending[1:], pending[0])
        m.d.comb += [
            self.o.payload.eq(self.i.payload),
            full.eq(accepted == config.max_batch_events),
            limit.eq(accepted == current.batch_events),
            ends.eq(self.i.payload.last | limit | full),
            may_accept.eq(~by_roi | (self.taken_in.roi_events + waiting < current.batch_roi_events)),
            roi_limit.eq(by_roi & (self.taken_in.roi_events == current.batch_roi_events)),
        ]
        # Outside the state machine, so that these are the registers' resets and enables, and no logic.
        m.d.sync += cycles.eq(cycles + 1)
        with m.If(self.open):
            m.d.sync += [current.eq(self.settings), events.eq(0), cut.eq(0), cycles.eq(1)]
        with m.Elif(self.o.valid):
            m.d.sync += [events.eq(accepted), cut.eq(full & ~limit & ~self.i.payload.last)]
        with m.If(self.take):
            m.d.sync += [
                self.batch.eq(self.taken_in),
                self.batch.settings.eq(current),
                self.batch.events.eq(events),
                self.batch.cut.eq(cut),
            ]
        with m.FSM(name="ingest"):
            with m.State("CLEAR"):
                m.d.comb += self.sweep.eq(~swept)
                m.d.sync += swept.eq(1)
                with m.If(self.cleared):
                    m.next = "OPEN"
            with m.State("OPEN"):
                with m.If(self.i.valid & ~unsettled):
                    m.d.comb += self.open.eq(1)
                    m.next = "INGEST"
            with m.State("INGEST"):
                m.d.comb += [self.i.ready.eq(may_accept), self.o.valid.eq(self.i.valid & may_accept)]
                m.d.sync += timer.eq(self._drain - 1)
                with m.If(self.o.valid):
                    with m.If(ends):
                        m.next = "DRAIN"
                with m.Elif(roi_limit):
                    m.d.sync += timer.eq(0)
                    m.next = "DRAIN"
            with m.State("DRAIN"):
                m.d.sync += timer.eq(Mux(timer == 0, 0, timer - 1))
                with m.If((timer == 0) & idle & ~unsettled):
                    m.d.comb += self.take.eq(1)
                    m.next = "WAIT" if config.buffers == 1 else "OPEN"
            if config.buffers == 1:
                with m.State("WAIT"):
                    with m.If(self.done & self.taken):
                        m.next = "OPEN"

    def _iterate(self, m, idle, ingest_cycles):
        config = self.config
        batch = self.batch
        timer = Signal(range(max(2, self._move)), name="move_timer")
        too_few, final = Signal(), Signal()
        m.d.comb += [
            too_few.eq(
                (batch.roi_events == 0)
                | (batch.roi_events < batch.settings.min_roi_events)
                | (batch.span == 0)
                | (self.planned == 0)
            ),
            final.eq(self.iterations + 1 == self.planned),
        ]
        next_replay = delay(
            m, self.evaluate & self.iterating & ~final, self._replay_delay, name="next_replay", valid=True
        )
        m.d.sync += self.cycles.eq(Mux(idle, ingest_cycles, self.cycles) + 1)
        with m.FSM(name="iterate"):
            with m.State("IDLE"):
                m.d.comb += idle.eq(1)
                m.d.sync += self.iterations.eq(0)
                with m.If(self.take):
                    m.next = "JUDGE"
            with m.State("JUDGE"):
                m.d.sync += self.degenerate.eq(too_few)
                with m.If(too_few):
                    m.next = "RESULT"
                with m.Else():
                    # Only then: a division that nobody waits for would still run in the next batch.
                    m.d.comb += self.divide.eq(1)
                    m.next = "DIVIDE"
            with m.State("DIVIDE"):
                with m.If(self.divided):
                    m.d.comb += [self.start.eq(1), self.replay.eq(1)]
                    m.next = "ITERATE"
            with m.State("ITERATE"):
                m.d.comb += [self.iterating.eq(1), self.replay.eq(next_replay)]
                m.d.sync += timer.eq(self._move - 2)
                with m.If(self.updated):
                    m.d.sync += self.iterations.eq(self.iterations + 1)
                    with m.If(final):
                        if config.buffers == 1:
                            m.d.comb += self.move.eq(1)
                            m.next = "MOVE"
                        else:
                            m.next = "RESULT"
            if config.buffers == 1:
                with m.State("MOVE"):
                    m.d.sync += timer.eq(timer - 1)
                    with m.If(timer == 0):
                        m.next = "RESULT"
            with m.State("RESULT"):
                m.d.comb += self.done.eq(1)
                m.d.sync += self.cycles.eq(self.cycles)
                with m.If(self.taken):
                    m.next = "IDLE"

    def _move_later(self, m, unsettled):
        """Move the ROI by a batch's v when that is known and the next batch has been opened, at no new ROI."""
        found, opened, loaded, first = Signal(), Signal(), Signal(), Signal(init=1)
        settling = Signal(range(self._settle + 2))
        was_done = Signal()
        m.d.sync += was_done.eq(self.done)
        both = found & opened
        m.d.comb += [self.move.eq(both & ~loaded), unsettled.eq(both | (settling != 0))]
        with m.If(self.open):
            m.d.sync += [opened.eq(~first), first.eq(0), loaded.eq(self.settings.roi_load)]
        with m.If(self.done & ~was_done):
            m.d.sync += found.eq(1)
        with m.If(both):
            m.d.sync += [found.eq(0), opened.eq(0)]
        with m.If(self.open):
            m.d.sync += settling.eq(self._settle + 1)
        with m.Elif(both):
            m.d.sync += settling.eq(self._settle)
        with m.Elif(settling != 0):
            m.d.sync += settling.eq(settling - 1)
