"""Placer: where and when an event of the ring lies in the window that is evaluated."""

from amaranth.hdl import Cat, Const, Module, Signal, signed
from amaranth.lib.wiring import In, Out

from ...config.dither import DITHER_BITS, FACTORS
from ...fixed import Q, bits_for
from .. import Block, payloads
from ..arithmetic import delay
from .ring import ring_event


def placed_event(config):
    """An event of a window: µs since its first one; its place from the image's corner on, dithered, before the warp.

    It lies outside of the image where the object came from, or goes to. Where the hardware undistorts, it has still
    half a pixel more than it is, as of :func:`payloads.dithered_event`.
    """
    # With that half, and the dither's, an event of the sensor's last pixel may reach the one behind it.
    last = 0 if config.formats.event_frac and config.dither_frac else 1
    sizes, frac = zip("xy", config.geometry.size, strict=True), config.formats.dithered_frac
    places = {axis: payloads.Fixed(Q(bits_for(size - last), frac)) for axis, size in sizes}
    return payloads.layout(t=signed(config.span_bits + 1), **places, last=1)


class Placer(Block):
    """Subtracts the window's first time and the image's corner, and adds the dither, if there is one.

    The dither goes on from event to event, from the phase that the walker gives.
    One event per cycle; latency :attr:`latency` cycles.

    Members
    -------
    i : ``In``, flow of :func:`.ring.ring_event`, and ``last``
    o : ``Out``, flow of :func:`placed_event`
    start : ``In(1)``
        A replay begins: take over the phase. No event in this cycle.
    phase_x, phase_y, t_first, corner : ``In``
        As of the walker; and the left column and top row of the image. Constant during a replay.
    """

    latency = 2

    def __init__(self, config):
        super().__init__(
            config,
            i=In(payloads.flow(payloads.layout(**ring_event(config).members, last=1))),
            o=Out(payloads.flow(placed_event(config))),
            start=In(1),
            phase_x=In(DITHER_BITS),
            phase_y=In(DITHER_BITS),
            t_first=In(config.span_bits),
            corner=In(payloads.roi_corner(config)),
        )

    def elaborate(self, platform):
        config, event = self.config, self.i.payload
        frac, wide, dithered = config.formats.event_frac, config.formats.dithered_frac, config.dither_frac
        m = Module()
        # Stage 1: subtract. Stage 2: dither.
        t_s1 = Signal(config.span_bits, reset_less=True)
        m.d.sync += [t_s1.eq(event.t - self.t_first), self.o.payload.t.eq(t_s1)]
        for axis, factor in zip("xy", FACTORS, strict=True):
            difference = event[axis] - Cat(Const(0, frac), self.corner[axis])
            at_s1 = delay(m, difference, 1, name=axis)
            place = at_s1 << (wide - frac)
            if dithered:
                phase = Signal(DITHER_BITS, name=f"phase_{axis}_s1")
                offset_s1 = Signal(dithered, name=f"offset_{axis}_s1", reset_less=True)
                m.d.sync += offset_s1.eq(phase[-dithered:])
                with m.If(self.start):
                    m.d.sync += phase.eq(getattr(self, f"phase_{axis}"))
                with m.Elif(self.i.valid):
                    m.d.sync += phase.eq(phase + factor)
                place = place + Cat(Const(0, wide - dithered), offset_s1) - (1 << (wide - 1))
            m.d.sync += self.o.payload[axis].eq(place)
        m.d.sync += [
            self.o.payload.last.eq(delay(m, event.last, 1, name="last")),
            self.o.valid.eq(delay(m, self.i.valid, 1, name="valid", valid=True)),
        ]
        return m
