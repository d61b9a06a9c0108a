"""Sensor gate: drops events that have no time or lie outside the sensor, and counts them."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from ..arithmetic import ones
from . import payloads


class SensorGate(wiring.Component):
    """Passes the events of the sensor; of others only the end of the packet. One token per cycle, no register.

    Of a vector across the border the end follows a cycle later: it comes behind events that are dropped.

    Members
    -------
    i : ``In``, stream of :func:`payloads.token`
    o : ``Out``, stream of :func:`payloads.gated_token`
    event, before_time, outside : ``Out``, as :func:`payloads.counted` has them
        How many events came; were dropped because no time word came before them; because they lie outside the sensor.
    """

    latency = 0

    def __init__(self, config):
        self.config = config
        counted = payloads.counted(config).members
        super().__init__(
            {
                "i": In(stream.Signature(payloads.token(config))),
                "o": Out(stream.Signature(payloads.gated_token(config))),
                "event": Out(counted["events_in"]),
                "before_time": Out(counted["before_time"]),
                "outside": Out(counted["out_of_sensor"]),
            }
        )

    def elaborate(self, platform):
        m = Module()
        if self.config.evt3:
            self._vectors(m)
            return m
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

    def _vectors(self, m):
        token, config = self.i.payload, self.config
        # Columns from the vector's first one to the sensor's end.
        room = Signal(range(-(1 << 16), config.sensor_width + 1))
        inside, vector = Signal(len(token.vector)), Signal(len(token.vector))
        apart, passed, takes = Signal(), Signal(), Signal()  # the end comes behind; its events have gone ahead of it
        m.d.comb += [
            room.eq(config.sensor_width - token.x),
            inside.eq(Cat((room > k) & (token.y < config.sensor_height) for k in range(len(inside)))),
            vector.eq(Mux(token.event, token.vector, 0)),
            apart.eq(token.end & token.known & (vector & inside).any() & (vector & ~inside).any() & ~passed),
            self.o.payload.t.eq(token.t),
            self.o.payload.x.eq(token.x),
            self.o.payload.y.eq(token.y),
            self.o.payload.vector.eq(vector & inside & (token.known & ~passed).replicate(len(inside))),
            self.o.payload.event.eq(self.o.payload.vector.any()),
            self.o.payload.end.eq(token.end & ~apart),
            self.o.valid.eq(self.i.valid & (self.o.payload.event | self.o.payload.end)),
            self.i.ready.eq((~self.o.valid | self.o.ready) & ~apart),
            takes.eq(self.i.valid & self.i.ready),
            self.event.eq(Mux(takes, ones(vector), 0)),
            self.before_time.eq(Mux(token.known, 0, self.event)),
            self.outside.eq(Mux(takes & token.known, ones(vector & ~inside), 0)),
        ]
        with m.If(self.i.valid & self.o.ready):
            m.d.sync += passed.eq(apart)
