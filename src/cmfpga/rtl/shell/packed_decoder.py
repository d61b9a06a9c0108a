"""Decoder of packed words: one event in each 64-bit word, for data from files."""

from amaranth.hdl import Module
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from . import payloads


def word_layout():
    """Fields of a word (see :mod:`cmfpga.protocol.words`)."""
    return data.StructLayout({"x": 16, "y": 15, "p": 1, "t": 32})


class PackedDecoder(wiring.Component):
    """One event per cycle, without a register. Words with a TKEEP of zero are passed over.

    Members
    -------
    i : ``In``, stream of :func:`payloads.beat`
    o : ``Out``, stream of :func:`payloads.token`
    format_error, other, back : ``Out(1)``
        One cycle: a word was dropped. The others stay low, for this format has none.
    time_known, empty : ``Out(1)``
        Always high.
    """

    latency = 0

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
