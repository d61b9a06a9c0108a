"""Hop control: takes events in, and says where a hop ends."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from ...config.widths import Widths
from ...fixed import bits_for
from .. import payloads
from ..arithmetic import delay
from .ring import address_bits, ring_event
from .walker import lengths


def hop_counts(config):
    """Where the events of a hop went, ``events`` in all."""
    marks = [name for name in ("hot", "noise") if name in payloads.marked_event(config).members]
    names = ("events", "fresh", "outside", "thinned", "time_back", *marks)
    return data.StructLayout(dict.fromkeys(names, bits_for(config.max_batch_events)))


class HopControl(wiring.Component):
    """Passes the events of the ROI on to the ring, and closes a hop with the ``hop_events``-th of them.

    Or before the first event, wherever on the sensor, that comes ``hop_us`` or more after the last hop closed; or with
    the ``max_batch_events``-th of the sensor. An event whose time steps back is dropped; one that is marked tells the
    time, and is dropped. Of the others in the ROI one in ``thinning`` is passed on.

    The ROI moves where a hop closes, between two events, to the corner that is given then. An event waits only if a hop
    would close before the last one is evaluated, or if the ring has no place. So hops follow from the sequence of
    events, and not from when they come.

    One event per cycle; latency :attr:`latency` cycles. A hop that closes by time costs a cycle.

    Parameters
    ----------
    config : Config

    Members
    -------
    i : ``In``, stream of :func:`payloads.undistorted_event`
    o : ``Out``, flow of :func:`.ring.ring_event`
        Those in the ROI.
    lengths, thinning : ``In``, :func:`.walker.lengths`
        Constant from the first event on.
    corner : ``In``, :func:`payloads.roi_corner`
        The ROI from the end of the hop on; before the first event, that of the first hop.
    free : ``In(1)``
        The last hop is evaluated, so that one may close. Low from the cycle after ``closed`` on.
    oldest : ``In``
        Place in the ring of the first event that is still needed.
    closed : ``Out(1)``
        A hop has closed: one cycle, that in which its last event comes out, or later. What follows then stays.
    end, now : ``Out``
        Place in the ring after its last event; when it closed, µs.
    step, stale : ``Out``
        How long that was after the one before, lowest bits, and whether more than ``window_us``; from the cycle after
        ``closed`` on, and the one after that.
    counts : ``Out``, :func:`hop_counts`
        From the cycle after ``closed`` on.
    waits : ``Out(1)``
        An event has been taken that is not judged yet.
    """

    latency = 2

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                "i": In(stream.Signature(payloads.undistorted_event(config))),
                "o": Out(payloads.flow(ring_event(config))),
                "lengths": In(lengths(config)),
                "thinning": In(Widths.thinning_bits, init=1),
                "corner": In(payloads.roi_corner(config)),
                "free": In(1),
                "oldest": In(address_bits(config)),
                "closed": Out(1),
                "end": Out(address_bits(config)),
                "now": Out(config.time_bits),
                "step": Out(config.span_bits),
                "stale": Out(1),
                "counts": Out(hop_counts(config)),
                "waits": Out(1),
            }
        )

    def elaborate(self, platform):
        config, lengths, frac = self.config, self.lengths, self.config.formats.event_frac
        m = Module()
        # Stage 1: an event, which stays until it is judged.
        valid_s1, goes, begun = Signal(), Signal(), Signal()
        event_s1 = Signal(payloads.undistorted_event(config), reset_less=True)
        m.d.comb += [self.i.ready.eq(~valid_s1 | goes), self.waits.eq(valid_s1)]
        with m.If(self.i.ready):
            m.d.sync += [valid_s1.eq(self.i.valid), event_s1.eq(self.i.payload)]

        # Stage 2: whether it lies in the ROI, and whether it ends a hop.
        roi, latest, left = Signal.like(self.corner), Signal(config.time_bits), Signal.like(lengths.hop_events)
        place, position = Signal.like(self.end), Signal(Widths.thinning_bits)
        now, before, since, step = (
            Signal(config.time_bits, name=name) for name in ("newest", "before", "since", "step")
        )
        back, marked, inside, stays, due, last, closes, full = (
            Signal(name=name) for name in ("back", "marked", "inside", "stays", "due", "last", "closes", "full")
        )
        counts = Signal(hop_counts(config))
        taken = Signal.like(counts.events, name="taken")
        longest = Mux(lengths.window_us == 0, 1 << (config.span_bits - 1), lengths.window_us)
        step_s1 = delay(m, step, 1, name="step")
        m.d.comb += self.step.eq(step_s1)
        m.d.sync += self.stale.eq(step_s1 > longest)
        sides = []
        for axis, size in (("x", config.roi_width), ("y", config.roi_height)):
            at = event_s1[axis] - Cat(Const(0, frac), roi[axis])
            sides += [at >= 0, at < size << frac]
        marks = {name: event_s1[name] & ~back for name in ("hot", "noise") if name in counts.shape().members}
        m.d.comb += [
            since.eq(event_s1.t - latest),
            back.eq(since[-1]),
            now.eq(Mux(back, latest, event_s1.t)),
            step.eq(self.now - before),
            marked.eq(Cat(marks.values()).any() if marks else 0),
            inside.eq(Cat(sides).all() & ~back & ~marked),
            stays.eq(inside & (position == 0)),
            due.eq(
                begun & ~back & (lengths.hop_us != 0) & ((event_s1.t - self.now)[: config.time_bits] >= lengths.hop_us)
            ),
            last.eq((stays & (left == 1)) | (taken == config.max_batch_events - 1)),
            closes.eq(valid_s1 & (due | (last & ~full)) & self.free & ~self.closed),
            full.eq(stays & ((place + 1)[: len(place)] == self.oldest)),
            goes.eq(~due & ~full & Mux(last, closes, 1)),
        ]
        gone = valid_s1 & goes
        m.d.sync += [
            self.closed.eq(closes),
            self.o.valid.eq(gone & stays),
            *(self.o.payload[name].eq(event_s1[name]) for name in self.o.payload.shape().members),
        ]
        lost = {"events": 1, "fresh": stays, "outside": ~inside & ~back & ~marked, "thinned": inside & ~stays}
        lost |= {"time_back": back} | marks
        grown = Signal(hop_counts(config), name="grown")  # a cycle later
        for name, which in lost.items():
            m.d.comb += grown[name].eq(counts[name] + delay(m, gone & which, 1, name=f"grows_{name}", valid=True))
        m.d.sync += counts.eq(Mux(self.closed, 0, grown.as_value()))
        with m.If(self.closed):
            m.d.sync += self.counts.eq(grown)
        with m.If(closes):
            m.d.sync += taken.eq(0)
        with m.Elif(gone):
            m.d.sync += taken.eq(taken + 1)
        with m.If(gone):
            m.d.sync += latest.eq(now)
        with m.If(gone & inside):
            m.d.sync += position.eq(Mux(position + 1 >= self.thinning, 0, position + 1))
        with m.If(gone & stays):
            m.d.sync += [place.eq(place + 1), left.eq(left - 1)]
        with m.If(closes):
            m.d.sync += [
                self.end.eq(place + (gone & stays)),
                self.now.eq(now),
                before.eq(self.now),
                roi.eq(self.corner),
                left.eq(lengths.hop_events),
            ]
        with m.If(~begun):
            m.d.sync += [roi.eq(self.corner), self.now.eq(self.i.payload.t), latest.eq(self.i.payload.t)]
            m.d.sync += [left.eq(lengths.hop_events), begun.eq(self.i.valid)]
        return m
