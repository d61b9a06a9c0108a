"""Lane bank: a tagged bank of few LUTs, as there are four for each lane."""

from functools import reduce
from operator import or_

from amaranth.hdl import Cat, Mux, Signal

from ... import payloads
from ..tagged_accumulator import TaggedBank


class LaneBank(TaggedBank):
    """A :class:`TaggedBank` that takes registers in place of LUTs; what it does is the same.

    What stage 3 may add to stands in five registers: the word out of the RAM, and the last four sums. All but one are
    0, by a reset, or all of them, so the adder takes what any of them has: six inputs a bit.
    """

    def _base(self, m, word, tag, known, add, total):
        match, same = known
        pixel = payloads.pixel(self.config)
        read_s2 = Signal(self.word, reset_less=True)
        base = Signal(pixel)

        def kept(value, drop, name):
            register = Signal(pixel.size, name=name, reset_less=True)
            m.d.sync += register.eq(Mux(drop, 0, value))
            return register

        # Stage 1: the RAM reads. Which of the four older operations was the last one for this word, if any?
        m.d.sync += read_s2.eq(word)
        none, drops = 1, {}
        for stage in (2, 3, 4, 5):
            drops[stage] = Signal(name=f"drop_s{stage}", reset_less=True)
            m.d.sync += drops[stage].eq(~(none & match[stage] & same[stage]))
            none &= ~match[stage]
        none_s2 = Signal(reset_less=True)
        m.d.sync += none_s2.eq(none)

        # Stage 2: the word, where its tag is right, or a sum, that of stage 3, 4, 5 or 6.
        grown = Cat((add[3][name] + base[name])[: len(base[name])] for name in pixel.members)
        bases = [kept(read_s2.as_value()[: pixel.size], ~(none_s2 & (read_s2.tag == tag)), "word_s3")]
        bases += [kept(total[stage + 1].as_value(), drops[stage], f"sum_s{stage}") for stage in (3, 4, 5)]
        bases.append(kept(grown, drops[2], "sum_s2"))
        m.d.comb += base.as_value().eq(reduce(or_, bases))
        return base
