"""Dither: moves each event by a sub-pixel offset of its own."""

from amaranth.hdl import Cat, Const, Module, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ...config.dither import DITHER_BITS, FACTORS
from ...config.schedule import STRIDES
from ...protocol.settings import by_signs
from .. import payloads
from ..arithmetic import delay, select


class Dither(wiring.Component):
    """Adds frac((k + ½)·α) − ½ to column and row of the k-th stored event (:mod:`cmfpga.config.dither`).

    Events sit on whole pixels, which makes v = 0 a peak of the contrast whatever the motion is; the offsets remove it.
    They depend on k alone, so every iteration sees the same, and the buffer need not store them; a replay of a subset
    says which k its events have.

    One event per cycle; latency :attr:`latency` cycles. With lanes, all of them have the first lane's sequence, which
    synthesis merges, and add their distance to it in a cycle of its own.

    Parameters
    ----------
    config : Config
        ``dither_frac``, not zero.
    lane : int
        Of ``config.lanes``, among which the events are dealt out in turn: the first event is that with this number.

    Members
    -------
    i : ``In``, flow of :func:`payloads.replayed_event`
    o : ``Out``, flow of :func:`payloads.dithered_event`
    started, subset : ``In``
        As in :class:`~cmfpga.rtl.ingest.event_buffer.EventBuffer`: a replay has begun, before its first event. Without
        a schedule, the next one begins behind the last event.
    """

    def __init__(self, config, lane=0):
        self.config, self.lane = config, lane
        self.latency = 1 if config.lanes == 1 else 2
        subset = {"started": In(1), "subset": In(payloads.subset(config))}
        super().__init__(
            {
                "i": In(payloads.flow(payloads.replayed_event(config))),
                "o": Out(payloads.flow(payloads.dithered_event(config))),
                **(subset if by_signs(config) else {}),
            }
        )

    def elaborate(self, platform):
        frac, formats = self.config.dither_frac, self.config.formats
        wide = formats.dithered_frac
        m = Module()
        event = self.i.payload
        placed = event if self.config.lanes == 1 else delay(m, event, 1, name="event")
        for axis, factor in zip(("x", "y"), FACTORS, strict=True):
            top, lanes = 1 << DITHER_BITS, self.config.lanes
            first = factor // 2
            phase = Signal(DITHER_BITS, init=first, name=f"phase_{axis}")
            begin, start, step = event.last if lanes > 1 else self.i.valid & event.last, first, lanes * factor % top
            distance = self.lane * factor % top
            if by_signs(self.config):
                begin = self.started
                start = select(self.subset.first, [(factor // 2 + k * factor) % top for k in range(STRIDES[-1])])
                step = select(self.subset.stride, [lanes * stride * factor % top for stride in STRIDES])
                distance = select(self.subset.stride, [self.lane * stride * factor % top for stride in STRIDES])
            with m.If(begin):
                m.d.sync += phase.eq(start)
            with m.Elif(self.i.valid):
                m.d.sync += phase.eq(phase + step)
            if lanes > 1:
                phase = delay(m, (phase + distance)[:DITHER_BITS], 1, name=f"lane_{axis}")
            place, offset = placed[axis] << (wide - formats.event_frac), phase[-frac:]
            offset = Cat(Const(0, wide - frac), offset) if wide > frac else offset
            m.d.sync += self.o.payload[axis].eq(place + offset - (1 << (wide - 1)))
        valid = delay(m, self.i.valid, self.latency - 1, name="valid", valid=True)
        m.d.sync += [self.o.valid.eq(valid), self.o.payload.t.eq(placed.t), self.o.payload.last.eq(placed.last)]
        return m
