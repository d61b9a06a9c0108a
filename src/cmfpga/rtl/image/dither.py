"""Dither: moves each event by a sub-pixel offset of its own."""

from amaranth.hdl import Cat, Const, Module, Signal
from amaranth.lib.wiring import In, Out

from ...config.dither import DITHER_BITS, FACTORS
from ...config.schedule import STRIDES
from .. import Block, payloads
from ..arithmetic import carry, delay, select


class Dither(Block):
    """Adds frac((k + ½)·α) − ½ to column and row of the k-th stored event (:mod:`cmfpga.config.dither`).

    Events sit on whole pixels, which makes v = 0 a peak of the contrast whatever the motion is; the offsets remove it.
    They depend on k alone, so every iteration sees the same, and the buffer need not store them; a replay of a subset
    says which k its events have.

    One event per cycle; latency :attr:`latency` cycles.

    Parameters
    ----------
    config : Config
        ``dither_frac``, not zero.

    Members
    -------
    i : ``In``, flow of :func:`payloads.replayed_event`
    o : ``Out``, flow of :func:`payloads.dithered_event`
    started, subset : ``In``
        As in :class:`~cmfpga.rtl.ingest.event_buffer.EventBuffer`: a replay has begun, before its first event. Without
        a schedule, the next one begins behind the last event.
    """

    latency = 2

    def __init__(self, config):
        subset = {"started": In(1), "subset": In(payloads.subset(config))}
        super().__init__(
            config,
            i=In(payloads.flow(payloads.replayed_event(config))),
            o=Out(payloads.flow(payloads.dithered_event(config))),
            **(subset if config.ascent_rule.strides else {}),
        )

    def elaborate(self, platform):
        frac, formats = self.config.dither_frac, self.config.formats
        wide = formats.dithered_frac
        m = Module()
        event = self.i.payload
        for axis, factor in zip(("x", "y"), FACTORS, strict=True):
            phase = self._sequence(m, axis, factor)
            # Stage 1: the buffer's output. Stage 2: add.
            event_s1 = delay(m, event[axis], 1, name=axis)
            place, offset = event_s1 << (wide - formats.event_frac), delay(m, phase[-frac:], 1, name=f"offset_{axis}")
            offset = Cat(Const(0, wide - frac), offset) if wide > frac else offset
            m.d.sync += self.o.payload[axis].eq(place + offset - (1 << (wide - 1)))
        carry(m, self, "t", "last")
        return m

    def _sequence(self, m, axis, factor):
        """(k + ½)·α of the event that comes."""
        top, first, step = 1 << DITHER_BITS, factor // 2, factor
        phase = Signal(DITHER_BITS, init=first, name=f"phase_{axis}")
        begin, start = self.i.valid & self.i.payload.last, first
        if self.config.ascent_rule.strides:
            begin = self.started
            start = select(self.subset.first, [(first + k * factor) % top for k in range(STRIDES[-1])])
            step = select(self.subset.stride, [stride * factor % top for stride in STRIDES])
        with m.If(begin):
            m.d.sync += phase.eq(start)
        with m.Elif(self.i.valid):
            m.d.sync += phase.eq(phase + step)
        return phase
