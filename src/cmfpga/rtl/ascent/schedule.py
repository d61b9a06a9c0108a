"""Schedule: the table that says which level, step and stride each iteration of the sign ascent uses."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import memory, wiring
from amaranth.lib.wiring import In, Out

from ...config.schedule import STRIDES
from .. import payloads
from ..arithmetic import delay


class Schedule(wiring.Component):
    """Walks through a part of a table that is written at run time.

    The first entry is at ``level`` and ``shift`` a cycle after ``start``, the next one a cycle after ``advance``.
    ``stride`` is ahead: that of the entry that comes next, because its replay begins before v is known. An entry out
    of range is limited, and flagged.

    Parameters
    ----------
    config : Config
        ``schedule_entries``, ``max_level``, ``v``.

    Members
    -------
    write : ``In``, flow of :func:`payloads.schedule_write`
        Only while no batch is under way.
    new_batch, start, advance : ``In(1)``
        Forget ``limited``, and go to the entry ``first``; take that entry, at least four cycles later; take the next
        one. One cycle each.
    hold : ``In(1)``
        With ``advance``: the entry was the batch's last, and stays. Only where v's confidence is measured.
    first : ``In``
        In the second cycle after ``new_batch``.
    level, shift : ``Out``
        Pixels are 2^level px wide; v moves by 2^shift raw units.
    stride : ``Out``
        One event in 2^stride, two cycles after ``start`` or ``advance``.
    limited : ``Out(1)``
        An entry used since ``new_batch`` was out of range.
    """

    def __init__(self, config):
        self.config = config
        entry = payloads.schedule_entry(config)
        super().__init__(
            {
                "write": In(payloads.flow(payloads.schedule_write(config))),
                **dict.fromkeys(("new_batch", "start", "advance", *(("hold",) if config.confidence else ())), In(1)),
                "first": In(range(config.schedule_entries)),
                "level": Out(entry["level"].shape),
                "shift": Out(entry["shift"].shape),
                "stride": Out(entry["stride"].shape),
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
        too_coarse = read.data.level > config.max_level
        too_far = read.data.shift > config.formats.v.width - 2
        too_few = read.data.stride > len(STRIDES) - 1
        m.d.sync += self.stride.eq(Mux(too_few, len(STRIDES) - 1, read.data.stride))
        with m.If(self.new_batch):
            m.d.sync += self.limited.eq(0)
        with m.If(delay(m, self.new_batch, 2, name="new_batch", valid=True)):
            m.d.sync += pointer.eq(self.first)
        following = self.advance & ~self.hold if config.confidence else self.advance
        with m.If(self.start | following):
            m.d.sync += [
                pointer.eq(Mux(pointer == config.schedule_entries - 1, 0, pointer + 1)),
                self.level.eq(Mux(too_coarse, config.max_level, read.data.level)),
                self.shift.eq(Mux(too_far, config.formats.v.width - 2, read.data.shift)),
            ]
            m.d.sync += out_of_range.eq(too_coarse | too_far | too_few)
        # Only an entry that was used counts, not the one behind the last.
        with m.If(self.advance & out_of_range):
            m.d.sync += self.limited.eq(1)
        return m
