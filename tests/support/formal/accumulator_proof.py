"""The properties of both accumulators: a shadow of one row of a bank, and of one pixel of an iteration."""

from amaranth.hdl import Assert, Assume, Cover, Mux, Signal, signed
from amaranth.lib import data

from cmfpga.config import Config
from cmfpga.rtl import payloads
from support.formal.bank_proof import ReadAddWriteHarness, RowShadow, anything, tagged_word
from support.formal.harness import Harness

# Twelve memories with words of 3 and 4 bits.
TINY = Config(roi_width=6, roi_height=4, buffer_events=3, weight_frac=1, derivative_frac=1)


def tiny(width, height, tag_bits=2):
    """Words that wrap after a few operations, and three tags."""
    return TINY.replace(roi_width=width, roi_height=height, gradient="one_pass", tag_bits=tag_bits)


def small_bank(bank):
    """Words that wrap after a few operations, and a depth that is no power of two."""
    word = data.StructLayout({"i": 4, "dx": signed(3)})
    add = data.StructLayout({"i": 3, "dx": signed(2)})
    return ReadAddWriteHarness(bank(word, add, 6))


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
            shadow = RowShadow(word, f"expected_{number}", dut.latency)
            voted = votes.valid & vote.valid & (vote.address == row)
            after = {name: Mux(sweep.valid, 0, shadow.shadow[name] + vote[name]) for name in word.members}
            shadow.follow(m, hit=voted | swept[0], after=after)
            shadow.check_memory(m, memories[number * len(word.members) :][: len(word.members)])
            with m.If(swept[dut.latency]):
                m.d.comb += Assert(dut.o.payload[number] == shadow.before[dut.latency])
            if number in (0, 3):  # the sweep right behind three votes finds all of them, and leaves nothing
                grows = [shadow.hit[n] & (shadow.before[n].i != shadow.after[n].i) for n in shadow.stages]
                m.d.comb += Cover(grows[3] & grows[2] & grows[1] & swept[0] & (shadow.after[0].i == 0))


class TaggedAccumulatorHarness(Harness):
    """Any iterations, ``idle`` cycles or more apart, after the sweep's first pass over RAMs that hold anything.

    One pixel of each of ``banks`` is followed as an image is defined: empty when an iteration begins, and then the sum
    of its votes. That no vote sees a word of an earlier iteration is what makes the bank agree with it.

    Why it holds, as the induction needs to be told (:meth:`_promise`): a word whose tag is the number ``age``
    iterations back was written at most so many idle cycles ago as the sweep still needs to reach it, less a pass; and
    ``age`` iterations are ``age`` · ``idle`` such cycles at least. So a word never gets as old as there are tags.
    """

    COVERS = 2
    any_content = True

    def __init__(self, dut, idle, banks=range(4)):
        super().__init__(dut, dut.config.geometry.bank_depth)
        self.idle, self.banks = idle, banks
        self.tags = (1 << dut.config.tag_bits) - 1

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
        pixel = payloads.pixel(dut.config)
        shadow = RowShadow(tagged_word(dut.config), f"bank_{number}", dut.latency)
        voted = Signal(name=f"voted_{number}")
        m.d.comb += voted.eq(dut.i.valid & vote.valid & (vote.address == row))
        swept = ~dut.i.valid & (self.address == row)
        tag = Mux(dut.i.valid, self.tag, 0)
        base = {name: Mux(shadow.shadow.tag == tag, shadow.shadow[name], 0) for name in pixel.members}
        after = {name: base[name] + Mux(dut.i.valid, vote[name], 0) for name in pixel.members}
        shadow.follow(m, hit=voted | swept, after=after | {"tag": tag}, first=memory.first)
        shadow.check_memory(m, [memory])
        counts = shadow.line(m, "base", base, pixel)

        # The pixel as an image has it.
        image, used = Signal(pixel, name=f"image_{number}"), Signal(name=f"used_{number}")
        offered, hit = shadow.line(m, "offered", dut.i.valid & vote.valid), shadow.line(m, "voted", voted)
        before = shadow.line(m, "image_before", image, pixel)
        after = {name: image[name] + vote[name] for name in pixel.members}
        after = shadow.line(m, "image_after", after, pixel)
        with m.If(dut.next_tag):
            m.d.sync += [image.eq(0), used.eq(0)]
        with m.Elif(voted):
            m.d.sync += [image.eq(after[0]), used.eq(1)]
        m.d.comb += Assert(step.valid == offered[dut.latency])
        with m.If(hit[dut.latency]):
            m.d.comb += [
                Assert(step.i == before[dut.latency].i),
                *(Assert(step.total[name] == after[dut.latency][name]) for name in pixel.members),
            ]
        self._promise(m, row, shadow.shadow, number, image=image, used=used, voted=voted)
        # The pipeline's stages, too, agree with the image; the induction need not look back farther than a cycle.
        for n in shadow.stages:
            with m.If(hit[n]):
                m.d.comb += Assert((counts[n] == before[n]) & shadow.hit[n])

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
