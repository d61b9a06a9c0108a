"""Hop evaluation: when a window is replayed, by which rounds, and what comes of it."""

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ...protocol.results import CYCLE_BITS
from ...protocol.settings import LENGTHS, PLANS
from .. import Block, payloads
from ..arithmetic import delay
from ..ascent.ascent import ascent_run
from .ring import address_bits

COLD, WARM, FOLLOW, AFTER = range(len(PLANS))
#: Of an evaluation.
STATES = (
    "OPEN", "LOAD", "LOADED", "AHEAD", "WAIT", "TAKE", "DIVIDE", "ROUNDS", "MOVE", "RESULT", "AFTER", "JUDGE", "WALK",
    "MEASURE",
)  # fmt: skip


def hop(config):
    """Signature of what is known of a hop, from hop control and walker; right as they say.

    ``empty``, ``t_first``, ``t_last`` and ``count`` are the window's: it shares no event with the last one; times of
    its first and last event, if there is one; events. All are right from the second cycle after ``closed`` on.
    """
    time = Out(config.span_bits)
    return wiring.Signature(
        {
            "closed": Out(1),
            **dict.fromkeys(("now", "step", "t_first", "t_last"), time),
            **dict.fromkeys(("stale", "empty"), Out(1)),
            "count": Out(address_bits(config)),
        }
    )


