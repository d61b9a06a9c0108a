"""Tables of the core that software fills between batches: rows by a window of registers, and the schedules."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import data, memory
from amaranth.lib.wiring import In, Out, connect, flipped

from ...fixed import bits_for
from ...protocol.regions import STARTS
from ...protocol.tables import tables_of, window_of
from .. import Block
from .. import payloads as core
from ..regions.payloads import row_write
from . import payloads

#: What fills each table.
WRITES = {"row": row_write, "node": core.node_write, "mask": core.mask_write}


def leaves_of(view, prefix=""):
    """``{name: signal}`` of a view's leaves, as the links of registers name them: ``row_place_x``."""
    found = {}
    for name in view.shape().members:
        inner = view[name]
        nested = isinstance(inner, data.View)
        found |= leaves_of(inner, f"{prefix}{name}_") if nested else {f"{prefix}{name}": inner}
    return found


class TableWindow(Block):
    """A row in registers; writing the last register writes it into the table, as soon as no batch is under way.

    While it waits, no batch may begin, and a write to the registers is refused. So is a row with a field out of range,
    or one that is not ``allowed``.

    Parameters
    ----------
    registers : list of Register
        That which writes the row is the last one.
    layout : StructLayout
        Of the row.

    Members
    -------
    bus : ``In``, :func:`payloads.register_bus`
        Always ready; answers 0. Two cycles from write to write.
    quiet : ``In(1)``
        No batch is under way.
    o : ``Out``, flow of ``layout``
    allowed : ``In(1)``
        The row of ``o`` may be written, whether ``o`` is valid or not.
    pending : ``Out(1)``
        A row waits.
    refused : ``Out(1)``
        One cycle: a write was refused.
    """

    def __init__(self, registers, layout):
        self.registers = registers
        super().__init__(
            bus=In(payloads.register_bus()),
            **dict.fromkeys(("quiet", "allowed"), In(1)),
            o=Out(core.flow(layout)),
            **dict.fromkeys(("pending", "refused"), Out(1)),
        )

    def elaborate(self, platform):
        m = Module()
        write, targets = self.bus.write.payload, leaves_of(self.o.payload)
        asked, waiting = Signal(), Signal()
        here, wrong = (Signal(len(self.registers), name=name) for name in ("here", "wrong"))
        m.d.comb += [
            self.bus.write.ready.eq(1),
            self.pending.eq(asked | waiting),
            self.o.valid.eq(waiting & self.quiet),
        ]
        for k, register in enumerate(self.registers):
            m.d.comb += here[k].eq(self.bus.write.valid & (write.address == register.offset // 4))
            beyond = [write.strobe != 0b1111]
            with m.If(here[k] & ~self.pending):
                for f in register.fields:
                    word, target = write.data[f.lsb : f.lsb + f.width], targets[f.link]
                    m.d.sync += target.eq(word)
                    beyond.append(self._beyond(f, word, len(target)))
                m.d.sync += wrong[k].eq(Cat(beyond).any())
        good = self.allowed & ~wrong.any()
        m.d.sync += asked.eq(here[-1] & ~self.pending)
        m.d.comb += self.refused.eq((asked & ~good) | (here.any() & self.pending))
        with m.If(asked):
            m.d.sync += waiting.eq(good)
        with m.Elif(self.quiet):
            m.d.sync += waiting.eq(0)
        return m

    def _beyond(self, f, word, width):
        """Whether a field's word is none of ``width`` bits, or larger than the field allows."""
        if f.signed:
            upper = word[width - 1 :]
            return upper.any() & ~upper.all()
        more = (word[:width] > f.high) if f.high is not None and f.high < (1 << width) - 1 else Const(0, 1)
        return word[width:].any() | more


class KnownRows(Block):
    """How many rows of the table of regions are known: written since the reset, and in use in the batch before.

    Members
    -------
    write : ``In``, flow of :func:`~cmfpga.rtl.regions.payloads.row_write`
    allowed : ``Out(1)``
        Its row, whether valid or not, is a known one or a fresh one behind those, and its parent stands before it.
    opened : ``In(1)``
        A batch begins with ``rows``.
    rows : ``In``
        Of the next batch.
    missing : ``Out(1)``
        Those are not all known.
    """

    def __init__(self, config):
        super().__init__(
            config,
            write=In(core.flow(row_write(config))),
            allowed=Out(1),
            opened=In(1),
            rows=In(core.settings(config)["rows"].shape),
            missing=Out(1),
        )

    def elaborate(self, platform):
        m = Module()
        write, known = self.write.payload, Signal.like(self.rows)
        new = write.fresh & (write.number == known)
        childless = (write.row.start != STARTS.index("parent")) | (write.row.parent < write.number)
        m.d.comb += [self.allowed.eq(((write.number < known) | new) & childless), self.missing.eq(self.rows > known)]
        with m.If(self.opened):
            m.d.sync += known.eq(self.rows)
        with m.Elif(self.write.valid & new):
            m.d.sync += known.eq(known + 1)
        return m


class Tables(Block):
    """The windows of all tables.

    Members
    -------
    bus : ``In``, :func:`payloads.register_bus`
        Always ready; answers 0.
    quiet, opened : ``In(1)``
        As those of :class:`TableWindow` and :class:`KnownRows`.
    settings : ``In``, :func:`cmfpga.rtl.payloads.settings`
        Of the next batch.
    clear : ``In(1)``
        Set ``refused`` to 0.
    pending, rows_missing : ``Out(1)``
        A row waits; some are not known. No batch may begin.
    refused : ``Out(16)``
        Writes, modulo 2^16.
    row_write, node_write, mask_write : ``Out``, flows
        What fills the core's tables, where it has them.
    """

    def __init__(self, config, registers):
        self.windows = {
            name: TableWindow(window_of(registers, name), WRITES[name](config)) for name in tables_of(config)
        }
        self.writes = [f"{name}_write" for name in self.windows]
        super().__init__(
            config,
            bus=In(payloads.register_bus()),
            **dict.fromkeys(("quiet", "opened", "clear"), In(1)),
            settings=In(core.settings(config)),
            **dict.fromkeys(("pending", "rows_missing"), Out(1)),
            refused=Out(16),
            **{f"{name}_write": window.signature.members["o"] for name, window in self.windows.items()},
        )

    def elaborate(self, platform):
        m = Module()
        m.d.comb += self.bus.write.ready.eq(1)
        for name, window in self.windows.items():
            m.submodules[name] = window
            connect(m, window.o, flipped(getattr(self, f"{name}_write")))
            m.d.comb += [
                window.bus.write.valid.eq(self.bus.write.valid),
                window.bus.write.payload.eq(self.bus.write.payload),
                window.quiet.eq(self.quiet),
                window.allowed.eq(1),
            ]
        windows = list(self.windows.values())
        m.d.comb += self.pending.eq(Cat(window.pending for window in windows).any())
        if "row" in self.windows:
            m.submodules.known_rows = known = KnownRows(self.config)
            connect(m, self.windows["row"].o, known.write)
            m.d.comb += [
                self.windows["row"].allowed.eq(known.allowed),
                known.opened.eq(self.opened),
                known.rows.eq(self.settings.rows),
                self.rows_missing.eq(known.missing),
            ]
        refused = Cat(window.refused for window in windows).any()  # a write is for one of them
        m.d.sync += self.refused.eq(Mux(self.clear, 0, self.refused + refused))
        return m


class ScheduleStore(Block):
    """Holds what software wrote. Once something was, and no batch is under way, the entries up to the last one written
    since the reset are copied into the core's table, one a cycle; until then no batch may begin.

    A reset clears no memory: entries keep what was written before it.

    Parameters
    ----------
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
        self.register = register
        super().__init__(
            config,
            bus=In(payloads.register_bus()),
            lock=In(1),
            quiet=In(1),
            o=Out(core.flow(core.schedule_write(config))),
            **dict.fromkeys(("pending", "blocking", "limited"), Out(1)),
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
        m.d.comb += [self.bus.write.ready.eq(1), self.bus.read_data.eq(Mux(inside(self.bus.read_address), get.data, 0))]

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
