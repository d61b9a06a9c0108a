"""Probe: two velocities beside the last iteration's, and the sums that the image has at each."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from .. import payloads
from ..arithmetic import delay


class Probe(wiring.Component):
    """Has events warped ¾ px beside the velocity of the last iteration, first along x, then along y, towards v = 0.

    v itself stays. A probe never leaves v's format: v and the velocity before it differ by less than half the range.

    The first probe's velocity is there :attr:`latency` cycles after ``begin``, the second's in the cycle after
    ``complete``.

    Parameters
    ----------
    config : Config

    Members
    -------
    new_batch : ``In(1)``
        Forget the sums.
    iterating : ``In(1)``
        An iteration is under way.
    probing : ``In(2)``
        The probe along x is, or that along y.
    begin : ``In(1)``
        v is the batch's result, and is to be probed. One cycle.
    complete : ``In(1)``
        The image has taken in an evaluation.
    v : ``In``, :func:`payloads.velocity`
    sums : ``In``, flow of :func:`payloads.sums`
    squares : ``In``, :func:`payloads.squares`
        With ``sums``.
    o : ``Out``, flow of :func:`payloads.velocity`
        By what to warp from now on.
    away : ``Out(2)``
        Whether the probes along x and y have a smaller v than the iteration.
    last, x, y : ``Out``, :func:`payloads.sums`
        Of the last iteration and of the probes; those of the last iteration are there a cycle after they came.
    last_squares : ``Out``, :func:`payloads.squares`
    """

    latency = 3

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                **dict.fromkeys(("new_batch", "iterating", "begin", "complete"), In(1)),
                "probing": In(2),
                "v": In(payloads.velocity(config)),
                "sums": In(payloads.flow(payloads.sums(config))),
                "squares": In(payloads.squares(config)),
                "o": Out(payloads.flow(payloads.velocity(config))),
                "away": Out(2),
                **dict.fromkeys(("last", "x", "y"), Out(payloads.sums(config))),
                "last_squares": Out(payloads.squares(config)),
            }
        )

    def elaborate(self, platform):
        m = Module()
        self._velocities(m)
        for evaluated, sums in ((self.iterating, self.last), (self.probing[0], self.x), (self.probing[1], self.y)):
            with m.If(self.new_batch):
                m.d.sync += sums.eq(0)
            with m.Elif(self.sums.valid & evaluated):
                m.d.sync += sums.eq(self.sums.payload)
        with m.If(self.new_batch):
            m.d.sync += self.last_squares.eq(0)
        with m.Elif(self.sums.valid & self.iterating):
            m.d.sync += self.last_squares.eq(self.squares)
        return m

    def _velocities(self, m):
        distance = 3 << (self.config.v_frac - 2)
        first = delay(m, self.begin, self.latency - 1, name="begin", valid=True)
        m.d.comb += self.o.valid.eq(first | (self.complete & (self.probing != 0)))
        for k, name in enumerate(("x", "y")):
            v = self.v[name]
            before = Signal.like(v, name=f"before_{name}", reset_less=True)
            probe = Signal.like(v, name=f"probe_{name}", reset_less=True)
            with m.If(self.sums.valid & self.iterating):
                m.d.sync += before.eq(v)
            m.d.sync += [self.away[k].eq(v > 0), probe.eq(before + Mux(self.away[k], -distance, distance))]
            # Along x until that evaluation is complete, along y until the next is; then v again.
            mine, others = (first, self.probing[0]) if name == "x" else (self.probing[0] & ~first, first)
            m.d.comb += self.o.payload[name].eq(Mux(mine, probe, Mux(others, before, v)))
        return m
