"""The properties of the tagged accumulator: a shadow of one row of a bank, and of one pixel of an iteration."""

from amaranth.asserts import AnyConst
from amaranth.hdl import Assert, Assume, Const, Cover, Module, Mux, Signal, Value
from amaranth.lib import data

from cmfpga.config import Config
from cmfpga.rtl import payloads
from support.formal.accumulator_proof import WRITE, anything
from support.formal.harness import AnyOnCollision, Harness, RowModel


def tiny(width, height, tag_bits=2):
    """Words that wrap after a few operations, and three tags."""
    return Config(
        roi_width=width, roi_height=height, buffer_events=3, weight_frac=1, derivative_frac=1, gradient="one_pass",
        tag_bits=tag_bits,
    )  # fmt: skip


class TaggedShadow:
    """The word {tag, pixel} that one row of a bank should hold, and the operations on it that are under way.

    The shadow changes at once with each operation on the row. ``hit``, ``base``, ``before`` and ``after`` are delay
    lines: item ``n`` is about the operation that was offered ``n`` cycles ago. ``base`` is the pixel that counts.
    """

    def __init__(self, config, name):
        self.pixel = payloads.pixel(config)
        self.word = data.StructLayout({**self.pixel.members, "tag": config.tag_bits})
        self.name = name
        self.stages = range(WRITE + 1)
        self.shadow = Signal(self.word, name=f"{name}_shadow")
        self.hit = self.line(1, "hit")
        self.base = self.line(self.pixel, "base")
        self.before, self.after = self.line(self.word, "before"), self.line(self.word, "after")

    def line(self, shape, name):
        return [Signal(shape, name=f"{self.name}_{name}_{n}") for n in self.stages]

    def delay(self, m, *lines):
        for line in lines:
            m.d.sync += [line[n].eq(line[n - 1]) for n in self.stages if n]

    def follow(self, m, *, hit, tag, add, first):
        """Take in the operation that is offered; ``first`` is the word that the row starts with.

        A register starts at a constant, so those that hold the word hold its difference from that.
        """
        difference = [Signal(len(first), name=f"{self.name}_difference_{n}") for n in self.stages]
        for n in self.stages[1:]:
            m.d.sync += difference[n].eq(difference[n - 1])
            m.d.comb += self.before[n].as_value().eq(first ^ difference[n])
        m.d.comb += [
            self.shadow.as_value().eq(first ^ difference[0]),
            self.hit[0].eq(hit),
            self.before[0].eq(self.shadow),
            self.after[0].tag.eq(tag),
        ]
        for name in self.pixel.members:
            m.d.comb += [
                self.base[0][name].eq(Mux(self.shadow.tag == tag, self.shadow[name], 0)),
                self.after[0][name].eq(self.base[0][name] + add[name]),
            ]
        with m.If(hit):
            m.d.sync += difference[0].eq(first ^ self.after[0].as_value())
        self.delay(m, self.hit, self.base, self.after)

    def check_memory(self, m, memory):
        """Every word of the row is written, is right, and nothing else is written."""
        m.d.comb += [
            Assert(memory.written == self.hit[WRITE]),
            # The induction stands on this: what is not under way any more is in the RAM.
            *(Assert(memory.content[name] == self.before[WRITE][name]) for name in self.word.members),
        ]
        with m.If(self.hit[WRITE]):
            m.d.comb += [Assert(memory.write.data[name] == self.after[WRITE][name]) for name in self.word.members]


# ---------------------------------------------------------------- one bank


