"""Batch control: takes a batch in, runs its iterations, hands its result out."""

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from ..fixed import bits_for
from . import payloads
from .arithmetic import delay


class BatchControl(wiring.Component):
    """Sequences the core.

    CLEAR
        After a reset: wait until the banks have been swept once, because a reset does not clear a RAM.
    OPEN
        Wait for a batch's first event to be offered; take over the settings. One cycle.
    INGEST
        Accept one event per cycle until one is ``last`` or the batch's length is reached.
    DRAIN
        Wait until the last event is counted. Degenerate batches go to RESULT.
    RECIPROCAL
        Wait for the divider.
    ITERATE
        Replay the buffer T times. Each replay is started while the iteration before is still being
        evaluated, so that its first event meets the new v in the cycle in which v appears.
    MOVE
        Wait for the ROI's update.
    RESULT
        Offer the result until it is taken.

    Parameters
    ----------
    config : Config
    drain : int
        Cycles from the acceptance of an event until it is counted in the event buffer.
    replay_delay : int
        Cycles from ``evaluate`` to the next replay.
    move : int
        Latency of the ROI updater.

    Members
    -------
    i : ``In``, stream of :func:`payloads.event`
    o : ``Out``, flow of :func:`payloads.event`
        The events of the batch.
    settings : ``In``, :func:`payloads.settings`
    current : ``Out``, :func:`payloads.settings`
        The settings of this batch.
    open, divide, start, replay, move : ``Out(1)``
        Begin a batch; begin the division; load v; replay the event buffer; move the ROI. One cycle each.
    stored, span, planned : ``In``
        ROI events in the buffer; t_N − t_1; iterations of this batch.
    divided, evaluate, updated, cleared : ``In(1)``
        The division is done; all that the next v needs is on its way; v is updated; the banks are swept.
    sweep : ``Out(1)``
        Clear the banks (after a reset).
    iterating : ``Out(1)``
        Updates of v count.
    events, iterations, cycles : ``Out``
        Events accepted, iterations done, clock cycles since the first event was offered.
    degenerate, cut : ``Out(1)``
        Flags of this batch.
    done : ``Out(1)``
        The result is valid.
    taken : ``In(1)``
        The result is taken.
    """

    def __init__(self, config, *, drain, replay_delay, move):
        if replay_delay < 0:
            raise ValueError(f"the replay would have to start {-replay_delay} cycles before the last event is counted")
        self.config = config
        self._drain, self._replay_delay, self._move = drain, replay_delay, move
        pulse = Out(1)
        super().__init__(
            {
                "i": In(stream.Signature(payloads.event(config))),
                "o": Out(payloads.flow(payloads.event(config))),
                "settings": In(payloads.settings(config)),
                "current": Out(payloads.settings(config)),
                **dict.fromkeys(("open", "divide", "start", "replay", "move", "sweep"), pulse),
                "stored": In(bits_for(config.buffer_events)),
                "span": In(config.span_bits),
                "planned": In(bits_for(config.max_iterations)),
                **dict.fromkeys(("divided", "evaluate", "updated", "cleared"), In(1)),
                "iterating": Out(1),
                "events": Out(bits_for(config.max_batch_events)),
                "iterations": Out(bits_for(config.max_iterations)),
                "cycles": Out(payloads.CYCLE_BITS),
                "degenerate": Out(1),
                "cut": Out(1),
                "done": Out(1),
                "taken": In(1),
            }
        )

    def elaborate(self, platform):
        config = self.config
        m = Module()
        timer = Signal(range(max(self._drain, self._move) + 1))
        full, limit, ends, too_few, final = Signal(), Signal(), Signal(), Signal(), Signal()
        accepted = self.events + 1
        m.d.comb += [
            self.o.payload.eq(self.i.payload),
            full.eq(accepted == config.max_batch_events),
            limit.eq(accepted == self.current.batch_events),
            ends.eq(self.i.payload.last | limit | full),
            too_few.eq(
                (self.stored == 0)
                | (self.stored < self.current.min_roi_events)
                | (self.span == 0)
                | (self.planned == 0)
            ),
            final.eq(self.iterations + 1 == self.planned),
        ]
        next_replay = delay(
            m, self.evaluate & self.iterating & ~final, self._replay_delay, name="next_replay", valid=True
        )
        m.d.sync += self.cycles.eq(self.cycles + 1)

        with m.FSM():
            with m.State("CLEAR"):
                with m.If(timer == 0):
                    m.d.comb += self.sweep.eq(1)
                    m.d.sync += timer.eq(1)
                with m.If(self.cleared):
                    m.next = "OPEN"
            with m.State("OPEN"):
                with m.If(self.i.valid):
                    m.d.comb += self.open.eq(1)
                    m.d.sync += [
                        self.current.eq(self.settings),
                        self.events.eq(0),
                        self.iterations.eq(0),
                        self.degenerate.eq(0),
                        self.cycles.eq(1),
                    ]
                    m.next = "INGEST"
            with m.State("INGEST"):
                m.d.comb += [self.i.ready.eq(1), self.o.valid.eq(self.i.valid)]
                m.d.sync += timer.eq(self._drain - 1)
                with m.If(self.i.valid):
                    m.d.sync += [self.events.eq(accepted), self.cut.eq(full & ~limit & ~self.i.payload.last)]
                    with m.If(ends):
                        m.next = "DRAIN"
            with m.State("DRAIN"):
                m.d.sync += timer.eq(timer - 1)
                with m.If(timer == 0):
                    m.d.sync += self.degenerate.eq(too_few)
                    with m.If(too_few):
                        m.next = "RESULT"
                    with m.Else():
                        # Only then: a division that nobody waits for would still run in the next batch.
                        m.d.comb += self.divide.eq(1)
                        m.next = "RECIPROCAL"
            with m.State("RECIPROCAL"):
                with m.If(self.divided):
                    m.d.comb += [self.start.eq(1), self.replay.eq(1)]
                    m.next = "ITERATE"
            with m.State("ITERATE"):
                m.d.comb += [self.iterating.eq(1), self.replay.eq(next_replay)]
                m.d.sync += timer.eq(self._move - 2)
                with m.If(self.updated):
                    m.d.sync += self.iterations.eq(self.iterations + 1)
                    with m.If(final):
                        m.d.comb += self.move.eq(1)
                        m.next = "MOVE"
            with m.State("MOVE"):
                m.d.sync += timer.eq(timer - 1)
                with m.If(timer == 0):
                    m.next = "RESULT"
            with m.State("RESULT"):
                m.d.comb += self.done.eq(1)
                m.d.sync += self.cycles.eq(self.cycles)
                with m.If(self.taken):
                    m.next = "OPEN"
        return m
