"""Decoder of Prophesee EVT 2.0: two 32-bit words in each 64-bit word, the lower one first."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from ...protocol.word_format import COLUMN_BITS, EVENT_TYPES, HIGH_BITS, LOW_BITS, OTHER_TYPES, TIME_HIGH
from . import payloads
from .time_high import TimeHigh


def word_layout():
    """Fields of a 32-bit word (see :mod:`cmfpga.protocol.words`)."""
    return data.StructLayout({"y": COLUMN_BITS, "x": COLUMN_BITS, "low": LOW_BITS, "type": 4})


class Evt20Decoder(wiring.Component):
    """One 32-bit word per cycle; latency :attr:`latency` cycle from a 64-bit word to its first event.

    A half whose four TKEEP bits are zero is passed over, an upper one at no cycle.

    Members
    -------
    i : ``In``, stream of :func:`payloads.beat`
    o : ``Out``, stream of :func:`payloads.token`
    format_error, other, back : ``Out(1)``
        One cycle each: a 32-bit word was dropped, or is of no use here, or is a time word that steps back.
    time_known, empty : ``Out(1)``
    """

    latency = 1

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                "i": In(stream.Signature(payloads.beat())),
                "o": Out(stream.Signature(payloads.token(config))),
                **dict.fromkeys(("format_error", "other", "back", "time_known", "empty"), Out(1)),
            }
        )

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
            with m.Switch(word.type):
                with m.Case(*EVENT_TYPES):
                    m.d.comb += self.o.payload.event.eq(1)
                with m.Case(TIME_HIGH):
                    m.d.comb += time_high.load.eq(use)
                with m.Case(*OTHER_TYPES):
                    m.d.comb += self.other.eq(use)
                with m.Default():
                    m.d.comb += self.format_error.eq(use)
        with m.Elif(keep.any()):
            m.d.comb += self.format_error.eq(use)
        m.d.comb += self.i.ready.eq(~held_valid | (use & final))
        with m.If(use):
            m.d.sync += [upper.eq(~final), held_valid.eq(~final)]
        with m.If(self.i.valid & self.i.ready):
            m.d.sync += [held.eq(self.i.payload), held_valid.eq(1)]
        return m
