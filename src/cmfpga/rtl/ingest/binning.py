"""Binning: an event of the sensor, in an image of fewer and wider pixels."""

from amaranth.hdl import Module
from amaranth.lib.wiring import In, Out

from .. import Block, payloads


class Binning(Block):
    """Column and row without their ``binning`` lowest bits; the last pixel of an odd sensor is part empty.

    What follows is as large as the image: ROI, v, and the table that undistorts are in its pixels.

    One event per cycle; wires alone, in no time.

    Members
    -------
    i, o : ``In``, ``Out``, flows of :func:`payloads.marked_event`, :func:`payloads.binned_event`
    """

    latency = 0

    def __init__(self, config):
        super().__init__(
            config,
            i=In(payloads.flow(payloads.marked_event(config))),
            o=Out(payloads.flow(payloads.binned_event(config))),
        )

    def elaborate(self, platform):
        m = Module()
        m.d.comb += self.o.valid.eq(self.i.valid)
        for name in self.i.payload.shape().members:
            value = self.i.payload[name]
            m.d.comb += self.o.payload[name].eq(value >> self.config.binning if name in ("x", "y") else value)
        return m
