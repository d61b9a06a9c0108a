"""Curvature: how far the gradient falls between the probes."""

from amaranth.hdl import Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from .. import payloads
from ..arithmetic import delay


class Curvature(wiring.Component):
    """Adds the gradients below v and subtracts those above it, as they come: the curvatures xx, yy, cross.

    ``done`` is high :attr:`latency` cycle after the gradient of the last probe.

    Parameters
    ----------
    config : Config

    Members
    -------
    new_batch : ``In(1)``
        Forget.
    i : ``In``, flow of :func:`payloads.gradient`
        Of the four probes, in their order.
    curvature : ``Out``, :func:`payloads.curvature`
        Right from ``done`` on; 0 if nothing was probed since ``new_batch``.
    done : ``Out(1)``
    """

    latency = 1

    def __init__(self, config):
        self._zeros = config.widths.g_zeros
        super().__init__(
            {
                "new_batch": In(1),
                "i": In(payloads.flow(payloads.gradient(config))),
                "curvature": Out(payloads.curvature(config)),
                "done": Out(1),
            }
        )

    def elaborate(self, platform):
        m = Module()
        m.d.comb += self.done.eq(subtract(m, self, self._zeros))
        return m


def subtract(m, block, zeros):
    """What :class:`Curvature` does, in a module of a ``block`` with its members; returns ``done``.

    ``zeros``: so many lowest bits of G are always 0, and take no adder.
    """
    came = Signal(2)  # bit 0: from above v; bit 1: along y
    g, last = block.i.payload, block.i.valid & came.all()
    x, y = g.x[zeros:].as_signed(), g.y[zeros:].as_signed()
    own, other = (Mux(came[1], *pair) ^ came[0].replicate(len(x)).as_signed() for pair in ((y, x), (x, y)))
    for name, grows, addend in (("xx", ~came[1], own), ("yy", came[1], own), ("cross", 1, other)):
        found = Signal(signed(len(block.curvature[name]) - zeros), name=f"found_{name}")
        m.d.comb += block.curvature[name].eq(found << zeros)
        with m.If(block.new_batch):
            m.d.sync += found.eq(0)
        with m.Elif(block.i.valid & grows):
            m.d.sync += found.eq(found + addend + came[0])
    with m.If(block.new_batch):
        m.d.sync += came.eq(0)
    with m.Elif(block.i.valid):
        m.d.sync += came.eq(came + 1)
    return delay(m, last, 1, name="last", valid=True)
