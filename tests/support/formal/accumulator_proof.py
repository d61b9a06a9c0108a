"""The properties of the accumulator: a shadow of one row, and what must agree with it."""

from amaranth.asserts import AnySeq
from amaranth.hdl import Assert, Assume, Cover, Mux, Signal

from cmfpga.config import Config
from support.formal.harness import Harness

# Twelve memories with words of 3 and 4 bits.
TINY = Config(roi_width=6, roi_height=4, buffer_events=3, weight_frac=1, derivative_frac=1)

# An operation reaches the RAM's write port this many cycles after it was offered.
WRITE = 3


def anything(target):
    """Drive an input freely."""
    return target.eq(AnySeq(target.shape().width))


class RowShadow:
    """The word that one row should hold, and the operations on it that are under way.

    The shadow changes at once with each operation on the row. ``valid``, ``hit``, ``clear``, ``before`` and ``after``
    are delay lines: item ``n`` is about the operation that was offered ``n`` cycles ago, and is what the pipeline
    has to agree with where that operation is then.

    Parameters
    ----------
    word : :class:`StructLayout`
        Members of the row.
    latency : int
        Cycles until the answer.
    name : str
        Prefix of the signals' names.
    """

    def __init__(self, word, latency, name):
        self.word = word
        self.shadow = Signal(word, name=f"{name}_shadow")
        self.stages = range(max(WRITE, latency) + 1)
        self.valid = [Signal(name=f"{name}_valid_{n}") for n in self.stages]
        self.hit = [Signal(name=f"{name}_hit_{n}") for n in self.stages]
        self.clear = [Signal(name=f"{name}_clear_{n}") for n in self.stages]
        self.before = [Signal(word, name=f"{name}_before_{n}") for n in self.stages]
        self.after = [Signal(word, name=f"{name}_after_{n}") for n in self.stages]

    def follow(self, m, *, valid, hit, clear, add):
        """Take in the operation that is offered."""
        m.d.comb += [
            self.valid[0].eq(valid),
            self.hit[0].eq(hit),
            self.clear[0].eq(clear),
            self.before[0].eq(self.shadow),
        ]
        for name in self.word.members:
            m.d.comb += self.after[0][name].eq(Mux(clear, 0, self.shadow[name] + add[name]))
        with m.If(self.hit[0]):
            m.d.sync += self.shadow.eq(self.after[0])
        for line in (self.valid, self.hit, self.clear, self.before, self.after):
            m.d.sync += [line[n].eq(line[n - 1]) for n in self.stages if n]

    def check_memory(self, m, memories):
        """Every total of the row is written, is right, and nothing else is written."""
        for name, memory in zip(self.word.members, memories, strict=True):
            m.d.comb += [
                Assert(memory.written == self.hit[WRITE]),
                # The induction stands on this: what is not under way any more is in the RAM.
                Assert(memory.content == self.before[WRITE][name]),
            ]
            with m.If(self.hit[WRITE]):
                m.d.comb += Assert(memory.write.data == self.after[WRITE][name])

    def check_answer(self, m, payload, latency):
        """What is answered to an operation on the row is the row's word before it."""
        with m.If(self.hit[latency]):
            for name in self.word.members:
                m.d.comb += Assert(payload[name] == self.before[latency][name])


class ReadAddWriteHarness(Harness):
    """Any operation in any cycle into one bank."""

    COVERS = 10

    def __init__(self, dut):
        super().__init__(dut, dut.depth)

    def properties(self, m, row, memories):
        dut = self.dut
        operation = dut.i.payload
        m.d.comb += [anything(dut.i.valid), anything(operation.as_value())]

        shadow = RowShadow(dut.word, dut.latency, "expected")
        shadow.follow(
            m,
            valid=dut.i.valid,
            hit=dut.i.valid & (operation.address == row),
            clear=operation.clear,
            add=operation.add,
        )
        shadow.check_memory(m, memories)
        shadow.check_answer(m, dut.o.payload, dut.latency)
        m.d.comb += Assert(dut.o.valid == shadow.valid[dut.latency])
        self._cover(m, shadow, memories[0], next(iter(dut.word.members)))

    def _cover(self, m, shadow, memory, member):
        """The cases that make the proof worth something can all happen. Item 0 is the youngest operation."""
        hit, clear, valid = shadow.hit, shadow.clear, shadow.valid
        before, after = [word[member] for word in shadow.before], [word[member] for word in shadow.after]
        grows = [hit[n] & ~clear[n] & (before[n] != after[n]) for n in shadow.stages]
        elsewhere = [valid[n] & ~hit[n] for n in shadow.stages]
        collided = Signal(len(shadow.stages))
        m.d.sync += collided.eq((collided << 1) | memory.collision)
        cases = [
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
        assert len(cases) == self.COVERS
        m.d.comb += [Cover(case) for case in cases]


class AccumulatorHarness(Harness):
    """Any votes and any sweep, not in the same cycle, into the four banks."""

    COVERS = 2

    def __init__(self, dut):
        super().__init__(dut, dut.config.geometry.bank_depth)

    def properties(self, m, row, memories):
        dut = self.dut
        votes, sweep = dut.i, dut.sweep
        m.d.comb += [
            anything(votes.valid),
            anything(votes.payload.as_value()),
            anything(sweep.valid),
            anything(sweep.payload.as_value()),
            Assume(~(votes.valid & sweep.valid)),
        ]
        swept = [sweep.valid & (sweep.payload.address == row)]
        offered = [sweep.valid]
        for n in range(1, dut.latency + 1):
            for line, name in ((swept, "swept"), (offered, "offered")):
                line.append(Signal(name=f"{name}_{n}"))
                m.d.sync += line[n].eq(line[n - 1])
        m.d.comb += Assert(dut.o.valid == offered[dut.latency])

        word = dut.o.payload[0].shape()
        for number in range(4):
            vote = votes.payload.banks[number]
            shadow = RowShadow(word, dut.latency, f"expected_{number}")
            voted = votes.valid & vote.valid & (vote.address == row)
            shadow.follow(m, valid=votes.valid | sweep.valid, hit=voted | swept[0], clear=sweep.valid, add=vote)
            shadow.check_memory(m, memories[number * len(word.members) :][: len(word.members)])
            with m.If(swept[dut.latency]):
                shadow.check_answer(m, dut.o.payload[number], dut.latency)
            if number in (0, 3):  # the sweep right behind three votes finds all of them, and leaves nothing
                grows = [shadow.hit[n] & (shadow.before[n].i != shadow.after[n].i) for n in shadow.stages]
                m.d.comb += Cover(grows[3] & grows[2] & grows[1] & swept[0] & (shadow.after[0].i == 0))
