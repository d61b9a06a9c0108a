"""Sensor gate: drops events that have no time or lie outside the sensor, and counts them."""

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from . import payloads


class SensorGate(wiring.Component):
    """Passes the events of the sensor; of others only the end of the packet. No register: one token per cycle.

    Members
    -------
    i : ``In``, stream of :func:`payloads.token`
    o : ``Out``, stream of :func:`payloads.sensor_token`
    event, before_time, outside : ``Out(1)``
        One cycle each: an event came; it was dropped because no time word came before it; it was dropped because it
        lies outside the sensor.
    """

    latency = 0

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                "i": In(stream.Signature(payloads.token(config))),
                "o": Out(stream.Signature(payloads.sensor_token(config))),
                **dict.fromkeys(("event", "before_time", "outside"), Out(1)),
            }
        )

    def elaborate(self, platform):
        m = Module()
        token = self.i.payload
        inside = Signal()
        m.d.comb += [
            inside.eq((token.x < self.config.sensor_width) & (token.y < self.config.sensor_height)),
            self.o.payload.t.eq(token.t),
            self.o.payload.x.eq(token.x),
            self.o.payload.y.eq(token.y),
            self.o.payload.event.eq(token.event & token.known & inside),
            self.o.payload.end.eq(token.end),
            self.o.valid.eq(self.i.valid & (self.o.payload.event | token.end)),
            self.i.ready.eq(~self.o.valid | self.o.ready),
            self.event.eq(self.i.valid & self.i.ready & token.event),
            self.before_time.eq(self.event & ~token.known),
            self.outside.eq(self.event & token.known & ~inside),
        ]
        return m
