"""Schedule: the table that says which level and which step each iteration of the sign ascent uses."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import memory, wiring
from amaranth.lib.wiring import In, Out

from .. import payloads
from ..arithmetic import delay


class Schedule(wiring.Component):
    """Walks through a part of a table that is written at run time.

    The first entry is at ``level`` and ``shift`` two cycles after ``load``, the next one a cycle after ``advance``.
    An entry out of range is limited, and flagged.

    Parameters
    ----------
    config : Config
        ``schedule_entries``, ``max_level``, ``v``.

    Members
    -------
    write : ``In``, flow of :func:`payloads.schedule_write`
        Only while no batch is under way.
    new_batch, load, advance : ``In(1)``
        Forget ``limited``; begin with the entry ``first``; take the next one. One cycle each.
    hold : ``In(1)``
        With ``advance``: the entry was the batch's last, and stays. Only where v's confidence is measured.
    first : ``In``
    level, shift : ``Out``
        Pixels are 2^level px wide; v moves by 2^shift raw units.
    limited : ``Out(1)``
        An entry used since ``new_batch`` was out of range.
    """

    def __init__(self, config):
        self.config = config
        entry = payloads.schedule_entry(config)
        super().__init__(
            {
                "write": In(payloads.flow(payloads.schedule_write(config))),
                **dict.fromkeys(("new_batch", "load", "advance", *(("hold",) if config.confidence else ())), In(1)),
                "first": In(range(config.schedule_entries)),
                "level": Out(entry["level"].shape),
                "shift": Out(entry["shift"].shape),
                "limited": Out(1),
            }
        )

    def elaborate(self, platform):
        config = self.config
        m = Module()
        layout = payloads.schedule_entry(config)
        m.submodules.table = table = memory.Memory(shape=layout, depth=config.schedule_entries, init=[])
        write, read = table.write_port(), table.read_port(domain="comb")
        pointer = Signal(range(config.schedule_entries))
        m.d.comb += [
            write.addr.eq(self.write.payload.address),
            write.data.eq(self.write.payload.entry),
            write.en.eq(self.write.valid),
            read.addr.eq(pointer),
        ]
        out_of_range = Signal()
        loaded = delay(m, self.load, 1, name="loaded", valid=True)
        with m.If(self.load):
            m.d.sync += pointer.eq(self.first)
        with m.If(self.new_batch):
            m.d.sync += self.limited.eq(0)
        following = self.advance & ~self.hold if config.confidence else self.advance
        with m.If(loaded | following):
            too_coarse = read.data.level > config.max_level
            too_far = read.data.shift > config.formats.v.width - 2
            m.d.sync += [
                pointer.eq(Mux(pointer == config.schedule_entries - 1, 0, pointer + 1)),
                self.level.eq(Mux(too_coarse, config.max_level, read.data.level)),
                self.shift.eq(Mux(too_far, config.formats.v.width - 2, read.data.shift)),
            ]
            m.d.sync += out_of_range.eq(too_coarse | too_far)
        # Only an entry that was used counts, not the one behind the last.
        with m.If(self.advance & out_of_range):
            m.d.sync += self.limited.eq(1)
        return m
