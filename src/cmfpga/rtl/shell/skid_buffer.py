"""Skid buffer: cuts every combinational path of a stream, at no loss of rate."""

from amaranth.hdl import Module, Signal
from amaranth.lib import memory, stream
from amaranth.lib.wiring import In, Out

from .. import Block


class SkidBuffer(Block):
    """A memory of two items: ``o.valid`` and ``i.ready`` both come from flip-flops.

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
        super().__init__(i=In(stream.Signature(layout)), o=Out(stream.Signature(layout)), empty=Out(1))

    def elaborate(self, platform):
        m = Module()
        m.submodules.store = store = memory.Memory(shape=self._layout, depth=2, init=[])
        put, get = store.write_port(), store.read_port(domain="comb")
        inside, following = Signal(2), Signal(2)
        m.d.comb += [
            put.en.eq(self.i.valid & self.i.ready),
            put.data.eq(self.i.payload),
            self.o.payload.eq(get.data),
            following.eq(inside + put.en - (self.o.valid & self.o.ready)),
            self.empty.eq(~self.o.valid),
        ]
        m.d.sync += [inside.eq(following), self.o.valid.eq(following != 0)]
        m.d.sync += self.i.ready.eq(following != 2)
        m.d.sync += [put.addr.eq(put.addr ^ put.en), get.addr.eq(get.addr ^ (self.o.valid & self.o.ready))]
        return m
