"""The properties of a bank of either accumulator: a shadow of one row, and what must agree with it."""

from amaranth.asserts import AnySeq
from amaranth.hdl import Assert, Cat, Cover, Mux, Signal, Value
from amaranth.lib import data

from cmfpga.rtl import payloads
from support.formal.harness import Harness


def anything(target):
    return target.eq(AnySeq(len(Value.cast(target))))


class RowShadow:
    """The word that one row of a bank should hold, and the operations on it that are under way.

    The shadow changes at once with each operation on the row. ``hit``, ``before`` and ``after`` are delay lines: item
    ``n`` is about the operation that was offered ``n`` cycles ago, and is what the pipeline has to agree with where
    that operation is then. ``word``: layout of the row; ``write``: cycles until an operation reaches the write port.
    """

    def __init__(self, word, name, write):
        self.word, self.name, self.write = word, name, write
        self.shadow = Signal(word, name=f"{name}_shadow")
        self.stages = range(write + 1)

    def line(self, m, name, now, shape=1):
        """A delay line of ``now``, a value or a dictionary of a layout's members."""
        line = [Signal(shape, name=f"{self.name}_{name}_{n}") for n in self.stages]
        members = now.items() if isinstance(now, dict) else ()
        m.d.comb += [line[0][member].eq(value) for member, value in members] or line[0].eq(now)
        m.d.sync += [line[n].eq(line[n - 1]) for n in self.stages[1:]]
        return line

    def follow(self, m, *, hit, after, first=0):
        """Take in the operation that is offered, and the word behind it; ``first`` is what the row starts with.

        A register starts at a constant, so those that hold the word hold its difference from that.
        """
        self.hit, self.after = self.line(m, "hit", hit), self.line(m, "after", after, self.word)
        self.before = [Signal(self.word, name=f"{self.name}_before_{n}") for n in self.stages]
        difference = Signal(self.word.size, name=f"{self.name}_difference")
        m.d.comb += self.shadow.as_value().eq(first ^ difference)
        for before, then in zip(self.before, self.line(m, "then", difference, len(difference)), strict=True):
            m.d.comb += before.as_value().eq(first ^ then)
        with m.If(self.hit[0]):
            m.d.sync += difference.eq(first ^ self.after[0].as_value())

    def check_memory(self, m, memories):
        """Every word of the row is written, is right, and nothing else is written: in one RAM or several, side by side.

        Each holds a member, or so many bits of the word.
        """
        word, write = self.word, self.write
        content, written = Signal(word, name=f"{self.name}_content"), Signal(word, name=f"{self.name}_written")
        m.d.comb += [
            content.as_value().eq(Cat(memory.content for memory in memories)),
            written.as_value().eq(Cat(memory.write.data for memory in memories)),
            *(Assert(memory.written == self.hit[write]) for memory in memories),
        ]
        for name in word.members:
            # The induction stands on this: what is not under way any more is in the RAM.
            m.d.comb += Assert(content[name] == self.before[write][name])
            with m.If(self.hit[write]):
                m.d.comb += Assert(written[name] == self.after[write][name])


def tagged_word(config):
    """{pixel, tag} of a row of a tagged bank."""
    return data.StructLayout({**payloads.pixel(config).members, "tag": config.tag_bits})


class BankHarness(Harness):
    """Any operation in any cycle into one bank; ``cases(m)`` are covered.

    ``operation()``: the row's layout; of a word: what it becomes, by member; of a word: pairs (what is answered, the
    same).
    """

    def properties(self, m, row, memories):
        dut = self.dut
        m.d.comb += [anything(dut.i.valid), anything(dut.i.payload.as_value())]
        word, after, answers = self.operation()
        self.shadow = shadow = RowShadow(word, "expected", dut.latency)
        hit = dut.i.valid & (dut.i.payload.address == row)
        shadow.follow(m, hit=hit, after=after(shadow.shadow))
        shadow.check_memory(m, memories)
        self.valid = shadow.line(m, "valid", dut.i.valid)
        m.d.comb += Assert(dut.o.valid == self.valid[dut.latency])
        for number, (got, wanted) in enumerate(answers(shadow.shadow)):
            line = shadow.line(m, f"answer_{number}", wanted, got.shape())
            with m.If(shadow.hit[dut.latency]):
                m.d.comb += Assert(got == line[dut.latency])
        # The cases that make the proof worth something can all happen. Item 0 is the youngest operation.
        self.elsewhere = [self.valid[n] & ~shadow.hit[n] for n in shadow.stages]
        self.collided = Signal(len(shadow.stages))
        m.d.sync += self.collided.eq((self.collided << 1) | memories[0].collision)
        cases = self.cases(m)
        assert len(cases) == self.COVERS
        m.d.comb += [Cover(case) for case in cases]


