"""Dither: moves each event by a sub-pixel offset of its own."""

from amaranth.hdl import Cat, Const, Module, Signal
from amaranth.lib import data, wiring
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

    One event per cycle; latency :attr:`latency` cycles. With lanes, all of them have the first lane's sequence, and
    add their distance to it in a cycle of its own.

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
    phases : of the first of several lanes ``Out``, of the others ``In``, array of two
        (k + ½)·α of its event, of x and y.
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
                **({"phases": (In if lane else Out)(data.ArrayLayout(DITHER_BITS, 2))} if config.lanes > 1 else {}),
            }
        )

    def elaborate(self, platform):
        frac, formats = self.config.dither_frac, self.config.formats
        wide = formats.dithered_frac
        m = Module()
        event = self.i.payload
        placed = event if self.config.lanes == 1 else delay(m, event, 1, name="event")
        for number, (axis, factor) in enumerate(zip(("x", "y"), FACTORS, strict=True)):
            phase = self.phases[number] if self.lane else self._sequence(m, axis, factor)
            if self.config.lanes > 1:
                if not self.lane:
                    m.d.comb += self.phases[number].eq(phase)
                phase = (phase + self._by_stride(self.lane * factor))[:DITHER_BITS]
                phase = delay(m, phase, 1, name=f"lane_{axis}")
            place, offset = placed[axis] << (wide - formats.event_frac), phase[-frac:]
            offset = Cat(Const(0, wide - frac), offset) if wide > frac else offset
            m.d.sync += self.o.payload[axis].eq(place + offset - (1 << (wide - 1)))
        valid = delay(m, self.i.valid, self.latency - 1, name="valid", valid=True)
        m.d.sync += [self.o.valid.eq(valid), self.o.payload.t.eq(placed.t), self.o.payload.last.eq(placed.last)]
        return m

    def _by_stride(self, distance):
        """How far the sequence goes for so many events of a replay."""
        top = 1 << DITHER_BITS
        if not by_signs(self.config):
            return distance % top
        return select(self.subset.stride, [stride * distance % top for stride in STRIDES])

    def _sequence(self, m, axis, factor):
        """(k + ½)·α of the event, or the first lane's, that comes."""
        top, lanes, event = 1 << DITHER_BITS, self.config.lanes, self.i.payload
        first = factor // 2
        phase = Signal(DITHER_BITS, init=first, name=f"phase_{axis}")
        begin, start = event.last if lanes > 1 else self.i.valid & event.last, first
        if by_signs(self.config):
            begin = self.started
            start = select(self.subset.first, [(first + k * factor) % top for k in range(STRIDES[-1])])
        with m.If(begin):
            m.d.sync += phase.eq(start)
        with m.Elif(self.i.valid):
            m.d.sync += phase.eq(phase + self._by_stride(lanes * factor))
        return phase