class TaggedBankHarness(Harness):
    """Any operation in any cycle, with any tag, into one bank."""

    COVERS = 11

    def __init__(self, dut):
        super().__init__(dut, dut.config.geometry.bank_depth)

    def properties(self, m, row, memories):
        dut, (memory,) = self.dut, memories
        operation, answer = dut.i.payload, dut.o.payload
        m.d.comb += [
            anything(dut.i.valid),
            anything(operation.as_value()),
            Assume(~dut.i.valid | (operation.address < self.depth)),
        ]
        shadow = TaggedShadow(dut.config, "expected")
        hit = dut.i.valid & (operation.address == row)
        first = Const(0, Value.cast(memory.content).shape().width)
        shadow.follow(m, hit=hit, tag=operation.tag, add=operation.add, first=first)
        shadow.check_memory(m, memory)

        valid, tag, add = (
            shadow.line(port.shape(), name)
            for port, name in ((dut.i.valid, "valid"), (operation.tag, "tag"), (operation.add, "add"))
        )
        m.d.comb += [valid[0].eq(dut.i.valid), tag[0].eq(operation.tag), add[0].eq(operation.add)]
        shadow.delay(m, valid, tag, add)
        m.d.comb += Assert(dut.o.valid == valid[dut.latency])
        with m.If(shadow.hit[dut.latency]):
            m.d.comb += [
                Assert(answer.i == shadow.base[dut.latency].i),
                *(Assert(answer.total[name] == shadow.after[dut.latency][name]) for name in shadow.pixel.members),
                *(Assert(answer.add[name] == add[dut.latency][name]) for name in shadow.pixel.members),
            ]
        self._cover(m, memory, shadow, valid, tag)

    def _cover(self, m, memory, shadow, valid, tag):
        """The cases that make the proof worth something can all happen. Item 0 is the youngest operation."""
        hit, before, after, stages = shadow.hit, shadow.before, shadow.after, shadow.stages
        grows = [hit[n] & (before[n].tag == tag[n]) & (before[n].i != 0) & (before[n].i != after[n].i) for n in stages]
        anew = [hit[n] & (before[n].tag != tag[n]) & (before[n].i != 0) for n in stages]
        elsewhere = [valid[n] & ~hit[n] for n in stages]
        collided = Signal(len(hit))
        m.d.sync += collided.eq((collided << 1) | memory.collision)
        alone = ~hit[0] & ~hit[1] & ~hit[2] & ~collided[2]
        cases = [
            grows[0] & grows[1] & grows[2] & grows[3],  # four in a row
            grows[0] & elsewhere[1] & grows[2],  # two apart, another row between
            grows[0] & elsewhere[1] & ~valid[2] & grows[3],  # three apart
            anew[0] & hit[1],  # another tag right behind
            anew[0] & elsewhere[1] & hit[2],  # another tag two behind
            anew[0] & elsewhere[1] & elsewhere[2] & hit[3],  # another tag three behind
            anew[0] & anew[1] & hit[2] & (tag[0] == tag[2]),  # the first tag again: its sum must not come back
            grows[0] & (after[0].i < before[0].i),  # a total that wraps
            hit[3] & collided[2] & (before[3].i != 0),  # an answer whose read collided
            grows[3] & alone,  # a word of this tag out of the RAM
            anew[3] & alone,  # a word of another tag out of the RAM
        ]
        assert len(cases) == self.COVERS
        m.d.comb += [Cover(case) for case in cases]


# ---------------------------------------------------------------- the accumulator


class AnyContent(AnyOnCollision):
    """Rows that start with any word: what a reset, which clears no RAM, may leave there."""

    def get_memory(self, memory):
        self.memories.append(AnyRow(memory, self.row))
        return self.memories[-1]


class AnyRow(RowModel):
    """Like :class:`RowModel`, with a constant that the solver chooses for the first word."""

    def __init__(self, memory, row):
        super().__init__(memory, row)
        self.first = Signal.like(Value.cast(self.content))

    def elaborate(self, platform):
        m = Module()
        difference, noise = Signal.like(self.first), Signal.like(self.first)
        content = Value.cast(self.content)
        m.d.comb += [
            self.first.eq(AnyConst(len(content))),
            anything(noise),
            content.eq(self.first ^ difference),
            self.written.eq(self.write.en & (self.write.addr == self.row)),
            self.collision.eq(self.written & self.read.en & (self.read.addr == self.row)),
        ]
        with m.If(self.written):
            m.d.sync += difference.eq(self.first ^ Value.cast(self.write.data))
        with m.If(self.read.en):
            known = (self.read.addr == self.row) & ~self.written
            m.d.sync += Value.cast(self.read.data).eq(Mux(known, content, noise))
        return m


