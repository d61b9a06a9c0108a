"""Runs: what the shell has beside a core whose windows slide, in place of where batches end."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import stream
from amaranth.lib.wiring import In, Out

from .. import Block
from .. import payloads as core
from . import payloads


class RunEnd(Block):
    """Passes the events of a run on, and ends it on command: the core then goes back to its state behind a reset.

    A run begins with an event, when it may. No event waits for the next one. The command takes effect when the events
    that came before it are evaluated, their results taken; those that come meanwhile belong to the next run. A hop that
    has not closed by then has no result. TLAST means nothing.

    One event per cycle; no latency.

    Members
    -------
    i : ``In``, stream of :func:`payloads.sensor_token`
    o : ``Out``, stream of :func:`cmfpga.rtl.payloads.event`
    go : ``In(1)``
        A run may begin.
    opened : ``In(1)``
        The core begins one with the event that is offered.
    end_batch, idle : ``In(1)``
        The command; no event is on its way to ``i``.
    busy : ``In(1)``
        The core has an event that is not judged, or a result that is not taken.
    taking_in, holding : ``Out(1)``
        From ``opened`` to ``ended``; low, for no event stays here.
    ending : ``Out(1)``
        The command has not taken effect.
    ended : ``Out(1)``
        One cycle: reset the core.
    empty_end : ``Out(1)``
        One cycle: there was no run to end.
    """

    latency = 0

    def __init__(self, config):
        super().__init__(
            config,
            i=In(stream.Signature(payloads.sensor_token(config))),
            o=Out(stream.Signature(core.event(config))),
            **dict.fromkeys(("go", "opened", "end_batch", "idle", "busy"), In(1)),
            **dict.fromkeys(("taking_in", "holding", "ending", "ended", "empty_end"), Out(1)),
        )

    def elaborate(self, platform):
        m = Module()
        closed, passes, done = Signal(), Signal(), Signal()
        m.d.comb += [
            passes.eq((self.taking_in | self.go) & ~closed),
            self.o.valid.eq(self.i.valid & self.i.payload.event & passes),
            *(self.o.payload[name].eq(self.i.payload[name]) for name in "txy"),
            self.i.ready.eq(~self.i.payload.event | (self.o.ready & passes)),
            done.eq(closed & ~self.busy),
            self.ended.eq(done & self.taking_in),
            self.empty_end.eq(done & ~self.taking_in),
        ]
        with m.If(self.end_batch):
            m.d.sync += self.ending.eq(1)
        with m.Elif(done):
            m.d.sync += [self.ending.eq(0), closed.eq(0)]
        # A run whose first event is offered has begun, unless none may begin.
        with m.Elif(self.ending & ((self.idle & ~self.i.valid) | ~(self.taking_in | self.go))):
            m.d.sync += closed.eq(1)
        with m.If(self.opened):
            m.d.sync += self.taking_in.eq(1)
        with m.Elif(self.ended):
            m.d.sync += self.taking_in.eq(0)
        return m


class HopResults(Block):
    """Chooses the results that are sent, the first of every so many, and counts the others.

    Members
    -------
    every : ``In(16)``
        At least 1; looked at when a result is sent.
    begun, restart, clear : ``In(1)``
        A result begins; the next one is a run's first; set the count to 0.
    due, sent : ``Out(1)``
        The result that begins is sent; so is the last that began.
    beat : ``Out(5)``
        The word of the packet that is written, from ``begun`` on.
    skipped : ``Out(32)``
        Results that were not; wraps.
    """

    def __init__(self):
        super().__init__(
            every=In(16),
            **dict.fromkeys(("begun", "restart", "clear"), In(1)),
            due=Out(1),
            sent=Out(1),
            beat=Out(5),
            skipped=Out(32),
        )

    def elaborate(self, platform):
        m = Module()
        left, following = Signal(16), Signal(5)
        m.d.comb += [self.due.eq(left == 0), self.beat.eq(Mux(self.begun, 0, following))]
        m.d.sync += following.eq(Mux(self.begun | (following != 0), self.beat + 1, 0))
        with m.If(self.begun):
            m.d.sync += [left.eq(Mux(self.due, self.every, left) - 1), self.sent.eq(self.due)]
            m.d.sync += self.skipped.eq(self.skipped + ~self.due)
        with m.If(self.restart):
            m.d.sync += left.eq(0)
        with m.If(self.clear):
            m.d.sync += self.skipped.eq(0)
        return m


def hops_in_windows(m, wanted):
    """The ``wanted`` settings of the core with hops that are no longer than their window; which of two were longer."""
    given, beyond = Signal.like(wanted, name="given"), Signal(2)
    longer = {
        "hop_events": wanted.hop_events > wanted.window_events,
        "hop_us": (wanted.window_us != 0) & (wanted.hop_us > wanted.window_us),
    }
    m.d.comb += [given.eq(wanted), beyond.eq(Cat(longer.values()))]
    for name, most in (("hop_events", wanted.window_events), ("hop_us", wanted.window_us)):
        m.d.comb += given[name].eq(Mux(longer[name], most, wanted[name]))
    return given, beyond
