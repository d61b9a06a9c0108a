"""Flow: how far each event moves, in a motion beyond translation."""

from amaranth.hdl import Module, Signal
from amaranth.lib.wiring import In, Out

from ...fixed import round_half_up
from .. import Block, payloads
from ..arithmetic import delay


class Flow(Block):
    """u = v + Σ v_p·b_p along x and y, rounded to ``v_frac`` bits (:attr:`cmfpga.config.motion.MotionModel.terms`).

    A multiplier for each term: four in a similarity, six in a rotation. One event per cycle; latency :attr:`latency`
    cycles. ``v`` is used in the cycle in which an event enters.

    Parameters
    ----------
    config : Config
        A motion with a basis.

    Members
    -------
    basis : ``In``, :func:`payloads.basis`
    v : ``In``, :func:`payloads.velocity`
    o : ``Out``, :func:`payloads.displacement`
    """

    latency = 2

    def __init__(self, config):
        super().__init__(
            config,
            basis=In(payloads.basis(config)),
            v=In(payloads.velocity(config)),
            o=Out(payloads.displacement(config)),
        )

    def elaborate(self, platform):
        motion = self.config.motion_model
        m = Module()
        for axis, terms in motion.terms.items():
            # Stage 1: multiply.
            products_s1 = [
                delay(m, self.v[name] * self.basis[member], 1, name=f"{name}_{member}_{axis}")
                for name, member, _ in terms
            ]
            own_s1 = delay(m, self.v[axis], 1, name=f"own_{axis}")
            # Stage 2: add.
            total = own_s1.shift_left(motion.frac)
            for product, (_, _, sign) in zip(products_s1, terms, strict=True):
                total = total + product if sign > 0 else total - product
            u_s2 = Signal(self.o[axis].shape(), name=f"u_{axis}_s2", reset_less=True)
            m.d.sync += u_s2.eq(round_half_up(total, motion.frac))
            m.d.comb += self.o[axis].eq(u_s2)
        return m