class ReadAddWriteHarness(BankHarness):
    COVERS = 10

    def __init__(self, dut):
        super().__init__(dut, dut.depth)

    def operation(self):
        members, operation, answer = self.dut.word.members, self.dut.i.payload, self.dut.o.payload
        return (
            self.dut.word,
            lambda word: {name: Mux(operation.clear, 0, word[name] + operation.add[name]) for name in members},
            lambda word: [(Value.cast(answer[name]), word[name]) for name in members],
        )

    def cases(self, m):
        hit, valid, elsewhere, collided = self.shadow.hit, self.valid, self.elsewhere, self.collided
        member = next(iter(self.shadow.word.members))
        before, after = ([word[member] for word in line] for line in (self.shadow.before, self.shadow.after))
        clear = self.shadow.line(m, "clear", self.dut.i.payload.clear)
        grows = [hit[n] & ~clear[n] & (before[n] != after[n]) for n in self.shadow.stages]
        return [
            grows[0] & grows[1] & grows[2] & grows[3],  # four in a row
            grows[0] & elsewhere[1] & grows[2],  # two apart, another row between
            grows[0] & ~valid[1] & grows[2],  # two apart, nothing between
            grows[0] & elsewhere[1] & elsewhere[2] & grows[3],  # three apart
            grows[0] & hit[1] & clear[1] & (before[1] != 0) & grows[2],  # a clear between two
            grows[0] & ~valid[1] & hit[2] & clear[2] & (before[2] != 0),  # a clear two before
            hit[0] & clear[0] & grows[1],  # a clear right behind
            grows[0] & (after[0] == 0),  # a total that wraps
            hit[3] & collided[2] & (before[3] != 0),  # an answer whose read collided
            hit[3] & ~collided[2] & ~hit[2] & (before[3] != 0) & ~hit[1] & ~hit[0],  # an answer on its own
        ]


class TaggedBankHarness(BankHarness):
    COVERS = 13

    def __init__(self, dut):
        super().__init__(dut, dut.config.geometry.bank_depth)

    def operation(self):
        pixel, operation, answer = payloads.pixel(self.dut.config), self.dut.i.payload, self.dut.o.payload

        def base(word):
            return {name: Mux(word.tag == operation.tag, word[name], 0) for name in pixel.members}

        def after(word):
            return {name: value + operation.add[name] for name, value in base(word).items()} | {"tag": operation.tag}

        def answers(word):
            total = after(word)
            return [(answer.i, base(word)["i"])] + [
                pair for name in pixel.members
                for pair in ((answer.total[name], total[name]), (answer.add[name], operation.add[name]))
            ]  # fmt: skip

        return tagged_word(self.dut.config), after, answers

    def cases(self, m):
        hit, valid, elsewhere, collided = self.shadow.hit, self.valid, self.elsewhere, self.collided
        before, after, stages = self.shadow.before, self.shadow.after, self.shadow.stages
        tag = self.shadow.line(m, "tag", self.dut.i.payload.tag, self.dut.config.tag_bits)
        grows = [hit[n] & (before[n].tag == tag[n]) & (before[n].i != 0) & (before[n].i != after[n].i) for n in stages]
        anew = [hit[n] & (before[n].tag != tag[n]) & (before[n].i != 0) for n in stages]
        alone = ~hit[0] & ~hit[1] & ~hit[2] & ~hit[3] & ~collided[3]
        return [
            grows[0] & grows[1] & grows[2] & grows[3] & grows[4],  # five in a row
            grows[0] & elsewhere[1] & grows[2],  # two apart, another row between
            grows[0] & elsewhere[1] & ~valid[2] & grows[3],  # three apart
            grows[0] & elsewhere[1] & elsewhere[2] & ~valid[3] & grows[4],  # four apart
            anew[0] & hit[1],  # another tag right behind
            anew[0] & elsewhere[1] & hit[2],  # another tag two behind
            anew[0] & elsewhere[1] & elsewhere[2] & hit[3],  # another tag three behind
            anew[0] & elsewhere[1] & elsewhere[2] & elsewhere[3] & hit[4],  # another tag four behind
            anew[0] & anew[1] & hit[2] & (tag[0] == tag[2]),  # the first tag again: its sum must not come back
            grows[0] & (after[0].i < before[0].i),  # a total that wraps
            hit[4] & collided[3] & (before[4].i != 0),  # an answer whose read collided
            grows[4] & alone,  # a word of this tag out of the RAM
            anew[4] & alone,  # a word of another tag out of the RAM
        ]
