"""Warp: moves events to t_ref along the candidate velocity."""

from amaranth.hdl import Const, Module, Mux, Signal, signed
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for, floor_shift, signed_bits_for
from .. import Block, payloads
from ..arithmetic import delay, saturate, select
from .flow import Flow


def _halves(config):
    """Half a pixel, as a coordinate and as a position has it: a level's are about the middle of a pixel.

    Without coarse levels the halves cancel; undistorted positions come with theirs.
    """
    scaled = 1 << (config.position_frac - 1)
    if config.formats.event_frac:
        return 0, scaled
    return (1 << (config.dt_frac + config.v_frac - 1), scaled) if config.max_level else (0, 0)


def start_of(config, coordinate):
    """A coordinate, and half a pixel where positions have it, with the fraction bits of dt·v; and its width."""
    align = config.dt_frac + config.v_frac - config.formats.dithered_frac
    return (coordinate << align) + _halves(config)[0], len(coordinate) + align


def of_level(m, config, position, axis, level, *, name):
    """A position of :func:`start_of`'s format in the level's pixels, floored and clamped.

    A cycle later with coarse levels. Then the comparisons stand beside the choice of the level.
    """
    frac = config.dt_frac + config.v_frac - config.position_frac
    levels = [floor_shift(position, frac + number) for number in range(config.max_level + 1)]
    size = config.roi_width if axis == "x" else config.roi_height
    low, high = -2 << config.position_frac, ((size + 1) << config.position_frac) - 1
    half = _halves(config)[1]
    if not config.max_level:
        return saturate(select(level, levels) - half, low, high)
    width = signed_bits_for(max(high, -low))
    place = delay(m, (select(level, levels) - half)[:width].as_signed(), 1, name=f"position_{name}")
    # Both limits are odd numbers of half pixels.
    halves = position >> (frac + config.position_frac - 1)
    least, beyond = (
        select(level, [Const(limit << number) for number in range(config.max_level + 1)])
        for limit in (-3, 2 * size + 3)
    )
    below = delay(m, halves < least, 1, name=f"below_{name}")
    above = delay(m, halves >= beyond, 1, name=f"above_{name}")
    return Mux(below, low, Mux(above, high, place))


class Warp(Block):
    """x' = x − dt·vx, y' = y − dt·vy (Eq. x'_k of the article), floored to ``position_frac`` bits.

    At a coarse level pixels are 2^level px wide: x'' = (x' + ½)/2^level − ½. Positions are clamped to one pixel beyond
    those whose votes can reach the ROI, so that no address aliases. Two multipliers (one DSP each with the
    subtraction).

    One event per cycle; latency :attr:`latency` cycles. ``v`` is used in the cycle in which an event enters, ``level``
    two cycles later. In a motion beyond translation each event has its own velocity, by
    :class:`Flow`, which takes two cycles more.

    Members
    -------
    i : ``In``, flow of :func:`payloads.scaled_event`
    o : ``Out``, flow of :func:`payloads.warped_event`
    v : ``In``, :func:`payloads.velocity`
    level : ``In``
        Changes only with ``v``.
    """

    def __init__(self, config):
        self.flow = Flow(config) if config.motion_model.basis else None
        self._moving = 4 if config.max_level else 3
        self.latency = self._moving + (Flow.latency if self.flow else 0)
        super().__init__(
            config,
            i=In(payloads.flow(payloads.scaled_event(config))),
            o=Out(payloads.flow(payloads.warped_event(config))),
            v=In(payloads.velocity(config)),
            level=In(bits_for(config.max_level)),
        )

    def elaborate(self, platform):
        config = self.config
        m = Module()
        event, v, fmt = self.i.payload, self.v, config.formats.flow
        if self.flow:
            m.submodules.flow = flow = self.flow
            m.d.comb += [flow.basis.eq(event.basis), flow.v.eq(v)]
            event = {name: delay(m, event[name], flow.latency, name=f"{name}_flow") for name in ("dt", "x", "y")}
            v = flow.o
        for axis in ("x", "y"):
            start, width = start_of(config, event[axis])
            product_s1 = Signal(signed(config.formats.dt.width + fmt.width), reset_less=True, name=f"product_{axis}_s1")
            # Both terms at full precision: x' + ½ cannot overflow before it is clamped.
            full = signed(max(width, len(product_s1)) + 2)
            start_s1 = Signal(full, reset_less=True, name=f"start_{axis}_s1")
            inverse_s2 = Signal(full, reset_less=True, name=f"inverse_{axis}_s2")
            m.d.sync += [  # stage 1: multiply
                product_s1.eq(event["dt"] * v[axis]),
                start_s1.eq(start),
            ]
            # Stage 2: subtract. a − b = ~(~a + b), because an addition is what all tools find in a DSP.
            m.d.sync += inverse_s2.eq(~start_s1 + product_s1)
            m.d.sync += self.o.payload[axis].eq(of_level(m, config, ~inverse_s2, axis, self.level, name=axis))
        m.d.sync += [
            self.o.valid.eq(delay(m, self.i.valid, self.latency - 1, name="valid", valid=True)),
            self.o.payload.dt.eq(delay(m, event["dt"], self._moving - 1, name="dt")),
            self.o.payload.last.eq(delay(m, self.i.payload.last, self.latency - 1, name="last")),
        ]
        if "basis" in self.o.payload.shape().members:
            m.d.sync += self.o.payload.basis.eq(delay(m, self.i.payload.basis, self.latency - 1, name="basis"))
        return m
