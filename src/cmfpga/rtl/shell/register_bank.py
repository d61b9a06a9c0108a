"""Register bank: the words of the register map, made from its declaration."""

from amaranth.hdl import Cat, Const, Module, Mux, Shape, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from . import payloads

#: Words that one multiplexer of the first stage reads.
BLOCK = 16


def member(register, field):
    """Name of a field's member in the bank's layouts: ``ctrl_start``."""
    return f"{register.name}_{field.name}".lower()


def fields_of(registers, *access):
    """``(register, field)`` of all fields with one of these kinds of access, arrays left out."""
    return [
        (register, f) for register in registers if register.count == 1 for f in register.fields if f.access in access
    ]


def layout_of(registers, *access, width=None):
    """One member for each of these fields; ``width`` bits wide, or as wide as the field."""
    return data.StructLayout(
        {member(register, f): width or Shape(f.width, f.signed) for register, f in fields_of(registers, *access)}
    )


class RegisterBank(wiring.Component):
    """Stores what software writes, and reads what hardware shows.

    A write takes effect in the following cycle. Software wins where it sets a flag in the cycle in which hardware
    clears it; hardware wins where it sets a sticky bit in the cycle in which software clears it.

    Parameters
    ----------
    registers : RegisterMap
        Arrays of it are left to others.

    Members
    -------
    bus : ``In``, :func:`payloads.register_bus`
        Data that are read come :attr:`latency` cycles after their address; 0 where there is no register.
    values : ``Out``
        Fields that are stored, flags and sticky bits.
    status : ``In``
        Fields that the hardware drives.
    set, clear : ``In``
        One cycle each: set a sticky bit; clear a flag.
    commands : ``Out``
        One cycle each.
    """

    latency = 2

    def __init__(self, registers):
        self.registers = registers
        super().__init__(
            {
                "bus": In(payloads.register_bus()),
                "values": Out(layout_of(registers, "stored", "flag", "sticky")),
                "status": In(layout_of(registers, "status")),
                "set": In(layout_of(registers, "sticky", width=1)),
                "clear": In(layout_of(registers, "flag", width=1)),
                "commands": Out(layout_of(registers, "command")),
            }
        )

    def elaborate(self, platform):
        m = Module()
        words = {}
        for register in self.registers:
            if register.count == 1:
                words[register.offset // 4] = self._word(m, register)
        self._read(m, words)
        return m

    def _word(self, m, register):
        """Make a register; the word that is read of it."""
        write = self.bus.write.payload
        written = Signal(name=f"write_{register.name.lower()}")
        if any(f.writable for f in register.fields):
            m.d.comb += written.eq(self.bus.write.valid & (write.address == register.offset // 4))
        mask = Cat(*(bit.replicate(8) for bit in write.strobe))
        parts, position = [], 0
        for f in register.fields:
            name = member(register, f)
            bits = slice(f.lsb, f.lsb + f.width)
            ones = write.data[bits] & mask[bits]
            if f.access == "constant":
                value = Const(f.reset, f.width)
            elif f.access == "status":
                value = self.status[name]
            elif f.access == "command":
                value = Const(0, f.width)
                m.d.comb += self.commands[name].eq(ones & written.replicate(f.width))
            else:
                stored = Signal(Shape(f.width, f.signed), init=f.reset, name=name)
                m.d.comb += self.values[name].eq(stored)
                value = stored.as_unsigned() if f.signed else stored
                self._store(m, f, stored, value, written, ones, mask[bits], name)
            parts += [Const(0, f.lsb - position), value]
            position = f.lsb + f.width
        return Cat(*parts)

    def _store(self, m, f, stored, value, written, ones, mask, name):
        if f.access == "sticky":
            with m.If(written):
                m.d.sync += stored.eq(value & ~ones)
            with m.If(self.set[name]):
                m.d.sync += stored.eq(1)
            return
        if f.access == "flag":
            with m.If(self.clear[name]):
                m.d.sync += stored.eq(0)
        with m.If(written):
            kept = value & ~mask
            if f.access == "flag":
                kept = Mux(self.clear[name], 0, kept)
            m.d.sync += stored.eq(ones | kept)

    def _read(self, m, words):
        """Two stages: within each block of words, then between blocks."""
        blocks = {}
        for address, word in words.items():
            blocks.setdefault(address // BLOCK, {})[address % BLOCK] = word
        block_s1 = Signal.like(self.bus.read_address)
        m.d.sync += block_s1.eq(self.bus.read_address // BLOCK)
        chosen = {}
        for block, members in blocks.items():
            word_s1 = chosen[block] = Signal(32, name=f"block{block}_s1")
            m.d.sync += word_s1.eq(0)
            with m.Switch(self.bus.read_address % BLOCK):
                for address, word in members.items():
                    with m.Case(address):
                        m.d.sync += word_s1.eq(word)
        m.d.sync += self.bus.read_data.eq(0)
        with m.Switch(block_s1):
            for block, word_s1 in chosen.items():
                with m.Case(block):
                    m.d.sync += self.bus.read_data.eq(word_s1)
