"""Decoder of Prophesee EVT 2.0: two 32-bit words in each 64-bit word, the lower one first."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data

from ...protocol.word_format import COLUMN_BITS, HIGH_BITS, LOW_BITS
from . import payloads
from .decoder import Decoder
from .time_high import TimeHigh


def word_layout():
    """Fields of a 32-bit word (see :mod:`cmfpga.protocol.words`)."""
    return data.StructLayout({"y": COLUMN_BITS, "x": COLUMN_BITS, "low": LOW_BITS, "type": 4})


class Evt20Decoder(Decoder):
    """One 32-bit word per cycle; latency :attr:`latency` cycle from a 64-bit word to its first event.

    A half whose four TKEEP bits are zero is passed over, an upper one at no cycle.
    """

    latency = 1

    def elaborate(self, platform):
        m = Module()
        m.submodules.time_high = time_high = TimeHigh(self.config)
        held, held_valid, upper = Signal(payloads.beat()), Signal(), Signal()
        word = Signal(word_layout())
        keep, final, use = Signal(4), Signal(), Signal()
        m.d.comb += [
            word.as_value().eq(Mux(upper, held.data[32:], held.data[:32])),
            keep.eq(Mux(upper, held.keep[4:], held.keep[:4])),
            final.eq(upper | ~held.keep[4:].any()),
            time_high.high.eq(word.as_value()[:HIGH_BITS]),
            time_high.low.eq(word.low),
            self.o.payload.t.eq(time_high.t),
            self.o.payload.known.eq(time_high.known),
            self.o.payload.x.eq(word.x),
            self.o.payload.y.eq(word.y),
            self.o.payload.end.eq(held.last & final),
            self.o.valid.eq(held_valid & (self.o.payload.event | self.o.payload.end)),
            use.eq(held_valid & (~self.o.valid | self.o.ready)),
            self.back.eq(time_high.back),
            self.time_known.eq(time_high.known),
            self.empty.eq(~held_valid),
        ]
        with m.If(keep.all()):
            self._by_type(m, word.type, self.o.payload.event.eq(1), time_high.load, use)
        with m.Elif(keep.any()):
            m.d.comb += self.format_error.eq(use)
        m.d.comb += self.i.ready.eq(~held_valid | (use & final))
        with m.If(use):
            m.d.sync += [upper.eq(~final), held_valid.eq(~final)]
        with m.If(self.i.valid & self.i.ready):
            m.d.sync += [held.eq(self.i.payload), held_valid.eq(1)]
        return m
