"""Decoder: words of all formats in, events out."""

import functools
import operator

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, stream
from amaranth.lib.wiring import In, Out

from ...protocol.registers.declaration import FORMATS
from ...protocol.word_format import COLUMN_BITS, EVENT_TYPES, HIGH_BITS, LOW_BITS, OTHER_TYPES, TIME_HIGH
from .. import Block
from . import payloads


class TimeHigh(Block):
    """Remembers the last time word; the bits of a later event complete it.

    Members
    -------
    load : ``In(1)``
        A time word is here.
    high : ``In``
        Its 28 bits.
    low : ``In``
        An event's six low bits.
    t : ``Out``
        Time stamp of that event, with the time words before this cycle.
    known : ``Out(1)``
        There was a time word.
    back : ``Out(1)``
        The time word that is loaded steps back: by less than half the range, or it would be a wrap.
    """

    def __init__(self, config):
        super().__init__(
            config, load=In(1), high=In(HIGH_BITS), low=In(LOW_BITS), t=Out(config.time_bits), known=Out(1), back=Out(1)
        )

    def elaborate(self, platform):
        m = Module()
        kept = Signal(HIGH_BITS)
        with m.If(self.load):
            m.d.sync += [kept.eq(self.high), self.known.eq(1)]
        m.d.comb += [
            self.t.eq(Cat(self.low, kept)),
            # The sign of the difference.
            self.back.eq(self.load & self.known & (self.high[-1] ^ kept[-1] ^ (self.high[:-1] < kept[:-1]))),
        ]
        return m


#: Fields of an EVT 2.0 word, and of the upper half of an EVT 2.1 word; those of a packed word
#: (:mod:`cmfpga.protocol.words`).
EVT = data.StructLayout({"y": COLUMN_BITS, "x": COLUMN_BITS, "low": LOW_BITS, "type": 4})
PACKED = data.StructLayout({"x": 16, "y": 15, "p": 1, "t": 32})


