"""What a register map is made of: fields, registers, and the map that finds them by name."""

from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import accumulate

#: What software and hardware do with a field.
ACCESS = {
    "constant": "read only; fixed in this build",
    "status": "read only; driven by the hardware",
    "stored": "read and write",
    "written": "write only; reads as 0",
    "flag": "read and write; the hardware changes it too",
    "sticky": "set by the hardware; writing 1 clears it, writing 0 leaves it",
    "command": "writing 1 acts once; reads as 0",
}


#: Byte offsets of the groups; the serial link has a map of its own.
BASE = {
    "Control": 0x000, "Discovery": 0x010, "Operation": 0x040, "Regions": 0x060, "Settings": 0x080, "Result": 0x100,
    "Counters": 0x200, "Tables": 0x300, "Schedule": 0x400, "Scratch": 0xFFC, "Link": 0x000,
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Field:
    """Some bits of a register."""

    name: str  # in upper case, unique in its register
    lsb: int
    width: int
    access: str  # a key of ACCESS
    doc: str  # one line
    unit: str = ""
    reset: int = 0  # value after a reset; of a signed field the signed value
    signed: bool = False  # two's complement
    low: int | None = None  # smallest and largest value that is allowed; others are limited to them and flagged
    high: int | None = None  # None: whatever fits
    values: dict = field(default_factory=dict)  # {name: value}
    link: str = ""  # what stands behind the field: a setting, a result, a counter or a signal of the hardware
    link_lsb: int = 0  # the field's lowest bit in it

    @property
    def mask(self):
        """The field's bits in its register."""
        return ((1 << self.width) - 1) << self.lsb

    @property
    def writable(self):
        """Whether a write does anything."""
        return self.access not in ("constant", "status")

    def pack(self, value):
        """Bits of ``value`` at their place in the register; :exc:`ValueError` where it does not fit."""
        value = self.values.get(value, value)
        low, high = self.range
        if not low <= value <= high:
            raise ValueError(f"{self.name} = {value}: {low} to {high} is needed")
        return (int(value) << self.lsb) & self.mask

    def unpack(self, word):
        """The field's value in a register's ``word``."""
        value = (int(word) & self.mask) >> self.lsb
        return value - (1 << self.width) if self.signed and value >> (self.width - 1) else value

    @property
    def range(self):
        """Smallest and largest value that the bits can hold."""
        if self.signed:
            return -(1 << (self.width - 1)), (1 << (self.width - 1)) - 1
        return 0, (1 << self.width) - 1


@dataclass(frozen=True, kw_only=True)
class Register:
    """A 32-bit word of the map, or ``count`` of them in a row."""

    name: str  # in upper case, unique in the map
    offset: int  # bytes from the start of the map, a multiple of 4
    group: str  # a heading of the documentation
    doc: str  # one line
    fields: tuple  # of Field, from the lowest bit on
    count: int = 1  # more than 1: an array with a stride of 4 bytes

    def __getitem__(self, name):
        """The field called ``name``."""
        by_name = {f.name: f for f in self.fields}
        if name not in by_name:
            raise KeyError(f"{self.name} has no field {name}; it has {', '.join(by_name)}")
        return by_name[name]

    @property
    def reset(self):
        """The word after a reset."""
        return sum(f.pack(f.reset) for f in self.fields)

    def pack(self, **values):
        """A word of field values; fields that are not named are 0."""
        return sum(self[name].pack(value) for name, value in values.items())

    def unpack(self, word):
        """``{field name: value}`` of a word."""
        return {f.name: f.unpack(word) for f in self.fields}


@dataclass(frozen=True)
class RegisterMap:
    """All registers, in order of their offsets. :exc:`ValueError` where names, offsets or bits are used twice."""

    registers: tuple
    #: Bytes that the map takes up; a power of two.
    size: int = 0x1000

    def __post_init__(self):
        words, names = set(), set()
        for register in self.registers:
            span = range(register.offset, register.offset + 4 * register.count, 4)
            if register.offset % 4 or span[-1] >= self.size or words & set(span) or register.name in names:
                raise ValueError(f"{register.name} at {register.offset:#x}: used twice, or out of place")
            words |= set(span)
            names.add(register.name)
            bits = 0
            for f in register.fields:
                if f.access not in ACCESS or f.lsb + f.width > 32 or bits & f.mask:
                    raise ValueError(f"{register.name}.{f.name}: bits used twice or out of place, or a wrong access")
                bits |= f.mask

    @cached_property
    def by_name(self):
        """``{name: register}``."""
        return {register.name: register for register in self.registers}

    def __getitem__(self, name):
        return self.by_name[name]

    def __contains__(self, name):
        return name in self.by_name

    def __iter__(self):
        return iter(self.registers)

    @property
    def nowhere(self):
        """An offset of a word without a register, with as few ones as possible."""
        used = {register.offset + 4 * k for register in self.registers for k in range(register.count)}
        return min(set(range(0, self.size, 4)) - used, key=lambda offset: (offset.bit_count(), offset))

    def group(self, name):
        """The registers of one group."""
        return tuple(register for register in self.registers if register.group == name)

    def linked(self, group):
        """``{link: ((register, field), …)}`` of a group, the parts of a value from its lowest bit on."""
        found = {}
        for register in self.group(group):
            for f in register.fields:
                if f.link:
                    found.setdefault(f.link, []).append((register, f))
        return {link: tuple(sorted(parts, key=lambda part: part[1].link_lsb)) for link, parts in found.items()}


def in_order(group, declared, count=1):
    """Registers of ``(name, doc, fields)``, one after the other."""
    return [
        Register(name=name, offset=BASE[group] + 4 * k, group=group, doc=doc, fields=tuple(fields), count=count)
        for k, (name, doc, fields) in enumerate(declared)
    ]


def _make(access, name, lsb, width, doc, **more):
    return Field(name=name, lsb=lsb, width=width, access=access, doc=doc, **more)


constant, status, stored, flag, sticky, command = (
    partial(_make, access) for access in ("constant", "status", "stored", "flag", "sticky", "command")
)


def constants(*fields):
    """Fields of ``(name, width, value, doc)`` beside each other."""
    lsbs = accumulate((width for _, width, *_ in fields), initial=0)
    placed = zip(fields, lsbs, strict=False)
    return [constant(name, lsb, width, doc, reset=value) for (name, width, value, doc), lsb in placed]
