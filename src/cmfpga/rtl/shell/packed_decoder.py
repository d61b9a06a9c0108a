"""Decoder of packed words: one event in each 64-bit word, for data from files."""

from amaranth.hdl import Module
from amaranth.lib import data

from .decoder import Decoder


def word_layout():
    """Fields of a word (see :mod:`cmfpga.protocol.words`)."""
    return data.StructLayout({"x": 16, "y": 15, "p": 1, "t": 32})


class PackedDecoder(Decoder):
    """One event per cycle, without a register. Words with a TKEEP of zero are passed over."""

    latency = 0

    def elaborate(self, platform):
        m = Module()
        word = data.View(word_layout(), self.i.payload.data)
        whole = self.i.payload.keep.all()
        m.d.comb += [
            self.o.payload.t.eq(word.t),
            self.o.payload.x.eq(word.x),
            self.o.payload.y.eq(word.y),
            self.o.payload.known.eq(1),
            self.o.payload.event.eq(whole),
            self.o.payload.end.eq(self.i.payload.last),
            self.o.valid.eq(self.i.valid & (whole | self.i.payload.last)),
            self.i.ready.eq(~self.o.valid | self.o.ready),
            self.format_error.eq(self.i.valid & self.i.ready & ~whole & self.i.payload.keep.any()),
            self.time_known.eq(1),
            self.empty.eq(1),
        ]
        return m
