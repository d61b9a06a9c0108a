"""EVT 3.0 decoder: words of 16 bits in, events and vectors of events out."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, stream
from amaranth.lib.wiring import In, Out

from ...protocol.word_format import COLUMN_BITS, LAST_COLUMN, OTHER_TYPES_3, TIME_BITS, TIME_HIGH, VECTORS, Evt3
from .. import Block
from . import payloads

WORD = data.StructLayout({"value": TIME_BITS, "type": 4})
#: Bits of time in which a step from the latest time to a word's has a sign: less than 2^24 back, 2^25 on.
STEP_BITS = 2 * TIME_BITS + 2


class Evt3Decoder(Block):
    """Holds one beat of four words, and takes one of them a cycle, the lowest first.

    A vector word is one token, a single event a vector of one column. Words behind the last with a TKEEP take no cycle,
    others without one are passed over. What a word means without a row, base or time before it, and when times wrap or
    step back, is as :class:`cmfpga.events.evt.EvtDecoder` has it: they never decrease.

    One word per cycle; latency :attr:`latency` cycle.

    Members
    -------
    i : ``In``, stream of :func:`payloads.beat`
    o : ``Out``, stream of :func:`payloads.token`
    swap : ``In``
        Exchange the 32-bit halves. May change only while ``empty``.
    format_error, other, back, time_known, empty : ``Out(1)``
        As of :class:`~.decoder.Decoder`; ``back`` is of high parts alone.
    """

    latency = 1

    def __init__(self, config):
        super().__init__(
            config,
            i=In(stream.Signature(payloads.beat())),
            o=Out(stream.Signature(payloads.token(config))),
            swap=In(1),
            **dict.fromkeys(("format_error", "other", "back", "time_known", "empty"), Out(1)),
        )

    def elaborate(self, platform):
        m = Module()
        beat, held = Signal(payloads.beat()), Signal()
        whole, final, use, event = (Signal() for _ in range(4))
        word, token = data.View(WORD, beat.data[: WORD.size]), self.o.payload
        m.d.comb += [
            whole.eq(beat.keep[:2].all()),
            final.eq(~beat.keep[2:].any()),
            self.o.valid.eq(held & (event | token.end)),
            use.eq(held & (~self.o.valid | self.o.ready)),
            self.i.ready.eq(~held | (use & final)),
            self.empty.eq(~held),
        ]
        with m.If(use):
            m.d.sync += [held.eq(~final), beat.data.eq(beat.data >> WORD.size), beat.keep.eq(beat.keep >> 2)]
        with m.If(self.i.valid & self.i.ready):
            taken = self.i.payload
            halves = len(taken.data) // 2, len(taken.keep) // 2
            m.d.sync += [held.eq(1), beat.eq(taken)]
            with m.If(self.swap):
                m.d.sync += [beat[name].eq(taken[name].rotate_left(half)) for name, half in
                             zip(("data", "keep"), halves, strict=True)]  # fmt: skip

        # A high part that falls by more than half its range has wrapped; another one begins at low part 0.
        low, high = Signal(TIME_BITS), Signal(TIME_BITS)
        bits = max(self.config.time_bits, STEP_BITS)
        wraps, now = Signal(bits - 2 * TIME_BITS), Signal(bits)
        stamp, step, fell = Signal(bits), Signal(STEP_BITS), Signal(TIME_BITS + 1)
        m.d.comb += [
            stamp.eq(Cat(low, high, wraps)),
            step.eq(stamp - now),
            token.t.eq(Mux(step[-1], now, stamp)),
            fell.eq(high - word.value),  # its highest bit: it did not fall
        ]
        m.d.sync += now.eq(Mux(step[-1], now, stamp))

        row, base, columns = Signal(COLUMN_BITS), Signal(range(LAST_COLUMN + 1)), Signal(4)
        vector = token.vector
        m.d.comb += [token.x.eq(base), token.y.eq(row), token.known.eq(self.time_known), token.event.eq(event)]
        m.d.comb += [token.end.eq(beat.last & final), event.eq(whole & vector.any())]
        with m.If(whole):
            with m.Switch(word.type):
                with m.Case(Evt3.Y):
                    with m.If(use):
                        m.d.sync += row.eq(word.value)
                with m.Case(Evt3.X):
                    m.d.comb += [token.x.eq(word.value[:COLUMN_BITS]), vector.eq(1)]
                    with m.If(use):
                        m.d.sync += base.eq(word.value[:COLUMN_BITS])
                with m.Case(Evt3.BASE):
                    with m.If(use):
                        m.d.sync += base.eq(word.value[:COLUMN_BITS])
                with m.Case(*VECTORS):
                    m.d.comb += columns.eq(Mux(word.type == Evt3.VECTOR_12, *VECTORS.values()))
                    m.d.comb += vector.eq(Mux(word.type == Evt3.VECTOR_12, word.value, word.value[:8]))
                    with m.If(use):
                        m.d.sync += base.eq(Mux(base >= LAST_COLUMN - columns, LAST_COLUMN, base + columns))
                with m.Case(Evt3.TIME_LOW):
                    with m.If(use & self.time_known):
                        m.d.sync += low.eq(word.value)
                with m.Case(TIME_HIGH):
                    with m.If(use):
                        m.d.sync += [high.eq(word.value), self.time_known.eq(1)]
                        m.d.comb += self.back.eq(self.time_known & ~fell[-1] & (fell != 0) & ~self._wrapped(fell))
                        with m.If(fell != 0):
                            m.d.sync += low.eq(0)
                        with m.If(self._wrapped(fell)):
                            m.d.sync += wraps.eq(wraps + 1)
                with m.Case(*OTHER_TYPES_3):
                    m.d.comb += self.other.eq(use)
                with m.Default():
                    m.d.comb += self.format_error.eq(use)
        with m.Elif(beat.keep[:2].any()):
            m.d.comb += self.format_error.eq(use)
        return m

    @staticmethod
    def _wrapped(fell):
        """By more than half its range: more than 2^11."""
        return ~fell[-1] & fell[-2] & fell[:-2].any()
