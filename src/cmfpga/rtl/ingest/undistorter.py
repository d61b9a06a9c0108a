"""Undistorter: where a camera without distortion would have seen an event, with fractions of a pixel."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal
from amaranth.lib import data, memory
from amaranth.lib.wiring import In, Out

from .. import Block, payloads
from ..arithmetic import delay, small_product


class Undistorter(Block):
    """Moves each event by what a table says, interpolated between the four nodes around its pixel.

    The table has a node every 2^undistortion_cell px; it is exact there, and in between off by what the distortion
    bends within a cell (figures: docs/motion.md). It lies in four banks, by the parity of column and row, so that the
    four nodes are read at once. A reset leaves it as it is; until it was written it holds anything. What comes out is
    rounded to ``undistortion_frac`` bits. No multiplier: the factors have ``undistortion_cell`` bits.

    One event per cycle; latency :attr:`latency` cycles. Four RAMs of ``geometry.node_depth`` words.

    Members
    -------
    i, o : ``In``, ``Out``, flows of :func:`payloads.binned_event`, :func:`payloads.undistorted_event`
    start : ``In(1)``
        A new batch begins: takes over ``enable``. No event in this cycle, nor on its way.
    enable : ``In(1)``
        Without, each event stays in the middle of its pixel.
    write : ``In``, flow of :func:`payloads.node_write`
        Fills the table. Not while events of a batch come that uses it.
    """

    latency = 8

    def __init__(self, config):
        super().__init__(
            config,
            i=In(payloads.flow(payloads.binned_event(config))),
            o=Out(payloads.flow(payloads.undistorted_event(config))),
            start=In(1),
            enable=In(1),
            write=In(payloads.flow(payloads.node_write(config))),
        )

    def elaborate(self, platform):
        m = Module()
        config, event, put = self.config, self.i.payload, self.write.payload
        cell, frac, bits = config.undistortion_cell, config.undistortion_frac, config.geometry.node_column_bits
        enabled = Signal()
        with m.If(self.start):
            m.d.sync += enabled.eq(self.enable)

        # Stages 1 and 2: the RAMs read, and their output registers. Of the nodes left and right of an event, one has an
        # even column.
        column, row = event.x >> cell, event.y >> cell
        node = data.StructLayout({name: payloads.node_write(config)[name].shape for name in ("x", "y")})
        banks = []
        for odd_row, odd_column in ((0, 0), (0, 1), (1, 0), (1, 1)):
            ram = memory.Memory(shape=node, depth=config.geometry.node_depth, init=[])
            m.submodules[f"bank_{2 * odd_row + odd_column}"] = ram
            write, read = ram.write_port(), ram.read_port()
            m.d.comb += [
                write.addr.eq(Cat((put.column >> 1)[:bits], put.row >> 1)),
                write.data.x.eq(put.x),
                write.data.y.eq(put.y),
                write.en.eq(self.write.valid & (put.column[0] == odd_column) & (put.row[0] == odd_row)),
                read.addr.eq(Cat(((column + 1 - odd_column) >> 1)[:bits], (row + 1 - odd_row) >> 1)),
            ]
            banks.append(delay(m, read.data, 1, name=f"node_{2 * odd_row + odd_column}"))
        from_odd_column, from_odd_row = (
            delay(m, axis[0], 2, name=f"odd_{name}") for axis, name in ((column, "column"), (row, "row"))
        )
        right, down = delay(m, event.x[:cell], 4, name="right"), delay(m, event.y[:cell], 6, name="down")

        def between(a, b, factor, name):
            """Two cycles: ``a`` and ``factor``/2^cell of the way to ``b``, with ``cell`` fraction bits more."""
            way, a = delay(m, b - a, 1, name=f"{name}_way"), delay(m, a, 1, name=f"{name}_begin")
            return delay(m, a.shift_left(cell) + small_product(way, factor), 1, name=name)

        for axis, place, fmt in (("x", event.x, config.formats.node_x), ("y", event.y, config.formats.node_y)):
            # Stage 3: the nodes as they lie around the event.
            rows = []
            for even, odd in (banks[:2], banks[2:]):
                rows.append(
                    [Mux(from_odd_column, *pair) for pair in ((odd[axis], even[axis]), (even[axis], odd[axis]))]
                )
            above, below = (
                [delay(m, Mux(from_odd_row, *pair), 1, name=f"{axis}_{name}") for pair in zip(*order, strict=True)]
                for order, name in ((rows[::-1], "above"), (rows, "below"))
            )
            # Stages 4 and 5: along the row. Stages 6 and 7: along the column.
            above, below = (
                between(*pair, right, f"{axis}_{name}")
                for pair, name in ((above, "above_event"), (below, "below_event"))
            )
            moved = between(above, below, down, f"{axis}_moved")
            # Stage 8: round, add; half a pixel more, as the filter wants it.
            drop = 2 * cell + fmt.f - frac
            rounded = (Mux(enabled, moved, 0) + (1 << (drop - 1))).shift_right(drop)
            middle = delay(m, place, self.latency - 1, name=f"start_{axis}")
            m.d.sync += self.o.payload[axis].eq(Cat(Const(1 << (frac - 1), frac), middle) + rounded)
        m.d.comb += self.o.valid.eq(delay(m, self.i.valid, self.latency, name="valid", valid=True))
        for name in event.shape().members:
            if name not in ("x", "y"):
                m.d.comb += self.o.payload[name].eq(delay(m, event[name], self.latency, name=name))
        return m
