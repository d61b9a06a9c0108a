"""The article's way to sum: keep three images, and sweep them after the last vote."""

from amaranth.hdl import Module, Signal
from amaranth.lib.wiring import connect, flipped

from .accumulator import Accumulator
from .gradient_reader import GradientReader
from .image_sums import ImageSums


class SweptImage(ImageSums):
    """Accumulator and gradient reader: the sweep begins as soon as the last vote has entered, and leaves zeros.

    See :class:`ImageSums` for parameters, members and attributes.
    """

    def __init__(self, config, *, in_flight):
        self.accumulator = Accumulator(config)
        self.gradient_reader = GradientReader(config, accumulator_latency=self.accumulator.latency)
        self.latency = self.gradient_reader.latency
        self.sweep_cycles = config.geometry.bank_words
        super().__init__(config, in_flight=in_flight, pixels=True)

    @property
    def blocks(self):
        return {"accumulator": self.accumulator, "gradient_reader": self.gradient_reader}

    def elaborate(self, platform):
        m = Module()
        m.submodules.accumulator = accumulator = self.accumulator
        m.submodules.gradient_reader = reader = self.gradient_reader
        start = Signal()
        m.d.sync += start.eq((self.votes.valid & self.votes.payload.last) | self.clear)
        connect(m, flipped(self.votes), accumulator.i)
        connect(m, reader.sweep, accumulator.sweep)
        connect(m, accumulator.o, reader.i)
        connect(m, reader.o, flipped(self.sums))
        m.d.comb += [
            self.room.eq(1),
            self.pixels.valid.eq(accumulator.o.valid),
            self.pixels.payload.eq(accumulator.o.payload),
            reader.start.eq(start),
            self.complete.eq(reader.sweep.valid & reader.sweep.payload.last),
            self.cleared.eq(reader.o.valid),  # not before: a result must not see the sums of this sweep change
        ]
        return m
