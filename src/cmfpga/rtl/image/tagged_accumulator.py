"""Tagged accumulator: four banks of wide words that never need clearing between iterations."""

from amaranth.hdl import Const, Module, Mux, Signal
from amaranth.lib import data
from amaranth.lib.wiring import In, Out

from .. import Block, payloads
from .sliced_memory import memory_of


class TaggedBank(Block):
    """Read–add–write of whole pixels {tag, Dy, Dx, I}; a word with another tag than the operation's reads as zero.

    The pipeline is that of :class:`cmfpga.rtl.image.accumulator.ReadAddWrite` with a register between choosing a word
    and adding to it. So four operations may not have been written when a word is read: the sums of the three older ones
    are forwarded when the word is chosen, that of the youngest when it is added to. A forwarded sum, too, counts only
    if its tag is the operation's::

        stage   0 ........ 1 ........ 2 ............... 3 ............ 4 ......... 5 ....... 6
                address    RAM reads  output register   base + add ──► RAM writes  │         │
                                      choose ─────────►   ▲────────────┤ youngest  │         │
                                        ▲──────────────────────────────┴───────────┴─────────┘  second, third, fourth

    One operation per cycle; ``o`` tells what it did, :attr:`latency` cycles after it.

    Members
    -------
    i : ``In``, flow of :func:`payloads.tagged_operation`
    o : ``Out``, flow of :func:`payloads.tagged_step`

    Attributes
    ----------
    word : :class:`StructLayout`
        Of its memory.
    """

    latency = 4

    def __init__(self, config):
        self.word = data.StructLayout({**payloads.pixel(config).members, "tag": config.tag_bits})
        super().__init__(
            config,
            i=In(payloads.flow(payloads.tagged_operation(config))),
            o=Out(payloads.flow(payloads.tagged_step(config))),
        )

    def elaborate(self, platform):
        config = self.config
        m = Module()
        pixel = payloads.pixel(config)
        style = {} if config.ram_style == "auto" else {"ram_style": config.ram_style}
        m.submodules.ram = ram = memory_of(self.word, config.geometry.bank_depth, style)
        write, read = ram.write_port(), ram.read_port()

        first = self.i.payload
        valid = [self.i.valid] + [Signal(name=f"valid_s{stage}") for stage in range(1, 5)]
        operation = payloads.tagged_operation(config)
        address = [first.address] + [
            Signal(operation["address"].shape, name=f"address_s{stage}", reset_less=True) for stage in range(1, 5)
        ]
        tag = [first.tag] + [Signal(config.tag_bits, name=f"tag_s{stage}", reset_less=True) for stage in range(1, 5)]
        for stage in range(1, 5):
            m.d.sync += [
                valid[stage].eq(valid[stage - 1]),
                address[stage].eq(address[stage - 1]),
                tag[stage].eq(tag[stage - 1]),
            ]
        add = [first.add] + [
            Signal(operation["add"].shape, name=f"add_s{stage}", reset_less=True) for stage in range(1, 4)
        ]
        m.d.sync += [add[stage].eq(add[stage - 1]) for stage in range(1, 4)]
        total = {stage: Signal(pixel, name=f"total_s{stage}", reset_less=True) for stage in (4, 5, 6)}
        # Stage 0: which older operations are for the same word, and of the same tag? As stage 1 will see them.
        match = {stage: Signal(name=f"match_s{stage}") for stage in range(2, 6)}
        same = {stage: Signal(name=f"same_s{stage}", reset_less=True) for stage in match}
        for stage in match:
            m.d.sync += [
                match[stage].eq(valid[stage - 1] & (address[stage - 1] == address[0])),
                same[stage].eq(tag[stage - 1] == tag[0]),
            ]
        base = self._base(m, read.data, tag, (match, same), total)

        # Stage 3: add. Stage 4: write. Stages 5, 6 only remember.
        m.d.comb += [
            read.addr.eq(address[0]),
            write.addr.eq(address[4]),
            write.en.eq(valid[4]),
            self.o.valid.eq(valid[4]),
            self.o.payload.total.eq(total[4]),
            write.data.tag.eq(tag[4]),
        ]
        m.d.sync += [
            total[5].eq(total[4]),
            total[6].eq(total[5]),
            self.o.payload.i.eq(base.i),
            self.o.payload.add.eq(add[3]),
        ]
        for name in pixel.members:
            m.d.comb += write.data[name].eq(total[4][name])
            m.d.sync += total[4][name].eq(add[3][name] + base[name])
        with m.If(~valid[3]):  # for who adds up what all banks tell
            m.d.sync += [self.o.payload.i.eq(0), self.o.payload.add.i.eq(0), total[4].eq(0)]
        return m

    def _base(self, m, word, tag, known, total):
        """Stages 1 to 3: what stage 3 adds to, a pixel.

        ``tag`` and ``total`` are by stage. ``known``: does stage 1 match an older operation, by its stage, and is its
        tag the same?
        """
        match, same = known
        pixel = payloads.pixel(self.config)
        read_s2 = Signal(self.word, reset_less=True)
        base_s3 = Signal(pixel, reset_less=True)
        found, base = Signal(pixel), Signal(pixel)

        # Stage 1: the RAM reads. Which younger sum, if any, will replace what it returns, and does it count?
        m.d.sync += read_s2.eq(word)
        forwarded_s2 = Signal(2, reset_less=True)  # none, or the sum of stage 4, 5, 6: a word bit's choice is one LUT6
        word_counts_s2, sum_counts_s2 = (Signal(name=f"{what}_counts_s2", reset_less=True) for what in ("word", "sum"))
        forwarded, sum_counts = Const(0, 2), Const(0, 1)
        for number, stage in ((3, 5), (2, 4), (1, 3)):  # the youngest wins
            forwarded = Mux(match[stage], number, forwarded)
            sum_counts = Mux(match[stage], same[stage], sum_counts)
        # The operation right before wins over all of them, a stage later.
        behind_s2, behind_s3 = (Signal(name=name, reset_less=True) for name in ("behind_s2", "behind_s3"))
        m.d.sync += [
            forwarded_s2.eq(forwarded),
            word_counts_s2.eq((forwarded == 0) & ~match[2]),
            sum_counts_s2.eq(sum_counts & ~match[2]),
            behind_s2.eq(match[2] & same[2]),
            behind_s3.eq(behind_s2),
        ]

        # Stage 2: output register; with another tag it does not count.
        words = [read_s2.as_value()[: pixel.size], *(total[stage].as_value() for stage in (4, 5, 6))]
        low, high = forwarded_s2
        m.d.comb += found.as_value().eq(Mux(high, Mux(low, words[3], words[2]), Mux(low, words[1], words[0])))
        counts = sum_counts_s2 | (word_counts_s2 & (read_s2.tag == tag[2]))
        counts_s3 = Signal(reset_less=True)  # beside the word: a reset of all its bits would come late
        m.d.sync += [base_s3.eq(found), counts_s3.eq(counts)]
        m.d.comb += base.as_value().eq(Mux(counts_s3, base_s3.as_value(), 0) | Mux(behind_s3, total[4].as_value(), 0))
        return base


