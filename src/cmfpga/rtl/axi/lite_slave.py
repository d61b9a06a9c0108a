"""AXI4-Lite slave: one write and one read at a time, both answered with OKAY."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, stream
from amaranth.lib.wiring import In, Out

from ...protocol.registers.declaration import ADDRESS_BITS
from .. import Block
from ..shell.payloads import register_bus

#: Payloads of the channels. The third member of the address channels, ``prot``, is of no use here.
CHANNELS = {
    name: data.StructLayout(members)
    for name, members in {
        "aw": {"addr": ADDRESS_BITS},
        "w": {"data": 32, "strb": 4},
        "b": {"resp": 2},
        "ar": {"addr": ADDRESS_BITS},
        "r": {"data": 32, "resp": 2},
    }.items()
}


class LiteSlave(Block):
    """Turns AXI4-Lite transfers into writes and reads of registers.

    Address and data of a write may come in any order. A write takes effect in the cycle after both have come, its
    answer follows a cycle later, both later where the bus is not ready; a read's data come three cycles after its
    address. The address's lowest two bits are ignored; beyond the map writes do nothing and reads return 0. One write
    per three cycles. All outputs are low in a reset and in the cycle after it.

    Parameters
    ----------
    size : int
        Bytes of the map, a power of two.
    nowhere : int
        An offset in it without a register, which is read in place of what is beyond.

    Members
    -------
    aw, w, ar : ``In``, streams of :data:`CHANNELS`
    b, r : ``Out``, streams of the same
    bus : ``Out``, :func:`cmfpga.rtl.shell.payloads.register_bus`
        ``read_data`` a cycle late.
    """

    def __init__(self, size, nowhere):
        self._size, self._nowhere = size, nowhere
        super().__init__(
            **{name: In(stream.Signature(CHANNELS[name])) for name in ("aw", "w", "ar")},
            **{name: Out(stream.Signature(CHANNELS[name])) for name in ("b", "r")},
            bus=Out(register_bus()),
        )

    def elaborate(self, platform):
        m = Module()
        self._writes(m)
        self._reads(m)
        return m

    def _writes(self, m):
        """``ready`` falls when an address, or data, was taken, and rises with the answer."""
        target, written = Signal(CHANNELS["aw"]), Signal(CHANNELS["w"])
        address = target.addr
        have_address, have_data, both = Signal(), Signal(), Signal()
        m.d.comb += [
            both.eq(have_address & have_data & self.bus.write.ready),
            self.bus.write.valid.eq(have_address & have_data & (address < self._size)),
            self.bus.write.payload.address.eq(address[2:]),
            self.bus.write.payload.data.eq(written.data),
            self.bus.write.payload.strobe.eq(written.strb),
        ]
        free = Signal()  # no answer waits
        m.d.comb += free.eq(~self.b.valid | self.b.ready)
        for channel, have, kept in ((self.aw, have_address, target), (self.w, have_data, written)):
            with m.If(channel.valid & channel.ready):
                m.d.sync += [have.eq(1), kept.eq(channel.payload), channel.ready.eq(0)]
            with m.Elif(~have & free & ~both):
                m.d.sync += channel.ready.eq(1)
        with m.If(both):
            m.d.sync += [have_address.eq(0), have_data.eq(0), self.b.valid.eq(1)]
        with m.Elif(self.b.ready):
            m.d.sync += self.b.valid.eq(0)

    def _reads(self, m):
        address = self.ar.payload.addr
        free, answered = Signal(), Signal()  # no answer waits, and the memories are filled; one is there
        m.d.comb += free.eq(~self.bus.read & ~answered & (~self.r.valid | self.r.ready) & self.bus.write.ready)
        m.d.sync += [self.bus.read.eq(0), self.ar.ready.eq(free), answered.eq(self.bus.read)]
        m.d.sync += self.bus.read_address.eq(Mux(address < self._size, address[2:], self._nowhere // 4))
        with m.If(self.ar.valid & self.ar.ready):
            m.d.sync += [self.bus.read.eq(1), self.ar.ready.eq(0)]
        with m.If(answered):
            m.d.sync += [self.r.valid.eq(1), self.r.payload.data.eq(self.bus.read_data)]
        with m.Elif(self.r.ready):
            m.d.sync += self.r.valid.eq(0)
