"""In front of the ROI filter: a mask of hot pixels, and a filter of background activity. Both only mark events."""

from amaranth.hdl import Array, Cat, Const, Module, Mux, Signal
from amaranth.lib import data, memory
from amaranth.lib.wiring import In, Out

from .. import Block, payloads
from ..arithmetic import delay
from ..read_modify_write import ReadModifyWrite


class HotMask(Block):
    """Marks the events of pixels that a mask holds, a bit each, in words of 32 neighbours of a row.

    A reset leaves the mask as it is; until it was written it holds anything.

    One event per cycle; latency :attr:`latency` cycles. A RAM of ``geometry.mask_depth`` words.

    Members
    -------
    i, o : ``In``, ``Out``, flows of :func:`payloads.event`, :func:`payloads.marked_event`
    start : ``In(1)``
        A new batch begins: takes over ``enable``. No event in this cycle.
    enable : ``In(1)``
        Without, no event is marked.
    write : ``In``, flow of :func:`payloads.mask_write`
        Fills the mask. Not while events of a batch come that uses it.
    """

    latency = 2

    def __init__(self, config):
        super().__init__(
            config,
            i=In(payloads.flow(payloads.event(config))),
            o=Out(payloads.flow(payloads.marked_event(config, "hot"))),
            start=In(1),
            enable=In(1),
            write=In(payloads.flow(payloads.mask_write(config))),
        )

    def elaborate(self, platform):
        m = Module()
        geometry, event, put = self.config.geometry, self.i.payload, self.write.payload
        m.submodules.ram = ram = memory.Memory(shape=geometry.mask_pixels, depth=geometry.mask_depth, init=[])
        write, read = ram.write_port(), ram.read_port()
        enabled = Signal()
        column, within = event.x // geometry.mask_pixels, event.x % geometry.mask_pixels

        def address(column, row):
            return Cat(column[: geometry.mask_column_bits], row)

        with m.If(self.start):
            m.d.sync += enabled.eq(self.enable)
        # Stage 1: the RAM reads. Stage 2: choose the pixel.
        within_s1 = delay(m, within, 1, name="within")
        m.d.comb += [
            write.addr.eq(address(put.column, put.row)),
            write.data.eq(put.bits),
            write.en.eq(self.write.valid),
            read.addr.eq(address(column, event.y)),
            self.o.valid.eq(delay(m, self.i.valid, self.latency, name="valid", valid=True)),
            self.o.payload.hot.eq(delay(m, Array(read.data)[within_s1] & enabled, 1, name="hot")),
        ]
        for name in event.shape().members:
            m.d.comb += self.o.payload[name].eq(delay(m, event[name], self.latency, name=name))
        return m


def stamps(config):
    """What a cell remembers: its youngest event, and the youngest of another pixel than that one's."""
    time, pixel = config.span_bits, 2 * config.background_cell
    return data.StructLayout({"latest": time, "pixel": pixel, "other": time, "known": 1, "other_known": 1})


class _Cells(ReadModifyWrite):
    """The memory of all cells: an event becomes the youngest of its cell."""

    def __init__(self, config):
        event = data.StructLayout({"t": config.span_bits, "pixel": 2 * config.background_cell})
        super().__init__(data.StructLayout({"cell": stamps(config)}), event, config.geometry.cell_depth)

    def changed(self, name, before, event):
        after = Signal(before.shape(), name="after")
        same = before.pixel == event.pixel  # or the cell has none: then neither time is known
        return after, [
            after.latest.eq(event.t),
            after.pixel.eq(event.pixel),
            after.known.eq(1),
            after.other.eq(Mux(same, before.other, before.latest)),
            after.other_known.eq(Mux(same, before.other_known, before.known)),
        ]