class TaggedAccumulator(Block):
    """Sums votes into I, Dx and Dy, spread over four banks by the parity of column and row.

    Every word carries the number of the iteration that wrote it, so nothing is cleared between iterations. Before a
    number is used again, no word may carry it: in cycles without an event between iterations, a sweep writes tag 0,
    which no iteration has, one address after the other, through the same pipeline as the votes.

    One event per cycle; ``o`` follows by :attr:`latency` cycles. The first chooses between a vote and the sweep.

    Members
    -------
    i : ``In``, flow of :func:`payloads.votes`
        Without a gap inside an iteration, unless windows slide.
    next_tag : ``In(1)``
        An iteration is over. At least one cycle after its last event.
    o : ``Out``, array of four :func:`payloads.tagged_step`
        What each bank did for a vote; never valid for the sweep. A bank without a vote, beside one that has one, tells
        of ``i`` = 0; whatever is not valid tells of ``add.i`` = 0.
    swept : ``Out(1)``
        The sweep leaves the last address: after a reset, every word has been written.
    """

    latency = 1 + TaggedBank.latency

    def __init__(self, config):
        self.banks = [TaggedBank(config) for _ in range(4)]
        super().__init__(
            config,
            i=In(payloads.flow(payloads.votes(config))),
            next_tag=In(1),
            o=Out(data.ArrayLayout(payloads.tagged_step(config), 4)),
            swept=Out(1),
        )

    def elaborate(self, platform):
        config = self.config
        m = Module()
        tag = Signal(config.tag_bits, init=1)
        with m.If(self.next_tag):
            m.d.sync += tag.eq(Mux(tag == (1 << config.tag_bits) - 1, 1, tag + 1))

        address = Signal(range(max(2, config.geometry.bank_depth)))
        last = address == config.geometry.bank_depth - 1
        sweeps = ~self.i.valid
        if config.slides:
            inside = Signal()  # an iteration that waits for events
            with m.If(self.i.valid):
                m.d.sync += inside.eq(~self.i.payload.last)
            sweeps &= ~inside
        m.d.sync += self.swept.eq(sweeps & last)
        with m.If(sweeps if config.slides else ~self.i.valid):
            m.d.sync += address.eq(Mux(last, 0, address + 1))

        voted = Signal(self.latency)
        m.d.sync += voted.eq((voted << 1) | self.i.valid)
        for number, bank in enumerate(self.banks):
            m.submodules[f"bank_{number}"] = bank
            vote = self.i.payload.banks[number]
            valid_s1, operation_s1 = Signal(name=f"valid_{number}_s1"), Signal(bank.i.payload.shape(), reset_less=True)
            m.d.comb += [bank.i.valid.eq(valid_s1), bank.i.payload.eq(operation_s1)]
            with m.If(self.i.valid):
                m.d.sync += [valid_s1.eq(vote.valid), operation_s1.address.eq(vote.address), operation_s1.tag.eq(tag)]
                m.d.sync += [operation_s1.add[name].eq(vote[name]) for name in payloads.pixel(config).members]
            with m.Else():
                m.d.sync += [operation_s1.eq(0), operation_s1.address.eq(address)]
                m.d.sync += valid_s1.eq(sweeps if config.slides else 1)
            m.d.comb += [self.o[number].eq(bank.o.payload), self.o[number].valid.eq(bank.o.valid & voted[-1])]
        return m
