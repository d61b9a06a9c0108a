"""Deep memory of wide words: side by side in memories of few bits, each of which is one RAM."""

from amaranth.hdl import Module, Value
from amaranth.lib import memory
from amaranth.lib.wiring import Out
from amaranth.utils import ceil_log2

from .. import Block

#: Bits of each word in one memory of up to 4,096 words: so many are a block RAM of 16 kibit, whatever the vendor. Where
#: ``ram_style`` asks for block RAMs, by the name that UltraScale has for them, one of its 36 kbit.
BITS, BLOCK_BITS = 4, 9
#: Of so few words a block RAM holds more bits than that.
SHALLOW = 2048


def slices(bits, depth, style="auto"):
    """``{name: (low, high)}``: the memories of a word of so many bits, and which bits they hold, ``high`` excluded."""
    width = max(1, (BLOCK_BITS if style == "block" else BITS) >> max(0, ceil_log2(depth) - 12))
    return {f"ram_{low}": (low, min(low + width, bits)) for low in range(0, bits, width)}


def memory_of(shape, depth, attrs):
    """A :class:`SlicedMemory` where a block RAM holds fewer words, else a plain one.

    Not so in UltraRAM, which has 4,096 words of 72 bits and registers of its own between one RAM and the next.
    """
    if depth > SHALLOW and attrs.get("ram_style") != "ultra":
        return SlicedMemory(shape, depth, attrs)
    return memory.Memory(shape=shape, depth=depth, init=[], attrs=attrs, src_loc_at=1)  # named as where it is called


class SlicedMemory(Block):
    """A memory as :class:`amaranth.lib.memory.Memory`, without contents, with one port to read and one to write.

    Left to itself, synthesis may take fewer RAMs, on top of one another. Then a multiplexer follows them, and the
    register behind it cannot be the RAMs' own output register: that was the slowest path of all.

    Parameters
    ----------
    shape : shape-like
        Of a word.
    depth : int
        Words.
    attrs : dict
        Attributes of each of the memories.

    Members
    -------
    read : ``Out``, members of :class:`amaranth.lib.memory.ReadPort`
    write : ``Out``, members of :class:`amaranth.lib.memory.WritePort`
    """

    def __init__(self, shape, depth, attrs):
        self._depth, self._attrs = depth, attrs
        ports = {"addr_width": ceil_log2(depth), "shape": shape}
        super().__init__(read=Out(memory.ReadPort.Signature(**ports)), write=Out(memory.WritePort.Signature(**ports)))

    def write_port(self):
        return self.write

    def read_port(self):
        return self.read

    def elaborate(self, platform):
        m = Module()
        found, given = Value.cast(self.read.data), Value.cast(self.write.data)
        for name, (low, high) in slices(len(found), self._depth, self._attrs.get("ram_style")).items():
            ram = memory.Memory(shape=high - low, depth=self._depth, init=[], attrs=self._attrs)
            m.submodules[name] = ram
            read, write = ram.read_port(), ram.write_port()
            m.d.comb += [
                read.addr.eq(self.read.addr),
                read.en.eq(self.read.en),
                found[low:high].eq(read.data),
                write.addr.eq(self.write.addr),
                write.data.eq(given[low:high]),
                write.en.eq(self.write.en),
            ]
        return m
