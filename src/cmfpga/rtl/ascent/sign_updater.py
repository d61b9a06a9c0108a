"""Sign updater: holds v and moves it by a step of the schedule, up the gradient."""

from amaranth.hdl import Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from .. import payloads
from ..arithmetic import delay, saturate


class SignUpdater(wiring.Component):
    """v ← v + 2^shift · sign(G), each axis by itself; v saturates. No multiplier, no normalisation.

    ``v`` changes, and ``done`` is high, :attr:`latency` cycles after a gradient enters.

    Parameters
    ----------
    config : Config
        Formats.

    Members
    -------
    i : ``In``, flow of :func:`payloads.gradient`
    new_batch : ``In(1)``
        A batch begins: forget ``saturated``.
    load : ``In(1)``
        Take ``start``. At least two cycles before a gradient enters.
    start : ``In``, :func:`payloads.velocity`
    shift : ``In``
        log2 of the step in raw units of v.
    v : ``Out``, :func:`payloads.velocity`
        Zero after a reset.
    updating, done : ``Out(1)``
        v changes at the end of this cycle; v has changed.
    saturated : ``Out(1)``
        Whether v was limited to its format since ``new_batch``.
    """

    latency = 2

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                "i": In(payloads.flow(payloads.gradient(config))),
                "new_batch": In(1),
                "load": In(1),
                "start": In(payloads.velocity(config)),
                "shift": In(payloads.schedule_entry(config)["shift"].shape),
                "v": Out(payloads.velocity(config)),
                "updating": Out(1),
                "done": Out(1),
                "saturated": Out(1),
            }
        )

    def elaborate(self, platform):
        config = self.config
        m = Module()
        m.d.comb += self.updating.eq(delay(m, self.i.valid, 1, name="valid", valid=True))
        m.d.sync += self.done.eq(self.updating)
        clipped = []
        for axis in ("x", "y"):
            v, g = self.v[axis], self.i.payload[axis]
            # Stage 1: sign. Stage 2: step and limit.
            sign_s1 = Signal(signed(2), name=f"sign_{axis}_s1", reset_less=True)
            m.d.sync += sign_s1.eq(Mux(g == 0, 0, Mux(g < 0, -1, 1)))
            target = Signal(signed(config.formats.v.width + 1), name=f"target_{axis}")
            step = 1 << self.shift
            m.d.comb += target.eq(v + Mux(sign_s1 == 0, 0, Mux(sign_s1 < 0, -step, step)))
            with m.If(self.load):
                m.d.sync += v.eq(self.start[axis])
            with m.Elif(self.updating):
                m.d.sync += v.eq(saturate(target, config.formats.v.min, config.formats.v.max))
            clipped.append((target > config.formats.v.max) | (target < config.formats.v.min))
        with m.If(self.new_batch):
            m.d.sync += self.saturated.eq(0)
        with m.Elif(self.updating & (clipped[0] | clipped[1])):
            m.d.sync += self.saturated.eq(1)
        return m
