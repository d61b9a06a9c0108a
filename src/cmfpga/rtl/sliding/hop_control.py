"""Hop control: takes events in, and says where a hop ends."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from .. import payloads
from .ring import address_bits, ring_event
from .walker import lengths


def sensor_event(config):
    """An event of the sensor whose time does not step back: position as of :func:`payloads.undistorted_event`."""
    members = payloads.undistorted_event(config).members
    return payloads.layout(t=config.time_bits, x=members["x"], y=members["y"])


class HopControl(wiring.Component):
    """Passes the events of the ROI on to the ring, and closes a hop with the ``hop_events``-th of them.

    Or before the first event, wherever on the sensor, that comes ``hop_us`` or more after the last hop closed. The ROI
    moves where a hop closes, between two events, to the corner that is given then. An event waits only if a hop would
    close before the last one is evaluated, or if the ring has no place. So hops follow from the sequence of events, and
    not from when they come.

    One event per cycle; latency :attr:`latency` cycles. A hop that closes by time costs a cycle.

    Parameters
    ----------
    config : Config

    Members
    -------
    i : ``In``, stream of :func:`sensor_event`
    o : ``Out``, flow of :func:`.ring.ring_event`
        Those in the ROI.
    lengths : ``In``, :func:`.walker.lengths`
        Constant from the first event on.
    corner : ``In``, :func:`payloads.roi_corner`
        The ROI from the end of the hop on; before the first event, that of the first hop.
    free : ``In(1)``
        The last hop is evaluated, so that one may close. Low from the cycle after ``closed`` on.
    oldest : ``In``
        Place in the ring of the first event that is still needed.
    closed : ``Out(1)``
        A hop has closed: one cycle, that in which its last event comes out, or later. What follows then stays.
    end, now, stale : ``Out``
        Place in the ring after its last event. When it closed, lowest bits of µs. Whether that was more than
        ``window_us`` after the one before.
    """

    latency = 2

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                "i": In(stream.Signature(sensor_event(config))),
                "o": Out(payloads.flow(ring_event(config))),
                "lengths": In(lengths(config)),
                "corner": In(payloads.roi_corner(config)),
                "free": In(1),
                "oldest": In(address_bits(config)),
                "closed": Out(1),
                "end": Out(address_bits(config)),
                "now": Out(config.span_bits),
                "stale": Out(1),
            }
        )

    def elaborate(self, platform):
        config, lengths, frac = self.config, self.lengths, self.config.formats.event_frac
        m = Module()
        # Stage 1: an event, which stays until it is judged.
        valid_s1, goes, begun = Signal(), Signal(), Signal()
        event_s1 = Signal(sensor_event(config), reset_less=True)
        m.d.comb += self.i.ready.eq(~valid_s1 | goes)
        with m.If(self.i.ready):
            m.d.sync += [valid_s1.eq(self.i.valid), event_s1.eq(self.i.payload)]

        # Stage 2: whether it lies in the ROI, and whether it ends a hop.
        roi, closed_at, left = Signal.like(self.corner), Signal(config.time_bits), Signal.like(lengths.hop_events)
        place, step = Signal.like(self.end), Signal(config.time_bits)
        inside, due, last, closes, full = Signal(), Signal(), Signal(), Signal(), Signal()
        sides = []
        for axis, size in (("x", config.roi_width), ("y", config.roi_height)):
            at = event_s1[axis] - Cat(Const(0, frac), roi[axis])
            sides += [at >= 0, at < size << frac]
        m.d.comb += [
            inside.eq(Cat(sides).all()),
            step.eq(event_s1.t - closed_at),
            due.eq(begun & (lengths.hop_us != 0) & (step >= lengths.hop_us)),
            last.eq(inside & (left == 1)),
            closes.eq(valid_s1 & (due | (last & ~full)) & self.free & ~self.closed),
            full.eq((place + 1)[: len(place)] == self.oldest),
            goes.eq(~due & Mux(last, closes, ~(inside & full))),
            self.now.eq(closed_at),
        ]
        m.d.sync += [
            self.closed.eq(closes),
            self.o.valid.eq(valid_s1 & goes & inside),
            *(self.o.payload[name].eq(event_s1[name]) for name in event_s1.shape().members),
        ]
        with m.If(valid_s1 & goes & inside):
            m.d.sync += [place.eq(place + 1), left.eq(left - 1)]
        with m.If(closes):
            m.d.sync += [
                self.end.eq(place + ~due),
                self.stale.eq(step > Mux(lengths.window_us == 0, 1 << (config.span_bits - 1), lengths.window_us)),
                closed_at.eq(event_s1.t),
                roi.eq(self.corner),
                left.eq(lengths.hop_events),
            ]
        with m.If(~begun):
            m.d.sync += [roi.eq(self.corner), closed_at.eq(self.i.payload.t), left.eq(lengths.hop_events)]
            m.d.sync += begun.eq(self.i.valid)
        return m
