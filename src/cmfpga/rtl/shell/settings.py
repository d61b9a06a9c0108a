"""Settings: what software wrote, limited to what is allowed, and handed over batch by batch."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import memory
from amaranth.lib.wiring import In, Out

from .. import Block
from . import payloads
from .register_bank import in_memory, layout_of, member

#: Words of the memory: the registers' addresses, modulo so many.
WORDS = 32


class Settings(Block):
    """The registers that are stored as whole words, and the settings of the next batch.

    A memory keeps the words as they were written. One limiter takes each over, two cycles after it was written; while
    ``lock`` is high it takes none over, and all of them behind that, during which no write is ready and no batch may
    begin. Settings with fewer bits come from the register bank. What stands here in the cycle of ``opened`` are a
    batch's settings.

    A reset clears no memory: behind one, the registers' reset values are written into it, and no write is ready.

    Parameters
    ----------
    registers : RegisterMap

    Members
    -------
    bus : ``In``, :func:`payloads.register_bus`
        Answers 0 where it has no register.
    written : ``In``
        Stored fields and flags, as the register bank's ``values`` has them.
    lock : ``In(1)``
    opened : ``In(1)``
    o : ``Out``, :func:`payloads.settings`
    blocking : ``Out(1)``
        No batch may begin.
    out_of_range : ``Out(1)``
        A value of ``o`` was limited.
    used_roi : ``Out(1)``
        One cycle: the ROI was loaded.
    """

    #: Cycles behind a reset in which the memory is filled.
    fill = WORDS

    def __init__(self, config, registers):
        self.registers = registers
        self.kept = [register for register in registers if in_memory(register)]
        places = [register.offset // 4 % WORDS for register in self.kept]
        assert len(set(places)) == len(places)
        super().__init__(
            config,
            bus=In(payloads.register_bus()),
            written=In(layout_of(registers.group("Settings"), "stored", "flag")),
            lock=In(1),
            opened=In(1),
            o=Out(payloads.settings(config)),
            **dict.fromkeys(("blocking", "out_of_range", "used_roi"), Out(1)),
        )

    def elaborate(self, platform):
        m = Module()
        bus, address = self.bus, self.bus.write.payload.address
        m.submodules.store = store = memory.Memory(shape=32, depth=WORDS, init=[])
        put = store.write_port(granularity=8)
        get = store.read_port(domain="comb")
        place = {register.offset // 4: register.offset // 4 % WORDS for register in self.kept}

        # All words in turn behind a lock; else the one that was just written, but not while software reads.
        filling, locked, walking, taking, mine = Signal(init=1), Signal(), Signal(), Signal(), Signal()
        current = Signal(range(WORDS))
        m.d.comb += [
            self.blocking.eq(filling | locked & ~self.lock | walking),
            bus.write.ready.eq(~(self.blocking | taking & bus.read)),
            mine.eq(bus.write.valid & bus.write.ready & address.matches(*place)),
        ]
        m.d.sync += locked.eq(self.lock)
        with m.If(filling):
            m.d.sync += [current.eq(current + 1), filling.eq(current != self.fill - 1)]
        with m.Elif(~(taking & bus.read)):
            m.d.sync += [current.eq(address), taking.eq(mine & ~self.lock)]
            with m.If(self.blocking):
                m.d.sync += [walking.eq(~(walking & (current == WORDS - 1))), taking.eq(1)]
                m.d.sync += current.eq(Mux(walking, current + 1, 0))

        # The memory.
        resets = {r.offset // 4 % WORDS: r.reset for r in self.kept}
        default = Cat(current.matches(*(k for k, reset in resets.items() if reset >> bit & 1)) for bit in range(32))
        m.d.comb += [
            put.addr.eq(Mux(filling, current, address)),
            put.data.eq(Mux(filling, default, bus.write.payload.data)),
            put.en.eq(Mux(filling, 0b1111, Mux(mine, bus.write.payload.strobe, 0))),
            get.addr.eq(Mux(bus.read, bus.read_address, current)),
        ]
        with m.If(bus.read_address.matches(*place)):
            m.d.comb += bus.read_data.eq(get.data)
        # A walk's last word is no setting, so that all have been limited when it ends.
        taken, place_s1, word_s1 = Signal(), Signal.like(current), Signal(32)
        assert all(r.group != "Settings" or r.offset // 4 % WORDS != WORDS - 1 for r in self.kept)
        m.d.sync += [taken.eq(taking & ~bus.read), place_s1.eq(current), word_s1.eq(get.data)]
        self._limit(m, taken, place_s1, word_s1)
        self._narrow(m)
        m.d.comb += self.used_roi.eq(self.opened & ~self.lock)
        return m

    def _limit(self, m, taken, current, word):
        """Take over the fields of a register, each in the range that the register says."""
        lanes = {0: {}, 16: {}}  # by the fields' lowest bit: place in the memory, link, field, targets
        for link, ((register, f),) in self.registers.linked("Settings").items():
            if in_memory(register):
                lanes[f.lsb][register.offset // 4 % WORDS] = link, f, self._targets(link)
        limited, wrong = {}, []
        for lsb, fields in lanes.items():
            limited[lsb] = self._limited(m, fields, current, word[lsb:], wrong)
        limits = Signal(WORDS)
        for lsb, fields in lanes.items():
            for k, (link, f, targets) in fields.items():
                register = Signal(targets[0].shape(), init=f.reset, name=link)
                m.d.comb += [target.eq(register) for target in targets]
                with m.If(taken & (current == k)):
                    m.d.sync += [register.eq(limited[lsb]), limits[k].eq(Cat(wrong).any())]
        m.d.comb += self.out_of_range.eq(limits.any())

    def _limited(self, m, fields, current, word, wrong):
        """The field that begins with ``word``, limited; appends to ``wrong`` whether it had to be.

        Negative numbers are limited as their complements, for their range is symmetric.
        """
        highs = [0] * WORDS
        for k, (_, f, targets) in fields.items():
            fits = (1 << len(targets[0])) - 1
            highs[k] = f.high if f.high is not None else min(fits, f.range[1])  # not allowed to alias
            assert f.low in (None, 0, 1) or (f.low == ~highs[k] and f.width == len(word))
        width = max(max(highs).bit_length() + any(f.signed for _, f, _ in fields.values()), 1)

        def where(condition):
            return current.matches(*(k for k, (_, f, _) in fields.items() if condition(f)))

        high = Cat(current.matches(*(k for k, h in enumerate(highs) if h >> bit & 1)) for bit in range(width))
        negative, beyond, zero = Signal(), Signal(), Signal()
        turned = word ^ negative.replicate(len(word))
        # A bit above a field's limit, by the fields that have it; or more than a limit that is not all ones.
        above = {}
        for bit in range(len(word)):
            having = (k for k, (_, f, _) in fields.items() if highs[k].bit_length() <= bit < f.width)
            above.setdefault(tuple(having), []).append(turned[bit])
        found = [Cat(bits).any() & current.matches(*having) for having, bits in above.items()]
        for k in fields:
            size = highs[k].bit_length()
            if highs[k] != (1 << size) - 1:
                found.append((current == k) & (turned[:size] > highs[k]))
        m.d.comb += [
            negative.eq(word[-1] & where(lambda f: f.signed)),
            beyond.eq(Cat(found).any()),
            zero.eq((word == 0) & where(lambda f: f.low == 1)),
        ]
        wrong.append(beyond | zero)
        return Mux(beyond, high ^ negative.replicate(width), word[:width]) | zero

    def _narrow(self, m):
        """Settings with a few bits, out of the register bank."""
        for link, ((register, f),) in self.registers.linked("Settings").items():
            if in_memory(register):
                continue
            written, (target, *_) = self.written[member(register, f)], self._targets(link)
            if f.access == "flag":
                m.d.comb += target.eq(written & ~self.lock)
                continue
            taken = Signal(len(target), init=f.reset, name=link)
            m.d.comb += target.eq(taken)
            with m.If(~self.lock):
                m.d.sync += taken.eq(written)

    def _targets(self, link):
        """Where a setting goes: the core's settings (``v_start_x`` is ``v_start.x``), the batch end's, or both."""
        found = []
        for part in (self.o.core, self.o.end):
            members = part.shape().members
            if link in members:
                found.append(part[link])
                continue
            outer, _, inner = link.rpartition("_")
            if outer in members:
                found.append(part[outer][inner])
        assert found, link
        return found
