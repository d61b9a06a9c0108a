"""Lane bank: a tagged bank of few LUTs and short paths, as there are four for each lane."""

from functools import reduce
from operator import or_

from amaranth.hdl import Cat, Mux, Signal
from amaranth.lib import memory

from ... import payloads
from ..tagged_accumulator import TaggedBank


class LaneBank(TaggedBank):
    """A :class:`TaggedBank` that takes registers in place of LUTs, and a cycle more, for :class:`LaneImage`.

    What stage 3 may add to stands in five registers: the word out of the RAM, and the last four sums. All but one are
    0, by a reset, or all of them, so the adder takes what any of them has: six inputs a bit. Tags have a memory of
    their own, which is read and written a cycle before the words, so that a word meets its verdict.

    Tags of sums are not compared. So between operations of two tags, four or more must sweep: have tag 0 and add 0. A
    swept word is 0, whatever it was, and so is the sum that the operation behind it may take.

    Parameters
    ----------
    config : Config
        Of more than one lane.
    always : bool
        There is an operation in every cycle; so from a reset on, and nothing asks for it. The first ones then are what
        the registers hold; who sweeps all words after a reset is not harmed.
    """

    latency = TaggedBank.latency + 1

    def __init__(self, config, *, always=False):
        super().__init__(config)
        self.always = always
        self.word = payloads.pixel(config)

    def _entered(self, m):
        """Stage 0: operations wait for a cycle, in which their tags are read."""
        entered = Signal(self.i.payload.shape(), name="operation_s0")
        m.d.sync += entered.eq(self.i.payload)
        valid = Signal(name="entered_s1", init=self.always)
        m.d.sync += valid.eq(self.i.valid)
        return valid, entered

    def _base(self, m, word, pipeline, known, add, total):
        (valid, address, tag), (match, _) = pipeline, known
        m.submodules.tags = tags = memory.Memory(
            shape=self.config.tag_bits, depth=self.config.geometry.words, init=[], attrs={"ram_style": "block"}
        )
        write, read = tags.write_port(), tags.read_port()
        m.d.comb += [
            read.addr.eq(self.i.payload.address),
            write.addr.eq(address[3]),
            write.data.eq(tag[3]),
            write.en.eq(valid[3]),
        ]
        tag_s1, votes_s1 = Signal(self.config.tag_bits, reset_less=True), Signal(reset_less=True)
        m.d.sync += [tag_s1.eq(read.data), votes_s1.eq(tag[0].any())]
        pixel = payloads.pixel(self.config)
        read_s2 = Signal(self.word, reset_less=True)
        base = Signal(pixel)

        def kept(value, drop, name):
            register = Signal(pixel.size, name=name, reset_less=True)
            m.d.sync += register.eq(Mux(drop, 0, value))
            return register

        # Stage 1: the RAM reads. Which of the four older operations was the last one for this word, if any?
        m.d.sync += read_s2.eq(word)
        none, drops = votes_s1, {}
        for stage in (2, 3, 4, 5):
            drops[stage] = Signal(name=f"drop_s{stage}", reset_less=True)
            m.d.sync += drops[stage].eq(~(none & match[stage]))
            none &= ~match[stage]
        drop_word_s2 = Signal(reset_less=True)
        m.d.sync += drop_word_s2.eq(~(none & (tag_s1 == tag[1])))

        # Stage 2: the word, where its tag is right, or a sum, that of stage 3, 4, 5 or 6.
        grown = Cat((add[3][name] + base[name])[: len(base[name])] for name in pixel.members)
        bases = [kept(read_s2.as_value(), drop_word_s2, "word_s3")]
        bases += [kept(total[stage + 1].as_value(), drops[stage], f"sum_s{stage}") for stage in (3, 4, 5)]
        bases.append(kept(grown, drops[2], "sum_s2"))
        m.d.comb += base.as_value().eq(reduce(or_, bases))
        return base