class TaggedAccumulatorHarness(Harness):
    """Any iterations, ``idle`` cycles or more apart, after the sweep's first pass over RAMs that hold anything.

    One pixel of each of ``banks`` is followed as an image is defined: empty when an iteration begins, and then the sum
    of its votes. That no vote sees a word of an earlier iteration is what makes the bank agree with it.

    Why it holds, as the induction needs to be told (:meth:`_promise`): a word whose tag is the number ``age``
    iterations back was written at most so many idle cycles ago as the sweep still needs to reach it, less a pass; and
    ``age`` iterations are ``age`` · ``idle`` such cycles at least. So a word never gets as old as there are tags.
    """

    COVERS = 2

    def __init__(self, dut, idle, banks=range(4)):
        super().__init__(dut, dut.config.geometry.bank_depth)
        self.idle, self.banks = idle, banks
        self.tags = (1 << dut.config.tag_bits) - 1

    def elaborate(self, platform):
        return super().elaborate(AnyContent(self.depth))

    def properties(self, m, row, memories):
        dut = self.dut
        votes = dut.i.payload
        m.d.comb += [anything(dut.i.valid), anything(votes.as_value()), anything(dut.next_tag)]
        m.d.comb += [
            Assume(~(dut.i.valid & votes.banks[n].valid) | (votes.banks[n].address < self.depth)) for n in range(4)
        ]
        self._iterations(m)
        # Registers, which the induction has to be told about. These names are not part of the interface.
        self.tag, self.address = self.register("tag"), self.register("address")
        m.d.comb += [Assert((self.tag >= 1) & (self.tag <= self.tags)), Assert(self.address < self.depth)]
        # Only for the covers.
        iteration = Signal(4)
        m.d.sync += iteration.eq(iteration + dut.next_tag)
        for number in self.banks:
            self._bank(m, row, memories[number], number, iteration)

    def _iterations(self, m):
        """Events without a gap, then ``idle`` cycles or more, ``next_tag`` in one of them."""
        dut = self.dut
        self.ready, self.running, self.over = Signal(), Signal(), Signal(init=1)
        self.passed = Signal(range(self.idle + 1), init=self.idle)
        with m.If(dut.swept):
            m.d.sync += self.ready.eq(1)
        m.d.sync += self.running.eq(dut.i.valid)
        with m.If(dut.i.valid):
            m.d.sync += [self.passed.eq(0), self.over.eq(0)]
        with m.Else():
            m.d.sync += self.over.eq(self.over | dut.next_tag)
            with m.If(self.passed != self.idle):
                m.d.sync += self.passed.eq(self.passed + 1)
        m.d.comb += [
            Assume(~dut.i.valid | (self.ready & (self.running | (self.over & (self.passed == self.idle))))),
            Assume(~dut.next_tag | ~(dut.i.valid | self.over)),
            Assert(self.passed <= self.idle),
            Assert(self.running == ((self.passed == 0) & ~self.over)),
            Assert(self.ready | (self.over & (self.passed == self.idle))),
        ]

    def _bank(self, m, row, memory, number, iteration):
        dut = self.dut
        vote, step = dut.i.payload.banks[number], dut.o[number]
        shadow = TaggedShadow(dut.config, f"bank_{number}")
        voted = Signal(name=f"voted_{number}")
        m.d.comb += voted.eq(dut.i.valid & vote.valid & (vote.address == row))
        swept = ~dut.i.valid & (self.address == row)
        add = {name: Mux(dut.i.valid, vote[name], 0) for name in shadow.pixel.members}
        tag = Mux(dut.i.valid, self.tag, 0)
        shadow.follow(m, hit=voted | swept, tag=tag, add=add, first=memory.first)
        shadow.check_memory(m, memory)

        # The pixel as an image has it.
        image, used = Signal(shadow.pixel, name=f"image_{number}"), Signal(name=f"used_{number}")
        before, after = shadow.line(shadow.pixel, "image_before"), shadow.line(shadow.pixel, "image_after")
        offered, hit = shadow.line(1, "offered"), shadow.line(1, "voted")
        m.d.comb += [
            offered[0].eq(dut.i.valid & vote.valid),
            hit[0].eq(voted),
            before[0].eq(image),
            *(after[0][name].eq(image[name] + vote[name]) for name in shadow.pixel.members),
        ]
        shadow.delay(m, before, after, offered, hit)
        with m.If(dut.next_tag):
            m.d.sync += [image.eq(0), used.eq(0)]
        with m.Elif(voted):
            m.d.sync += [image.eq(after[0]), used.eq(1)]
        m.d.comb += Assert(step.valid == offered[dut.latency])
        with m.If(hit[dut.latency]):
            m.d.comb += [
                Assert(step.i == before[dut.latency].i),
                *(Assert(step.total[name] == after[dut.latency][name]) for name in shadow.pixel.members),
            ]
        self._promise(m, row, shadow.shadow, number, image=image, used=used, voted=voted)
        # The pipeline's stages, too, agree with the image; the induction need not look back farther than a cycle.
        for n in shadow.stages:
            with m.If(hit[n]):
                m.d.comb += Assert((shadow.base[n] == before[n]) & shadow.hit[n])

        seen = Signal(name=f"seen_{number}")
        with m.If(voted & (iteration == 0) & (after[0].i != 0)):
            m.d.sync += seen.eq(1)
        again = hit[dut.latency] & (iteration == self.tags) & seen
        m.d.comb += [
            Cover(again & (before[dut.latency].i == 0)),  # a word that was used, and its tag is back
            Cover(again & (before[dut.latency].i != 0)),
        ]

    def _promise(self, m, row, word, number, *, image, used, voted):
        """How old a word can be, from where the sweep is."""
        dut, tags, idle = self.dut, self.tags, self.idle
        age = Signal(range(tags + 1), name=f"age_{number}")  # iterations since the row's last vote
        with m.If(voted):
            m.d.sync += age.eq(0)
        with m.Elif(dut.next_tag & (age != tags)):
            m.d.sync += age.eq(age + 1)
        marked = word.tag != 0
        back = Mux(self.tag > age, self.tag - age, self.tag + tags - age)
        to_go = Mux(row >= self.address, row - self.address, row + self.depth - self.address)
        gone = age * idle + self.passed - Mux(self.over, idle, 0)
        with m.If(~self.ready):
            m.d.comb += [Assert(self.tag == 1), Assert(~used)]
            with m.If(row < self.address):
                m.d.comb += Assert(~marked)
        with m.Elif(marked):
            m.d.comb += [
                Assert(word.tag == back),
                Assert(~self.over | (age != 0)),
                Assert(to_go + gone < self.depth),
                Assert(used == (age == 0)),
            ]
        m.d.comb += Assert(~used | ~self.over)
        with m.If(~used):
            m.d.comb += Assert(image.as_value() == 0)
        with m.Else():
            m.d.comb += Assert(marked | ~self.running)
            with m.If(marked):
                m.d.comb += [Assert(word[name] == image[name]) for name in image.shape().members]

    def register(self, name):
        """A register of the device by its name."""
        found = [
            signal
            for statement in self.fragment.statements["sync"]
            for signal in statement._lhs_signals()
            if signal.name == name
        ]
        assert found, f"no register {name!r} in {type(self.dut).__name__}: what the induction is told has to follow"
        return found[0]
