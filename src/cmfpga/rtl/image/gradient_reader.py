"""Gradient reader: sweeps the images, sums them and their products, and leaves zeros behind."""

from amaranth.hdl import Module, Signal
from amaranth.lib import data
from amaranth.lib.wiring import In, Out

from .. import Block, payloads
from ..arithmetic import accumulate, delay, wide_product


class GradientReader(Block):
    """Sweeps all banks at once, P/4 addresses, and computes ΣI, ΣDx, ΣDy, Σ I·Dx and Σ I·Dy exactly.

    The first address leaves in the cycle of ``start``; the sums are valid :attr:`latency` cycles after the last
    one; ΣI, ΣDx and ΣDy are final :attr:`lead` cycles earlier. Eight products per cycle.

    Members
    -------
    start : ``In(1)``
        Begin a sweep. Not before the sums of the one before are valid.
    sweep : ``Out``, flow of :func:`payloads.sweep_address`
        To the accumulator; ``last`` marks the last address.
    i : ``In``, flow of an array of four :func:`payloads.pixel`
        From the accumulator, ``accumulator_latency`` cycles later.
    o : ``Out``, flow of :func:`payloads.sums`
        One item per sweep.
    """

    #: Cycles by which the plain sums are final before the sums of products: a multiplication's registers.
    lead = 3

    _stages = lead + 2

    def __init__(self, config, *, accumulator_latency):
        self.accumulator_latency = accumulator_latency
        self.latency = accumulator_latency + self._stages
        super().__init__(
            config,
            start=In(1),
            sweep=Out(payloads.flow(payloads.sweep_address(config))),
            i=In(payloads.flow(data.ArrayLayout(payloads.pixel(config), 4))),
            o=Out(payloads.flow(payloads.sums(config))),
        )

    def elaborate(self, platform):
        m = Module()
        self._addresses(m)

        # Stages 1 to 3: multiply, for the sums of products only. Then pairs, then the total.
        first = delay(m, self.sweep.payload.first, self.accumulator_latency, name="first")
        sums = self.o.payload
        pixels = [self.i.payload[number] for number in range(4)]
        for name in pixels[0].shape().members:
            accumulate(m, [pixel[name] for pixel in pixels], sums[name], first, self.i.valid, name=name)
        first = delay(m, first, self.lead, name="first_product")
        active = delay(m, self.i.valid, self.lead, name="active_product", valid=True)
        for name in self.config.motion_model.names:
            products = [
                wide_product(m, pixel.i, pixel[f"d{name}"], self.lead, name=f"product_{name}_{n}")
                for n, pixel in enumerate(pixels)
            ]
            accumulate(m, products, sums[f"s{name}"], first, active, name=f"s{name}")
        last = delay(m, self.sweep.payload.last & self.sweep.valid, self.latency, name="last", valid=True)
        m.d.comb += self.o.valid.eq(last)
        return m

    def _addresses(self, m):
        """Walk the P/4 addresses; the unused ends of rows are skipped."""
        config = self.config
        running = Signal()
        column = Signal(range(max(2, config.geometry.bank_columns)))
        row = Signal(range(max(2, config.geometry.bank_rows)))
        row_ends, ends = Signal(), Signal()
        m.d.comb += [
            self.sweep.valid.eq(self.start | running),
            self.sweep.payload.address.eq((row << config.geometry.bank_column_bits) | column),
            self.sweep.payload.first.eq(self.start),
            self.sweep.payload.last.eq(ends),
            row_ends.eq(column == config.geometry.bank_columns - 1),
            ends.eq(row_ends & (row == config.geometry.bank_rows - 1)),
        ]
        with m.If(self.sweep.valid):
            m.d.sync += [running.eq(~ends), column.eq(column + 1)]
            with m.If(row_ends):
                m.d.sync += [column.eq(0), row.eq(row + 1)]
            with m.If(ends):
                m.d.sync += row.eq(0)
