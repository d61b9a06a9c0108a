"""Moments: the gradient by each parameter of a motion beyond translation."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for
from .. import Block, payloads
from ..arithmetic import delay, select


class Moments(Block):
    """S_p = Σ b_p·(what an event adds to Σ I·D), over both axes and all events.

    The sum of a parameter is that of the increments that :class:`~.one_pass_gradient.OnePassGradient` has in hand, each
    times the basis of the event that makes it. For the votes that the event meets in its pixels that is not their own
    basis, but that of an event at most a few px away. A zoom would be found too large by that; so in a similarity the
    basis is that of the pixels (:attr:`cmfpga.config.motion.MotionModel.of_pixels`): of the upper left one for all
    four, and what the right and lower ones add once more.

    A multiplier for each term, as in the flow, each with an accumulator. One event per cycle; latency :attr:`latency`
    cycles.

    Parameters
    ----------
    config : Config
        A motion with a basis.

    Members
    -------
    growth_x, growth_y : ``In``
        Zero where there is no event.
    basis : ``In``, :func:`payloads.basis`
        With them.
    begin : ``In(1)``
        With an iteration's first event.
    far, level : ``In``
        Where the moments are those of pixels: of an increment what the right (p) and lower (q) pixels add, whose basis
        is by a pixel larger; and with ``begin`` the level, which says how wide a pixel is.
    o : ``Out``
        S of each parameter of the motion.
    """

    latency = 3

    def __init__(self, config):
        growth, far = payloads.growth(config), {}
        if config.motion_model.of_pixels:
            line = data.StructLayout({"p": growth, "q": growth})
            far = {"far": In(data.StructLayout({"x": line, "y": line})), "level": In(bits_for(config.max_level))}
        super().__init__(
            config,
            **far,
            growth_x=In(growth),
            growth_y=In(growth),
            basis=In(payloads.basis(config)),
            begin=In(1),
            o=Out(payloads.moments(config)),
        )

    def elaborate(self, platform):
        config, motion = self.config, self.config.motion_model
        m = Module()
        growth = {"x": self.growth_x, "y": self.growth_y}
        begin_s1 = delay(m, self.begin, 1, name="begin", valid=True)
        if motion.of_pixels:
            level, level_s1 = Signal.like(self.level), delay(m, self.level, 1, name="level")
            with m.If(begin_s1):
                m.d.sync += level.eq(level_s1)

        def total(value, name):
            """Stage 2: sum over the events."""
            register = Signal(self.o[motion.names[0]].shape(), name=f"total_{name}")
            m.d.sync += register.eq(value + Mux(begin_s1, 0, register))
            return register

        plain = {axis: total(delay(m, value, 1, name=f"own_{axis}"), axis) for axis, value in growth.items()}
        for name in motion.names:
            # Stage 3: join the terms.
            s = plain[name].shift_left(motion.frac) if name in plain else 0
            for axis, member, sign in motion.factors(name):
                # Stage 1: multiply.
                product_s1 = delay(m, growth[axis] * self.basis[member], 1, name=f"{name}_{axis}_{member}")
                part = total(product_s1, f"{name}_{axis}")
                if motion.of_pixels:
                    beyond = total(delay(m, self.far[axis][member], 1, name=f"far_{name}_{axis}"), f"far_{name}_{axis}")
                    widths = [beyond.shift_left(each + motion.place_frac) for each in range(config.max_level + 1)]
                    part = part + select(level, widths)
                s = s + part if sign > 0 else s - part
            register = Signal(self.o[name].shape(), name=f"s_{name}", reset_less=True)
            m.d.sync += register.eq(s)
            m.d.comb += self.o[name].eq(register)
        return m