def sides(value, k):
    """Of a value's halves the one that is not number ``k``, and the one that is."""
    found = value[: len(value) // 2], value[len(value) // 2 :]
    return found[1 - k], found[k]


def lowest_one(m, mask):
    """``mask`` without its lowest one, where that is, and whether there are more; by groups of four bits."""
    remaining, index, lowest = Signal.like(mask), Signal(range(len(mask))), Signal(4)
    groups = [mask[k : k + 4] for k in range(0, len(mask), 4)]
    some, before, first = (Signal(len(groups), name=name) for name in ("some", "before", "first"))
    m.d.comb += [
        some.eq(Cat(group.any() for group in groups)),
        before.eq(Cat(some[:k].any() for k in range(len(groups)))),
        first.eq(some & ~before),
        remaining.eq(mask & Cat(before[k // 4] | groups[k // 4][: k % 4].any() for k in range(len(mask)))),
        lowest.eq(functools.reduce(operator.or_, (g & f.replicate(4) for g, f in zip(groups, first, strict=True)))),
        index[0].eq(~lowest[0] & (lowest[1] | ~lowest[2])),
        index[1].eq(~lowest[0] & ~lowest[1]),
        index[2:].eq(Cat(Cat(f for k, f in enumerate(first) if k >> bit & 1).any() for bit in range(3))),
    ]
    several = [((g[0] | g[1]) & (g[2] | g[3])) | (g[0] & g[1]) | (g[2] & g[3]) for g in groups]
    return remaining, index, ((some & before) | Cat(several)).any()


class Decoder(Block):
    """Holds one 64-bit word, and steps through it:

    - EVT 2.1: a vector of up to 32 events, from its lowest column on, one event a cycle;
    - EVT 2.0: two words of 32 bits, the lower one first, one a cycle. A half whose four TKEEP bits are zero is passed
      over, an upper one at no cycle;
    - packed: one event.

    A word without events takes one cycle. Words with a TKEEP of zero are passed over. Latency :attr:`latency` cycle.

    Members
    -------
    i : ``In``, stream of :func:`payloads.beat`
    o : ``Out``, stream of :func:`payloads.token`
    format, swap : ``In``
        One of :data:`~cmfpga.protocol.registers.declaration.FORMATS`; exchange the 32-bit halves. May change only while
        ``empty``.
    format_error, other, back : ``Out(1)``
        One cycle each: a word was dropped, or is of no use here, or is a time word that steps back. Packed words have
        only the first.
    time_known, empty : ``Out(1)``
        A time word came, or none is needed; no word is held.
    """

    latency = 1

    def __init__(self, config):
        super().__init__(
            config,
            i=In(stream.Signature(payloads.beat())),
            o=Out(stream.Signature(payloads.token(config))),
            format=In(2),
            swap=In(1),
            **dict.fromkeys(("format_error", "other", "back", "time_known", "empty"), Out(1)),
        )

    def elaborate(self, platform):
        m = Module()
        m.submodules.time_high = time_high = TimeHigh(self.config)
        vectors, halves = self.format == FORMATS["EVT21"], self.format == FORMATS["EVT20"]
        packed = ~(vectors | halves)
        # The held word: the upper half, and of a vector the events that are still to come; of two words, the one whose
        # turn it is, and the other.
        head, body = Signal(32), Signal(32)
        keep = Signal(data.ArrayLayout(data.StructLayout({"any": 1, "all": 1}), 2))  # of the body, of the head
        last, held, upper = Signal(), Signal(), Signal()

        word = data.View(EVT, head)
        event_type, event, whole, some, final, use = (Signal() for _ in range(6))
        remaining, index, more = lowest_one(m, body)
        m.d.comb += [
            event_type.eq(packed | word.type.matches(*EVENT_TYPES)),
            whole.eq(keep[1].all & (halves | keep[0].all)),
            some.eq(keep[1].any | (~halves & keep[0].any)),
            final.eq((halves & (upper | ~keep[0].any)) | (vectors & ~(whole & event_type & more)) | packed),
            event.eq(whole & event_type & ~(vectors & (body == 0))),
            self.o.valid.eq(held & (event | self.o.payload.end)),
            use.eq(held & (~self.o.valid | self.o.ready)),
            self.i.ready.eq(~held | (use & final)),
            self.empty.eq(~held),
        ]
        with m.If(use):
            m.d.sync += [upper.eq(~final), held.eq(~final)]
            m.d.sync += [body.eq(remaining), head.eq(body), keep[1].eq(keep[0])]
            with m.If(vectors):
                m.d.sync += [head.eq(head), keep[1].eq(keep[1])]
        with m.If(self.i.valid & self.i.ready):
            m.d.sync += [held.eq(1), last.eq(self.i.payload.last)]
            kept = [Cat(part.any(), part.all()) for part in sides(self.i.payload.keep, 1)]
            for k, part in enumerate((body, head)):
                m.d.sync += part.eq(Mux(self.swap ^ halves, *sides(self.i.payload.data, k)))
                m.d.sync += keep[k].eq(Mux(self.swap ^ halves, *sides(Cat(kept), k)))

        # What it says.
        token, other, moved = self.o.payload, data.View(PACKED, Cat(body, head)), Signal(COLUMN_BITS + 1)
        m.d.comb += [
            time_high.high.eq(word.as_value()[:HIGH_BITS]),
            time_high.low.eq(word.low),
            token.t.eq(Mux(packed, other.t, time_high.t)),
            moved.eq(word.x + Mux(vectors, index, 0)),
            token.x.eq(Mux(packed, other.x, moved)),
            token.y.eq(Mux(packed, other.y, word.y)),
            token.known.eq(time_high.known | packed),
            token.event.eq(event),
            token.end.eq(last & final),
            *([token.vector.eq(1)] if self.config.evt3 else []),
            self.time_known.eq(token.known),
            self.back.eq(time_high.back),
        ]
        with m.If(whole & ~packed):
            with m.Switch(word.type):
                with m.Case(*EVENT_TYPES):
                    pass
                with m.Case(TIME_HIGH):
                    m.d.comb += time_high.load.eq(use)
                with m.Case(*OTHER_TYPES):
                    m.d.comb += self.other.eq(use)
                with m.Default():
                    m.d.comb += self.format_error.eq(use)
        with m.Elif(some & ~whole):
            m.d.comb += self.format_error.eq(use)
        return m
