"""Iteration control: runs the iterations of a batch, moves the ROI after them, hands the result out."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ..protocol.results import CYCLE_BITS
from . import Block
from .arithmetic import delay
from .ascent.ascent import ascent_run
from .ingest.ingest_control import handover


class IterationControl(Block):
    """Runs what :class:`~cmfpga.rtl.ingest.ingest_control.IngestControl` hands over, in a state machine.

    IDLE, JUDGE
        Wait for a batch; a degenerate one goes to RESULT.
    DIVIDE
        Wait for the reciprocal.
    ITERATE
        Replay the buffer T times. Each replay is started while the iteration before is still being
        evaluated, so that its first event meets the new v in the cycle in which v appears.
    PROBE
        Where v's confidence is measured, and wanted: replay the buffer for each probe, as in iterations, and wait for
        the judge. The first replay is so much later that its velocity is there. In rounds, which need no probes, only
        wait for the verdict.
    MOVE
        With one event buffer: wait for the ROI's update.
    RESULT
        Offer the result until it is taken.

    With two buffers the ROI's update waits until the next batch has been opened, however long that takes: what a
    batch is cropped with never depends on how fast events arrive.

    Two iterations; ``a`` is the time from ``complete`` to ``updated``, of which ``feed`` cycles pass from a replay to
    its first event's warp::

        state           IDLE │ JUDGE │ DIVIDE … │ ITERATE …                                              │ RESULT
        handover.take   ──┐__________________________________________________________________________________
        divide          ______┌──┐___________________________________________________________________________
        divided         ____________________┌──┐_____________________________________________________________
        run.start       ____________________┌──┐_____________________________________________________________
        replay          ____________________┌──┐_______________________┌──┐__________________________________
        complete        ___________________________________┌──┐_______________________┌──┐___________________
                                                             ├──── a − feed ──► replay   ├──── a ────►
        run.updated     ______________________________________________────┌──┐___________________┌──┐________
        run.done        _____________________________________________________________________________┌───────

    Parameters
    ----------
    replay_delay : int
        Cycles from ``complete`` to the next replay.
    move, settle : int
        Cycles of the ROI's update, and until the next ROI is known after it.
    probe_delay : int
        Cycles from a new v to the first probe's.

    Members
    -------
    handover : ``In``, :func:`~cmfpga.rtl.ingest.ingest_control.handover`
    run : ``Out``, :func:`~cmfpga.rtl.ascent.ascent.ascent_run`
        The batch under way. ``done`` says that its result is valid.
    divide, replay, move : ``Out(1)``
        Begin the division; replay the event buffer; move the ROI. One cycle each.
    divided, complete : ``In(1)``
        The division is done; all that the next v needs is on its way.
    iterating : ``Out(1)``
        Updates of v count.
    begin : ``Out(1)``
        v is known, and is to be probed. One cycle.
    probing : ``Out(1)``
        v is being probed.
    whole : ``Out(1)``
        With ``replay``: that of a probe, which uses all events, whatever the schedule says.
    more, judged : ``In(1)``
        Another probe follows; it is known whether v is in doubt. These five only where v's confidence is measured, of
        which rounds have ``judged`` alone.
    iterations, cycles : ``Out``
        Iterations done, clock cycles since the first event was offered.
    taken : ``In(1)``
        The result is taken, if there is one.
    """

    #: Cycles between the last event's count and the division: hand over, know T, judge.
    hand_over = 4

    def __init__(self, config, *, replay_delay, move, settle, probe_delay=0):
        if replay_delay < 0:
            raise ValueError(f"the replay would have to start {-replay_delay} cycles before the last event is counted")
        self._replay_delay, self._move, self._settle = replay_delay, move, settle
        self._probe_delay = probe_delay
        self._probes = config.confidence and config.ascent_rule.evaluations == 1
        probes = dict.fromkeys(("begin", "probing", "whole"), Out(1)) | dict.fromkeys(("more", "judged"), In(1))
        if not self._probes:
            probes = {"judged": In(1)}
        super().__init__(
            config,
            handover=In(handover(config)),
            run=Out(ascent_run(config)),
            **dict.fromkeys(("divide", "replay", "move"), Out(1)),
            **dict.fromkeys(("divided", "complete"), In(1)),
            iterating=Out(1),
            **(probes if config.confidence else {}),
            iterations=Out(config.widths.iteration_bits),
            cycles=Out(CYCLE_BITS),
            taken=In(1),
        )

    def elaborate(self, platform):
        config, run, batch = self.config, self.run, self.handover.batch
        m = Module()
        timer = Signal(range(max(2, self._move)))
        few, none, too_few, final = Signal(), Signal(), Signal(), Signal()
        following = Signal(len(self.iterations) + 1)
        m.d.comb += [
            run.settings.eq(batch.settings),
            run.take.eq(self.handover.take),
            self.handover.finished.eq(run.done & self.taken),
        ]
        m.d.sync += [
            few.eq(batch.roi_events < batch.settings.min_roi_events),
            none.eq((batch.roi_events == 0) | (batch.span == 0)),
            too_few.eq(few | none | (run.planned == 0)),
            # Three cycles after ``updated``, long before it counts.
            following.eq(self.iterations + 1),
            final.eq(following == run.planned),
        ]
        judged = delay(m, run.take, self.hand_over - 1, name="take", valid=True)
        another = self.complete & self.iterating & ~final
        if self._probes:
            another |= self.complete & self.more
        next_replay = delay(m, another, self._replay_delay, name="next_replay", valid=True)
        after_last = "MOVE" if config.buffers == 1 else "RESULT"
        if self._probes:
            first = self.complete & self.iterating & final & run.settings.judge
            soon = delay(m, first, self._replay_delay + self._probe_delay - 1, name="first_probe", valid=True)
            first = delay(m, soon, 1, name="first", valid=True)
            next_replay |= first
            # A register, for much hangs on it; in the first cycle of PROBE no other replay begins.
            m.d.sync += self.whole.eq(soon | self.probing)
        if config.confidence:
            m.d.comb += run.final.eq(final)
        m.d.comb += self.replay.eq(self.divided | next_replay)  # neither comes but in a state that waits for it
        m.d.sync += self.cycles.eq(Mux(run.take, self.handover.cycles, self.cycles) + 1)
        with m.FSM(name="iterate") as machine:
            with m.State("IDLE"):
                m.d.comb += self.handover.free.eq(1)
                m.d.sync += self.iterations.eq(0)
                with m.If(run.take):
                    m.next = "JUDGE"
            with m.State("JUDGE"):
                m.d.sync += run.degenerate.eq(too_few)
                with m.If(judged & too_few):
                    m.next = "RESULT"
                with m.Elif(judged):
                    # Only then: a division that nobody waits for would still run in the next batch.
                    m.d.comb += self.divide.eq(1)
                    m.next = "DIVIDE"
            with m.State("DIVIDE"):
                with m.If(self.divided):
                    m.d.comb += run.start.eq(1)
                    m.next = "ITERATE"
            with m.State("ITERATE"):
                m.d.sync += timer.eq(self._move - 2)
                with m.If(run.updated):
                    m.d.sync += self.iterations.eq(self.iterations + 1)
                    with m.If(final):
                        m.next = after_last
                        if config.buffers == 1:
                            m.d.comb += self.move.eq(1)
                        if config.confidence:
                            with m.If(run.settings.judge):
                                if self._probes:
                                    m.d.comb += self.begin.eq(1)
                                m.next = "PROBE"
            if config.confidence:
                with m.State("PROBE"):
                    if self._probes:
                        m.d.comb += self.probing.eq(1)
                    with m.If(self.judged):
                        m.next = after_last
            if config.buffers == 1:
                with m.State("MOVE"):
                    m.d.sync += timer.eq(timer - 1)
                    with m.If(timer == 0):
                        m.next = "RESULT"
            with m.State("RESULT"):
                m.d.comb += run.done.eq(1)
                m.d.sync += self.cycles.eq(self.cycles)
                with m.If(self.taken):
                    m.next = "IDLE"
        # A register, for much hangs on it: no gradient comes in the first cycle, nor in the one after the last.
        m.d.sync += self.iterating.eq(machine.ongoing("ITERATE"))
        if config.buffers == 2:
            self._move_later(m)
        else:
            m.d.comb += self.handover.settled.eq(1)
        return m

    def _move_later(self, m):
        """Move the ROI by a batch's v when that is known and the next batch has been opened, at no new ROI."""
        opening = self.handover.opened
        found, opened, loaded, first = Signal(), Signal(), Signal(), Signal(init=1)
        settling = Signal(range(self._settle + 1))
        was_done, settled, ready = Signal(), Signal(init=1), Signal(init=1)
        finding = self.run.done & ~was_done
        m.d.sync += was_done.eq(self.run.done)
        both = found & opened
        # A register, because all of a batch's begin hangs on it: what ~both & settled will be.
        m.d.sync += ready.eq(~opening & ~both & (settled | (settling == 0)) & ~((found | finding) & opened))
        m.d.comb += [self.move.eq(both & ~loaded), self.handover.settled.eq(ready)]
        with m.If(opening):
            m.d.sync += [opened.eq(~first), first.eq(0), loaded.eq(self.handover.loads)]
        with m.If(finding):
            m.d.sync += found.eq(1)
        with m.If(both):
            m.d.sync += [found.eq(0), opened.eq(0)]
        with m.If(opening):
            m.d.sync += [settling.eq(self._settle), settled.eq(0)]
        with m.Elif(both):
            m.d.sync += [settling.eq(self._settle - 1), settled.eq(0)]
        with m.Else():
            m.d.sync += [settling.eq(settling - 1), settled.eq(settled | (settling == 0))]