class BackgroundFilter(Block):
    """Marks events that no other pixel supports: none of the same cell had an event shortly before.

    The sensor is divided into cells of 2^background_cell pixels a side. For each the RAM holds the times of the
    youngest event and of the youngest of another pixel, which is all that it takes to know, exactly, how long ago
    another pixel than the event's own had one. An event in the last ``period`` µs supports. A hot pixel does not
    support itself, and events that are hot already support nobody. Time stamps are kept modulo ``2**span_bits`` µs:
    a stamp older than that may seem young, and one of the future supports nobody.

    After Delbruck, "Frame-free dynamic digital vision" (2008), where every event writes its time to its eight
    neighbours. Here the neighbourhood is the cell, whose borders divide neighbours; in return it takes one read and one
    write an event, and, with cells 4 px wide, a ninth of the memory.

    One event per cycle, also of one cell in a row; latency :attr:`latency` cycles. A RAM of ``geometry.cell_depth``
    words of :func:`stamps`.

    Members
    -------
    i : ``In``, flow of :func:`payloads.event`, or of :func:`payloads.marked_event` where there is a mask
    o : ``Out``, flow of :func:`payloads.marked_event`
    start : ``In(1)``
        A new batch begins: takes over ``period``. No event in this cycle, nor on its way.
    period : ``In``
        µs; 0: mark no event. Times are remembered nevertheless.
    clear : ``In(1)``
        Forget all times. No event until ``cleared``.
    cleared : ``Out(1)``
        It is done; high until the next ``clear``.
    """

    latency = ReadModifyWrite.latency + 2

    def __init__(self, config):
        event = payloads.marked_event(config, "hot") if config.hot_pixels else payloads.event(config)
        super().__init__(
            config,
            i=In(payloads.flow(event)),
            o=Out(payloads.flow(payloads.marked_event(config))),
            start=In(1),
            period=In(range(config.widths.background_us_max + 1)),
            clear=In(1),
            cleared=Out(1),
        )

    def elaborate(self, platform):
        m = Module()
        config, event, bits = self.config, self.i.payload, self.config.background_cell
        m.submodules.cells = cells = _Cells(config)
        period = Signal.like(self.period)
        with m.If(self.start):
            m.d.sync += period.eq(self.period)

        # Forget: one cell after the other.
        sweeping, position = Signal(), Signal(range(max(2, config.geometry.cell_depth)))
        with m.If(self.clear):
            m.d.sync += [sweeping.eq(1), position.eq(0), self.cleared.eq(0)]
        with m.Elif(sweeping):
            m.d.sync += position.eq(position + 1)
            with m.If(position == config.geometry.cell_depth - 1):
                m.d.sync += [sweeping.eq(0), self.cleared.eq(1)]

        hot = event.hot if config.hot_pixels else Const(0, 1)
        place = Cat((event.x >> bits)[: config.geometry.cell_column_bits], event.y >> bits)
        m.d.comb += [
            cells.i.valid.eq((self.i.valid & ~hot) | sweeping),
            cells.i.payload.clear.eq(sweeping),
            cells.i.payload.address.eq(Mux(sweeping, position, place)),
            cells.i.payload.add.t.eq(event.t),
            cells.i.payload.add.pixel.eq(Cat(event.x[:bits], event.y[:bits])),
        ]

        # Which of the two times is another pixel's; how old it is.
        before = cells.o.payload.cell
        pixel = delay(m, Cat(event.x[:bits], event.y[:bits]), cells.latency, name="pixel")
        t = delay(m, event.t[: config.span_bits], cells.latency, name="t_low")
        same = before.pixel == pixel
        judged = delay(m, ~hot, cells.latency + 1, name="judged") & (period != 0)
        age_s1 = Signal(config.span_bits, reset_less=True)
        known_s1 = Signal(reset_less=True)
        noise_s2 = Signal(reset_less=True)
        m.d.sync += [
            age_s1.eq(t - Mux(same, before.other, before.latest)),
            known_s1.eq(Mux(same, before.other_known, before.known)),
            noise_s2.eq(judged & ~(known_s1 & (age_s1 <= period))),
        ]
        m.d.comb += self.o.valid.eq(delay(m, self.i.valid, self.latency, name="valid", valid=True))
        for name in event.shape().members:
            m.d.comb += self.o.payload[name].eq(delay(m, event[name], self.latency, name=name))
        m.d.comb += self.o.payload.noise.eq(noise_s2)
        return m
