"""Decoder of Prophesee EVT 2.1: 64-bit vectors of up to 32 events."""

from amaranth.hdl import Module, Signal
from amaranth.lib import data

from ...protocol.word_format import COLUMN_BITS, HIGH_BITS, LOW_BITS
from . import payloads
from .decoder import Decoder
from .time_high import TimeHigh


def word_layout():
    """Fields of a word (see :mod:`cmfpga.protocol.words`)."""
    return data.StructLayout({"vector": 32, "y": COLUMN_BITS, "x": COLUMN_BITS, "low": LOW_BITS, "type": 4})


class Evt21Decoder(Decoder):
    """Unpacks a vector from its lowest column on, one event per cycle.

    A word without events takes one cycle; so does the last event of a vector together with taking the next word.
    Latency :attr:`latency` cycle from a word to its first event. Words with a TKEEP of zero are passed over.
    """

    latency = 1

    def elaborate(self, platform):
        m = Module()
        m.submodules.time_high = time_high = TimeHigh(self.config)
        word = data.View(word_layout(), self.i.payload.data)
        held = Signal(payloads.token(self.config))
        held_valid = Signal()
        vector = Signal(32)  # events of the held word that are still to come

        # The held word: its lowest event goes out.
        remaining, index = Signal(32), Signal(5)
        m.d.comb += remaining.eq(vector & (vector - 1))
        for k in reversed(range(32)):
            with m.If(vector[k]):
                m.d.comb += index.eq(k)
        m.d.comb += [
            self.o.valid.eq(held_valid),
            self.o.payload.eq(held),
            self.o.payload.x.eq(held.x + index),
            self.o.payload.event.eq(vector != 0),
            self.o.payload.end.eq(held.end & (remaining == 0)),
            self.empty.eq(~held_valid),
            self.time_known.eq(time_high.known),
        ]
        with m.If(self.o.valid & self.o.ready):
            m.d.sync += [vector.eq(remaining), held_valid.eq(remaining != 0)]

        # The word that comes.
        take, good = Signal(), Signal()
        m.d.comb += [
            self.i.ready.eq(~held_valid | (self.o.ready & (remaining == 0))),
            take.eq(self.i.valid & self.i.ready),
            good.eq(take & self.i.payload.keep.all()),
            time_high.high.eq(self.i.payload.data[32 : 32 + HIGH_BITS]),
            time_high.low.eq(word.low),
            self.back.eq(time_high.back),
        ]
        events = Signal(32)
        with m.If(good):
            self._by_type(m, word.type, events.eq(word.vector), time_high.load, 1)
        with m.Elif(take & self.i.payload.keep.any()):
            m.d.comb += self.format_error.eq(1)
        with m.If(take):
            m.d.sync += [
                held_valid.eq((events != 0) | self.i.payload.last),
                vector.eq(events),
                held.t.eq(time_high.t),
                held.x.eq(word.x),
                held.y.eq(word.y),
                held.known.eq(time_high.known),
                held.end.eq(self.i.payload.last),
            ]
        return m
