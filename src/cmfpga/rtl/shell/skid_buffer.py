"""Skid buffer: cuts every combinational path of a stream, at no loss of rate."""

from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out


class SkidBuffer(wiring.Component):
    """Two registers: ``o`` and ``i.ready`` both come from flip-flops.

    One item per cycle; latency :attr:`latency` cycle. ``i.ready`` and ``o.valid`` are low in a reset and in the cycle
    after it.

    Parameters
    ----------
    layout : shape
        Of the payload.

    Members
    -------
    i, o : ``In``, ``Out``, streams of ``layout``
    empty : ``Out(1)``
        Nothing is inside.
    """

    latency = 1

    def __init__(self, layout):
        self._layout = layout
        super().__init__({"i": In(stream.Signature(layout)), "o": Out(stream.Signature(layout)), "empty": Out(1)})

    def elaborate(self, platform):
        m = Module()
        spare = Signal(self._layout, reset_less=True)
        spare_valid = Signal()
        accept = Signal()
        advance = Signal()
        m.d.comb += [
            accept.eq(self.i.valid & self.i.ready),
            advance.eq(~self.o.valid | self.o.ready),
            self.empty.eq(~self.o.valid & ~spare_valid),
        ]
        m.d.sync += self.i.ready.eq(1)
        with m.If(advance):
            m.d.sync += [self.o.valid.eq(spare_valid | accept), spare_valid.eq(0)]
            with m.If(spare_valid):
                m.d.sync += self.o.payload.eq(spare)
            with m.Elif(accept):
                m.d.sync += self.o.payload.eq(self.i.payload)
        with m.Elif(accept | spare_valid):
            m.d.sync += [spare_valid.eq(1), self.i.ready.eq(0)]
        with m.If(accept):
            m.d.sync += spare.eq(self.i.payload)
        return m
