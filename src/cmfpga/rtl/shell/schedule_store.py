"""Schedule store: the table of schedules as software writes it, copied into the core between batches."""

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import data, memory, wiring
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for
from .. import payloads as core
from . import payloads


class ScheduleStore(wiring.Component):
    """Holds what software wrote. Once something was, and no batch is under way, the entries up to the last one written
    since the reset are copied into the core's table, one a cycle; until then no batch may begin.

    A reset clears no memory: entries keep what was written before it.

    Parameters
    ----------
    config : Config
    register : Register
        The array of entries.

    Members
    -------
    bus : ``In``, :func:`payloads.register_bus`
        Always ready; answers 0 outside the table.
    lock, quiet : ``In(1)``
        Do not copy now; no batch is under way.
    o : ``Out``, flow of :func:`cmfpga.rtl.payloads.schedule_write`
    pending, blocking : ``Out(1)``
        Something was written that has not been copied; no batch may begin because of it.
    limited : ``Out(1)``
        An entry was out of range when the table was copied.
    """

    def __init__(self, config, register):
        self.config = config
        self.register = register
        super().__init__(
            {
                "bus": In(payloads.register_bus()),
                "lock": In(1),
                "quiet": In(1),
                "o": Out(core.flow(core.schedule_write(config))),
                **dict.fromkeys(("pending", "blocking", "limited"), Out(1)),
            }
        )

    def elaborate(self, platform):
        m = Module()
        count, first = self.register.count, self.register.offset // 4
        entry = data.StructLayout({f.name: f.width for f in self.register.fields})
        fields = {f.name: f for f in self.register.fields}
        assert {f.width for f in fields.values()} == {8}, "bytes are written one by one"
        m.submodules.table = table = memory.Memory(shape=entry.size, depth=count, init=[])
        put = table.write_port(granularity=8)
        get = table.read_port(domain="comb")  # software reads, or else the core's table is filled

        position, copying = Signal(range(count)), Signal()

        # Software.
        write = self.bus.write.payload
        bits = bits_for(count - 1)
        mine = Signal()
        assert first % (1 << bits) == 0, "a place is the lower bits of its address"

        def inside(address):
            return (address[bits:] == first >> bits) & (address[:bits] < count)

        m.d.comb += [
            mine.eq(inside(write.address)),
            put.addr.eq(write.address),
            put.data.eq(write.data),
            put.en.eq(Mux(self.bus.write.valid & mine, write.strobe[: len(put.en)], 0)),
            get.addr.eq(Mux(self.bus.read, self.bus.read_address, position)),
        ]
        m.d.comb += [
            self.bus.write.ready.eq(1),
            self.bus.read_data.eq(Mux(inside(self.bus.read_address), get.data, 0)),
        ]

        # The core.
        last = Signal(range(count))
        found = data.View(entry, get.data)
        m.d.comb += [
            self.o.valid.eq(copying & ~self.bus.read),
            self.o.payload.address.eq(position),
            self.blocking.eq(copying | (self.pending & ~self.lock)),
        ]
        wrong = []
        for f in fields.values():
            value = found[f.name]
            wrong.append(value > f.high)
            m.d.comb += self.o.payload.entry[f.link].eq(Mux(value > f.high, f.high, value))
        with m.If(self.o.valid & Cat(wrong).any()):
            m.d.sync += self.limited.eq(1)
        with m.If(self.o.valid):
            m.d.sync += position.eq(position + 1)
            with m.If(position == last):
                m.d.sync += [copying.eq(0), self.pending.eq(0), position.eq(0)]
        with m.Elif(self.pending & self.quiet & ~self.lock):
            m.d.sync += [copying.eq(1), self.limited.eq(0)]
        with m.If(put.en.any()):  # again from the start, also in the middle of a copy
            m.d.sync += [self.pending.eq(1), copying.eq(0), position.eq(0)]
            with m.If(put.addr > last):
                m.d.sync += last.eq(put.addr)
        return m
