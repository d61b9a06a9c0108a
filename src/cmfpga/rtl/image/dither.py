"""Dither: moves each event by a sub-pixel offset of its own."""

from amaranth.hdl import Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ...config.dither import DITHER_BITS, FACTORS
from .. import payloads


class Dither(wiring.Component):
    """Adds frac((k + ½)·α) − ½ to column and row of the k-th event of a replay (:mod:`cmfpga.config.dither`).

    Events sit on whole pixels, which makes v = 0 a peak of the contrast whatever the motion is; the offsets remove it.
    They depend on k alone, so every iteration sees the same, and the buffer need not store them.

    One event per cycle; latency :attr:`latency` cycle.

    Parameters
    ----------
    config : Config
        ``dither_frac``, not zero.

    Members
    -------
    i : ``In``, flow of :func:`payloads.replayed_event`
    o : ``Out``, flow of :func:`payloads.dithered_event`
    """

    latency = 1

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                "i": In(payloads.flow(payloads.replayed_event(config))),
                "o": Out(payloads.flow(payloads.dithered_event(config))),
            }
        )

    def elaborate(self, platform):
        frac = self.config.dither_frac
        m = Module()
        event = self.i.payload
        for axis, factor in zip(("x", "y"), FACTORS, strict=True):
            phase = Signal(DITHER_BITS, init=factor // 2, name=f"phase_{axis}")
            with m.If(self.i.valid & event.last):
                m.d.sync += phase.eq(factor // 2)
            with m.Elif(self.i.valid):
                m.d.sync += phase.eq(phase + factor)
            m.d.sync += self.o.payload[axis].eq((event[axis] << frac) + phase[-frac:] - (1 << (frac - 1)))
        m.d.sync += [
            self.o.valid.eq(self.i.valid),
            self.o.payload.t.eq(event.t),
            self.o.payload.last.eq(event.last),
        ]
        return m
