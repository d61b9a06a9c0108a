"""Warp: moves events to t_ref along the candidate velocity."""

from amaranth.hdl import Module, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for, floor_shift
from .. import payloads
from ..arithmetic import delay, saturate, select
from .flow import Flow


class Warp(wiring.Component):
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
        self.config = config
        self.flow = Flow(config) if config.motion_model.basis else None
        self._moving = 4 if config.max_level else 3
        self.latency = self._moving + (Flow.latency if self.flow else 0)
        super().__init__(
            {
                "i": In(payloads.flow(payloads.scaled_event(config))),
                "o": Out(payloads.flow(payloads.warped_event(config))),
                "v": In(payloads.velocity(config)),
                "level": In(bits_for(config.max_level)),
            }
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
        frac = config.dt_frac + config.v_frac
        # Without coarse levels the halves cancel; undistorted positions come with theirs.
        half, scaled_half = (1 << (frac - 1), 1 << (config.position_frac - 1)) if config.max_level else (0, 0)
        if config.formats.event_frac:
            half, scaled_half = 0, 1 << (config.position_frac - 1)
        for axis, size in (("x", config.roi_width), ("y", config.roi_height)):
            coordinate = event[axis]
            align = frac - config.formats.dithered_frac
            product_s1 = Signal(signed(config.formats.dt.width + fmt.width), reset_less=True, name=f"product_{axis}_s1")
            # Both terms at full precision: x' + ½ cannot overflow before it is clamped.
            full = signed(max(len(coordinate) + align, len(product_s1)) + 2)
            start_s1 = Signal(full, reset_less=True, name=f"start_{axis}_s1")
            inverse_s2 = Signal(full, reset_less=True, name=f"inverse_{axis}_s2")
            m.d.sync += [  # stage 1: multiply
                product_s1.eq(event["dt"] * v[axis]),
                start_s1.eq((coordinate << align) + half),
            ]
            # Stage 2: subtract. a − b = ~(~a + b), because an addition is what all tools find in a DSP.
            m.d.sync += inverse_s2.eq(~start_s1 + product_s1)
            position_s2 = ~inverse_s2
            # Stage 3, with coarse levels only: the level's pixels. Last stage: floor, clamp.
            levels = [
                floor_shift(position_s2, frac - config.position_frac + level) for level in range(config.max_level + 1)
            ]
            position = select(self.level, levels) - scaled_half
            if config.max_level:
                position = delay(m, position, 1, name=f"position_{axis}")
            m.d.sync += self.o.payload[axis].eq(
                saturate(position, -2 << config.position_frac, ((size + 1) << config.position_frac) - 1)
            )
        m.d.sync += [
            self.o.valid.eq(delay(m, self.i.valid, self.latency - 1, name="valid", valid=True)),
            self.o.payload.dt.eq(delay(m, event["dt"], self._moving - 1, name="dt")),
            self.o.payload.last.eq(delay(m, self.i.payload.last, self.latency - 1, name="last")),
        ]
        if "basis" in self.o.payload.shape().members:
            m.d.sync += self.o.payload.basis.eq(delay(m, self.i.payload.basis, self.latency - 1, name="basis"))
        return m
