"""Register bank: the words of the register map, made from its declaration."""

from amaranth.hdl import Cat, Const, Module, Mux, Shape, Signal
from amaranth.lib import data
from amaranth.lib.wiring import In, Out

from .. import Block
from . import payloads


def member(register, field):
    """Name of a field's member in the bank's layouts: ``ctrl_start``."""
    return f"{register.name}_{field.name}".lower()


def in_memory(register):
    """Whether a register's bits are all stored and nothing else: a word of a memory."""
    bits = sum(f.mask for f in register.fields if f.access == "stored")
    return register.count == 1 and bits == 0xFFFFFFFF


def fields_of(registers, *access):
    """``(register, field)`` of all fields with one of these kinds of access, arrays and words of a memory left out."""
    return [
        (register, f)
        for register in registers
        if register.count == 1 and not in_memory(register)
        for f in register.fields
        if f.access in access
    ]


def layout_of(registers, *access, width=None):
    """One member for each of these fields; ``width`` bits wide, or as wide as the field."""
    return data.StructLayout(
        {member(register, f): width or Shape(f.width, f.signed) for register, f in fields_of(registers, *access)}
    )


#: Of a word's address, those that say where on a page it is.
PAGE_BITS = 5


class RegisterBank(Block):
    """Stores what software writes, and reads what hardware shows.

    A write takes effect in the following cycle. Software wins where it sets a flag in the cycle in which hardware
    clears it; hardware wins where it sets a sticky bit in the cycle in which software clears it.

    Parameters
    ----------
    registers : iterable of Register
        Arrays and words of a memory among them are left to others.

    Members
    -------
    bus : ``In``, :func:`payloads.register_bus`
        Answers 0 where there is no register. Always ready.
    values : ``Out``
        Fields that are stored, flags and sticky bits.
    status : ``In``
        Fields that the hardware drives.
    set, clear : ``In``
        One cycle each: set a sticky bit; clear a flag.
    commands : ``Out``
        One cycle each.
    """

    def __init__(self, registers):
        self.registers = registers
        super().__init__(
            bus=In(payloads.register_bus()),
            values=Out(layout_of(registers, "stored", "flag", "sticky")),
            status=In(layout_of(registers, "status")),
            set=In(layout_of(registers, "sticky", width=1)),
            clear=In(layout_of(registers, "flag", width=1)),
            commands=Out(layout_of(registers, "command")),
        )

    def elaborate(self, platform):
        m = Module()
        m.d.comb += self.bus.write.ready.eq(1)
        registers = [register for register in self.registers if register.count == 1 and not in_memory(register)]
        # By pages of 32 words: an address' lower bits and its page are one LUT.
        pages = {}
        for register in registers:
            pages.setdefault(register.offset // 4 >> PAGE_BITS, []).append(register)
        for page, inside in pages.items():
            enabled = Signal(4, name=f"write_page_{page}")  # byte enables are clock enables
            asked = self.bus.write.valid & (self.bus.write.payload.address[PAGE_BITS:] == page)
            m.d.comb += enabled.eq(Mux(asked, self.bus.write.payload.strobe, 0))
            words = {register.offset // 4 % (1 << PAGE_BITS): self._word(m, register, enabled) for register in inside}
            with m.If(self.bus.read_address[PAGE_BITS:] == page):
                with m.Switch(self.bus.read_address[:PAGE_BITS]):
                    for address, word in words.items():
                        with m.Case(address):
                            m.d.comb += self.bus.read_data.eq(word)
        return m

    def _word(self, m, register, enabled):
        """Make a register; the word that is read of it. ``enabled``: the bytes that are written on its page."""
        write = self.bus.write.payload
        written = Signal(4, name=f"write_{register.name.lower()}")
        if any(f.writable for f in register.fields):
            here = write.address[:PAGE_BITS] == register.offset // 4 % (1 << PAGE_BITS)
            m.d.comb += written.eq(Mux(here, enabled, 0))
        parts, position = [], 0
        for f in register.fields:
            name = member(register, f)
            ones = write.data[f.lsb : f.lsb + f.width] & Cat(written[k // 8] for k in range(f.lsb, f.lsb + f.width))
            if f.access == "constant":
                value = Const(f.reset, f.width)
            elif f.access == "status":
                value = self.status[name]
            elif f.access == "command":
                value = Const(0, f.width)
                m.d.comb += self.commands[name].eq(ones)
            else:
                stored = Signal(Shape(f.width, f.signed), init=f.reset, name=name)
                m.d.comb += self.values[name].eq(stored)
                value = stored.as_unsigned() if f.signed else stored
                self._store(m, f, stored, written, ones, name)
            parts += [Const(0, f.lsb - position), value]
            position = f.lsb + f.width
        return Cat(*parts)

    def _store(self, m, f, stored, written, ones, name):
        write = self.bus.write.payload
        if f.access == "flag":
            with m.If(self.clear[name]):
                m.d.sync += stored.eq(0)
        for bit in range(f.width):
            place = f.lsb + bit
            with m.If(ones[bit] if f.access == "sticky" else written[place // 8]):
                m.d.sync += stored[bit].eq(0 if f.access == "sticky" else write.data[place])
        if f.access == "sticky":
            with m.If(self.set[name]):
                m.d.sync += stored.eq(1)
