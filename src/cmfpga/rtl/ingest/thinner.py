"""Thinner: stores one ROI event in k, so that a burst of events does not cost time or buffer."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib.wiring import In, Out

from ...config.widths import Widths
from ...fixed import bits_for
from .. import Block, payloads
from ..arithmetic import delay


class Thinner(Block):
    """Passes the first of every ``k`` events, evenly over the batch, and counts the others.

    Where a full buffer thins out further, ``used`` is what comes of both.

    ``k`` is set by hand, or follows the last batch: with a target it is the smallest with which that batch's events
    would not have exceeded it (at most 255). No divider: every ``target`` events count one.

    One event per cycle; latency :attr:`latency` cycle.

    Parameters
    ----------
    event : Shape
        Of an event; nothing in it is looked at.
    most_stored, most_events : int
        Largest ``target``, and most events of a batch.
    used : Shape, optional
        Of ``used``; without it there is none.

    Members
    -------
    i, o : ``In``, ``Out``, flows of ``event``
    start : ``In(1)``
        A new batch begins. No event in this cycle and the one before.
    thinning, target : ``In``
        Taken over with ``start``. ``thinning`` counts if ``target``, or that of the last batch, is zero.
    thinned : ``Out``
        Events left out since ``start``, a cycle after ``o``.
    halved : ``In(1)``
        The buffer stores half as many events from now on.
    used : ``Out``
        One event in so many is stored, from the second cycle after ``start`` or ``halved`` on.
    """

    latency = 1

    def __init__(self, event, *, most_stored, most_events, used=None):
        self._with_used = used is not None
        super().__init__(
            **({"halved": In(1), "used": Out(used)} if self._with_used else {}),
            i=In(payloads.flow(event)),
            o=Out(payloads.flow(event)),
            start=In(1),
            thinning=In(Widths.thinning_bits),
            target=In(bits_for(most_stored)),
            thinned=Out(bits_for(most_events)),
        )

    def elaborate(self, platform):
        m = Module()
        factor = Signal(Widths.thinning_bits)
        position = Signal(Widths.thinning_bits)  # 0 … factor − 1; the event at 0 passes
        target = Signal.like(self.target)
        following = Signal.like(self.target)  # 2 … target + 1: the place of the next event among `target`
        filled = Signal(init=1)  # that place is beyond the target: known an event before, for the clock
        wanted = Signal(Widths.thinning_bits)  # ⌈events/target⌉, saturated
        passes = position == 0
        left_out = Signal()
        m.d.sync += [self.o.valid.eq(self.i.valid & passes), self.o.payload.eq(self.i.payload)]
        m.d.sync += [left_out.eq(self.i.valid & ~passes), self.thinned.eq(self.thinned + left_out)]
        if self._with_used:
            started = delay(m, self.start, 1, name="start", valid=True)
            halved = delay(m, self.halved, 1, name="halved", valid=True)
            with m.If(started):
                m.d.sync += self.used.eq(factor)
            with m.Elif(halved):
                m.d.sync += self.used.eq(self.used << 1)
        with m.If(self.start):
            follow = (self.target != 0) & (target != 0)
            m.d.sync += [
                factor.eq(Mux(follow, Mux(wanted == 0, 1, wanted), self.thinning)),
                target.eq(self.target),
                position.eq(0),
                filled.eq(1),
                wanted.eq(0),
                self.thinned.eq(0),
            ]
        with m.Elif(self.i.valid):
            m.d.sync += position.eq(Mux(position + 1 >= factor, 0, position + 1))
            with m.If(filled):
                m.d.sync += [following.eq(2), filled.eq(target == 1)]
                with m.If(~wanted.all()):
                    m.d.sync += wanted.eq(wanted + 1)
            with m.Else():
                m.d.sync += [following.eq(following + 1), filled.eq(following == target)]
        return m
