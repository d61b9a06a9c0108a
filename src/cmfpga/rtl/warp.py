"""Warp: moves events to t_ref along the candidate velocity."""

from amaranth.hdl import Module, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ..fixed import floor_shift
from . import payloads
from .arithmetic import delay, saturate


class Warp(wiring.Component):
    """x' = x − dt·vx, y' = y − dt·vy (Eq. x'_k of the article), floored to ``position_frac`` bits.

    Positions are clamped to one pixel beyond those whose votes can reach the ROI, so that no address aliases.
    Two multipliers (one DSP each: product, then C − product).

    One event per cycle; latency :attr:`latency` cycles. ``v`` is used in the cycle in which an event enters.

    Parameters
    ----------
    config : Config
        Formats and ROI size.

    Members
    -------
    i : ``In``, flow of :func:`payloads.scaled_event`
    o : ``Out``, flow of :func:`payloads.warped_event`
    v : ``In``, :func:`payloads.velocity`
    """

    latency = 3

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                "i": In(payloads.flow(payloads.scaled_event(config))),
                "o": Out(payloads.flow(payloads.warped_event(config))),
                "v": In(payloads.velocity(config)),
            }
        )

    def elaborate(self, platform):
        config = self.config
        m = Module()
        frac = config.dt_frac + config.v_frac
        for axis, size in (("x", config.roi_width), ("y", config.roi_height)):
            coordinate = self.i.payload[axis]
            product_s1 = Signal(signed(config.dt.width + config.v.width), reset_less=True, name=f"product_{axis}_s1")
            coordinate_s1 = Signal(coordinate.shape(), reset_less=True, name=f"coordinate_{axis}_s1")
            # Both terms at full precision: x' cannot overflow before it is clamped.
            position_s2 = Signal(
                signed(max(len(coordinate) + frac, len(product_s1)) + 2), reset_less=True, name=f"position_{axis}_s2"
            )
            m.d.sync += [  # stage 1: multiply
                product_s1.eq(self.i.payload.dt * self.v[axis]),
                coordinate_s1.eq(coordinate),
            ]
            m.d.sync += position_s2.eq((coordinate_s1 << frac) - product_s1)  # stage 2: subtract
            m.d.sync += self.o.payload[axis].eq(  # stage 3: floor, clamp
                saturate(
                    floor_shift(position_s2, frac - config.position_frac),
                    -2 << config.position_frac,
                    ((size + 1) << config.position_frac) - 1,
                )
            )
        m.d.sync += [
            self.o.valid.eq(delay(m, self.i.valid, self.latency - 1, name="valid", valid=True)),
            self.o.payload.dt.eq(delay(m, self.i.payload.dt, self.latency - 1, name="dt")),
            self.o.payload.last.eq(delay(m, self.i.payload.last, self.latency - 1, name="last")),
        ]
        return m