class HopEvaluation(Block):
    """Runs the rounds of one hop after the other, in a state machine.

    OPEN, LOAD, LOADED
        After a reset: wait until the image is clear and an event is offered, take over the settings, place the ROI.
    AHEAD
        The window's begin is known. One that follows the last v begins; else it is waited for the hop's end (WAIT).
    DIVIDE
        Wait for the reciprocal of the unit of time, then replay.
    ROUNDS
        Replay once a round. The first one of ``follow`` takes events in as they come.
    DISCARD
        The window has turned out to be degenerate: wait for its sums, which nobody reads.
    MOVE
        Wait until the ROI is carried on, and for the verdict, if it is this window's own.
    RESULT
        Offer the result until it is taken.
    AFTER, JUDGE
        The round that judges, on the same window. What it finds is kept for the next result.
    WALK
        Wait until the begin of the next window is known.

    Parameters
    ----------
    replay_delay : int
        Cycles from ``complete`` to the next replay.
    move : int
        Cycles of the ROI's move.

    Members
    -------
    offered, cleared : ``In(1)``
        An event is offered; the image is clear.
    given : ``In``, :func:`payloads.settings`
        Taken over in OPEN; :data:`~cmfpga.protocol.settings.LENGTHS` at any time.
    hop : ``In``, :func:`hop`
    walked, divided, complete, summed, judged, drained : ``In(1)``
        The walker, the division are done; all of a round's events have voted; its sums are there; the verdict is known;
        no replay is under way.
    run : ``Out``, :func:`~cmfpga.rtl.ascent.ascent.ascent_run`
    begins, load, opened : ``Out(1)``
        Settings are taken over; place the ROI; from then on events are taken in.
    free : ``Out(1)``
        A hop may close.
    closed : ``Out(1)``
        The hop under way has closed.
    unit : ``Out``
        What v is px per half of, µs.
    divide, replay, next : ``Out(1)``
        Divide by ``unit``; replay the window; what comes from now on belongs to another image. One cycle each.
    iterating : ``Out(1)``
        Gradients count.
    wants_verdict : ``Out(1)``
        The round under way is judged, if it is the last.
    move, cold, walk : ``Out(1)``
        Carry the ROI on; the window starts cold; move the window's begin on.
    since : ``Out``
        The last reference time as an event's of this window, µs.
    keep : ``Out(1)``
        Keep what the last round found: by that the result is judged, or the next one.
    degenerate : ``Out(1)``
    iterations, cycles : ``Out``
        Rounds done; clock cycles since the hop closed.
    taken : ``In(1)``
        The result is taken, if there is one: ``run.done``.
    """

    def __init__(self, config, *, replay_delay, move):
        self.config, self._replay_delay, self._move = config, replay_delay, move
        inputs = ("offered", "cleared", "walked", "divided", "complete", "summed", "judged", "drained", "taken")
        outputs = (
            "begins", "load", "opened", "free", "closed", "divide", "replay", "next", "iterating", "wants_verdict",
            "move", "cold", "walk", "keep", "degenerate",
        )  # fmt: skip
        super().__init__(
            **dict.fromkeys(inputs, In(1)),
            **dict.fromkeys(outputs, Out(1)),
            given=In(payloads.settings(config)),
            hop=In(hop(config)),
            run=Out(ascent_run(config)),
            unit=Out(config.span_bits),
            since=Out(signed(config.span_bits + 1)),
            iterations=Out(config.widths.iteration_bits),
            cycles=Out(CYCLE_BITS),
        )

    def elaborate(self, platform):
        config, run, hop, settings = self.config, self.run, self.hop, self.run.settings
        m = Module()
        decided, followed, follows = Signal(), Signal(), Signal()
        self.age = Signal(config.span_bits + 1)
        enough, held = Signal(), Signal()  # of the window; a judging round has been kept for it
        discard, none = Signal(), Signal()  # decided, and not enough; without an event
        final = Signal()
        timer, ended = Signal(range(max(self._move, 8))), Signal()  # ended: where it is counted, it is 0
        judges = settings.judge if config.confidence else 0
        following = Signal(len(self.iterations) + 1)  # if one more is done
        after, follow = Signal(), Signal()  # settings allow for a judging round, for rounds that follow
        span, age, deciding = self._judge(m, enough, followed)
        ahead = Signal(config.span_bits + 2)
        last_step = Signal.like(hop.step)
        gap, walks = Signal(config.span_bits), Signal()
        m.d.sync += [
            gap.eq(Mux(hop.empty, 0, (hop.now - hop.t_first)[: config.span_bits])),
            ahead.eq(last_step + gap),
            self.walk.eq(walks),
        ]
        kept = Signal()
        m.d.comb += [self.cold.eq(run.plan == COLD), kept.eq(held & ~self.cold)]
        m.d.sync += [
            self.wants_verdict.eq(judges & ((run.plan == AFTER) | ~kept)),
            following.eq(self.iterations + 1),
            final.eq((run.plan == AFTER) | (following == delay(m, run.planned, 1, name="planned"))),
            after.eq(judges & (settings.after.count != 0)),
            follow.eq(settings.follow.count != 0),
        ]
        if config.confidence:
            m.d.comb += run.final.eq(final)
        another = self.complete & self.iterating & ~final & (run.plan != AFTER)
        next_replay = delay(m, another, self._replay_delay, name="next_replay", valid=True)
        # Nothing but the division's end and the judging round starts, whatever the state is.
        judging = Signal()
        m.d.comb += [run.start.eq(self.divided | judging), self.replay.eq(run.start | next_replay)]
        closing = Signal()  # in a state in which a hop may close
        m.d.sync += self.free.eq(closing & ~self.closed & ~hop.closed)
        with m.If(hop.closed):
            m.d.sync += self.closed.eq(1)
        with m.If(deciding):
            m.d.sync += [decided.eq(1), discard.eq(~enough)]
        with m.If(self.walked):
            m.d.sync += [self.closed.eq(0), decided.eq(0), discard.eq(0)]
        other = Signal()
        m.d.comb += other.eq(run.updated)
        m.d.sync += self.next.eq(other)
        # The last reference time lies half a unit behind the last window's first event.
        half, first = Signal(config.span_bits - 1), Signal.like(hop.t_first)
        m.d.sync += none.eq(hop.count == 0)
        passed = Signal(config.span_bits)
        m.d.sync += [passed.eq(hop.t_first - first), self.since.eq(half - passed)]
        # What goes from one cycle to the next state is set beforehand, for much hangs on it.
        fresh = Signal(init=1)
        m.d.comb += self.begins.eq(fresh & self.offered & self.cleared)
        with m.If(fresh):
            m.d.sync += [run.settings.eq(self.given), fresh.eq(~self.begins)]
        m.d.sync += [settings[name].eq(self.given[name]) for name in LENGTHS]
        more = Signal()  # a round that judges, behind a result
        m.d.sync += more.eq(after & ~discard)
        m.d.comb += follows.eq(followed & follow)
        m.d.sync += [each.eq(0) for each in (run.take, self.divide, judging, ended, self.keep)]
        begin = run.take, self.divide
        # A register for each state, for wires are long, and none is left for a decoder.
        at = {state: Signal(name=f"at_{state.lower()}", init=state == "OPEN") for state in STATES}

        def go(old, new):
            return [at[old].eq(0), at[new].eq(1)]

        with m.If(at["OPEN"] & self.begins):
            m.d.sync += go("OPEN", "LOAD")
        m.d.comb += self.load.eq(at["LOAD"])
        with m.If(at["LOAD"]):
            m.d.sync += [timer.eq(7), *go("LOAD", "LOADED")]
        with m.If(at["LOADED"]):
            m.d.sync += [timer.eq(timer - 1), ended.eq(timer == 1)]
            with m.If(ended):
                m.d.sync += [self.opened.eq(1), *go("LOADED", "AHEAD")]
        with m.If(at["AHEAD"]):
            m.d.sync += [self.iterations.eq(0), self.degenerate.eq(0), run.plan.eq(FOLLOW), at["AHEAD"].eq(0)]
            m.d.sync += self.unit.eq(Mux(ahead == 0, 1, Mux(ahead >> config.span_bits != 0, ~0, ahead)))
            m.d.sync += [at["TAKE"].eq(follows), at["WAIT"].eq(~follows)]
            m.d.sync += [each.eq(follows) for each in begin]
        with m.If(at["WAIT"]):
            m.d.sync += [self.unit.eq(span), run.plan.eq(Mux(followed, WARM, COLD)), self.degenerate.eq(discard)]
            with m.If(decided):
                m.d.sync += [at["WAIT"].eq(0), at["RESULT"].eq(discard), at["TAKE"].eq(~discard)]
                m.d.sync += [each.eq(~discard) for each in begin]
        with m.If(at["TAKE"]):
            m.d.sync += go("TAKE", "DIVIDE")
        with m.If(at["DIVIDE"] & self.divided):
            m.d.sync += go("DIVIDE", "ROUNDS")
        with m.If(at["ROUNDS"]):
            m.d.sync += timer.eq(self._move - 1)
            with m.If(discard):
                m.d.sync += self.degenerate.eq(1)
                m.d.comb += other.eq(run.updated | (self.summed & ~none))
                with m.If(Mux(none, self.drained, self.summed)):
                    m.d.sync += go("ROUNDS", "RESULT")
            with m.Elif(run.updated):
                m.d.sync += self.iterations.eq(self.iterations + 1)
                with m.If(final):
                    m.d.sync += go("ROUNDS", "MOVE")
        with m.If(at["MOVE"]):
            m.d.sync += [timer.eq(Mux(timer == 0, 0, timer - 1)), ended.eq(timer <= 1), self.keep.eq(~kept)]
            with m.If(ended & (self.judged | ~self.wants_verdict)):
                m.d.sync += go("MOVE", "RESULT")
        m.d.comb += run.done.eq(at["RESULT"])
        with m.If(at["RESULT"]):
            m.d.sync += timer.eq(4)
            m.d.comb += walks.eq(self.taken & ~more)
            with m.If(self.taken):
                m.d.sync += [at["RESULT"].eq(0), at["AFTER"].eq(more), at["WALK"].eq(~more), run.take.eq(more)]
        with m.If(at["AFTER"]):
            m.d.sync += [run.plan.eq(AFTER), timer.eq(timer - 1), ended.eq(timer == 1), judging.eq(timer == 1)]
            with m.If(ended):
                m.d.sync += go("AFTER", "JUDGE")
        done = Signal()
        with m.If(at["JUDGE"]):
            m.d.sync += done.eq(done | run.updated)
            with m.If((done | run.updated) & self.judged):
                m.d.comb += walks.eq(1)
                m.d.sync += [self.keep.eq(1), held.eq(1), done.eq(0), *go("JUDGE", "WALK")]
        with m.If(at["WALK"]):
            m.d.sync += timer.eq(1)
            with m.If(self.walked):
                m.d.sync += go("WALK", "MEASURE")
        with m.If(at["MEASURE"]):  # how far ahead the next window's end will be
            m.d.sync += [timer.eq(timer - 1), ended.eq(timer == 1)]
            with m.If(ended):
                m.d.sync += go("MEASURE", "AHEAD")
        m.d.comb += closing.eq(Cat(at[state] for state in ("AHEAD", "WAIT", "TAKE", "DIVIDE", "ROUNDS")).any())
        # A cycle after the result is taken, for much hangs on it.
        with m.If(delay(m, run.done & self.taken, 1, name="taken", valid=True)):
            m.d.sync += [followed.eq(~self.degenerate), last_step.eq(hop.step), self.age.eq(age)]
            with m.If(~self.degenerate):
                m.d.sync += [held.eq(0), half.eq(self.unit >> 1), first.eq(hop.t_first)]
        with m.If(hop.closed):
            m.d.sync += self.cycles.eq(1)
        with m.Elif(~at["RESULT"]):
            m.d.sync += self.cycles.eq(self.cycles + 1)
        # Whether v is the window's when it has changed: known long before.
        carries = Signal()
        m.d.sync += carries.eq(at["ROUNDS"] & final & ~discard)
        m.d.comb += self.move.eq(run.updated & carries)
        # No gradient comes in a round's first cycle, nor in the one after its last.
        rounds = at["ROUNDS"] & ~(discard | (deciding & ~enough))
        m.d.sync += self.iterating.eq(rounds | at["JUDGE"])
        m.d.comb += run.degenerate.eq(self.degenerate)
        return m

    def _judge(self, m, enough, followed):
        """Whether the window can be evaluated, from the last cycle before ``decided`` on.

        Returns its range, how long none was too short, µs, and that cycle.
        """
        config, hop, settings = self.config, self.hop, self.run.settings
        span = Signal(config.span_bits)
        aged, age = Signal(config.span_bits + 1), Signal(config.span_bits + 1)
        oldest = Mux(settings.window_us == 0, 1 << (config.span_bits - 1), settings.window_us)
        room, left = Signal(len(hop.count)), Signal(config.span_bits)
        planned, many, timed, whole = (Signal(name=name) for name in ("planned", "many", "timed", "whole"))
        full = Signal()
        m.d.sync += [
            room.eq(settings.window_events - settings.hop_events),
            left.eq(oldest - settings.hop_us),
            planned.eq((settings.cold.count != 0) & ((settings.follow.count != 0) | (settings.warm.count != 0))),
            span.eq(hop.t_last - hop.t_first),
            aged.eq(Mux(self.age[-1], self.age, self.age + hop.step)),
            many.eq((hop.count != 0) & (hop.count >= settings.min_roi_events)),
            whole.eq(hop.count > room),
            full.eq(whole | (aged >= left)),
            timed.eq((span != 0) & ~hop.stale & planned),
        ]
        deciding = delay(m, hop.closed, 4, name="closed", valid=True)
        m.d.comb += [enough.eq(many & timed & (full | followed)), age.eq(Mux(many & timed, aged, 0))]
        return span, age, deciding
