"""Probe: velocities beside v, one after the other, and what the last iteration found."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from .. import payloads
from ..arithmetic import delay


class Probe(wiring.Component):
    """Has events warped by v with one parameter after the other ¾ px nearer to 0; v itself stays.

    For motions beyond translation, whose iterations evaluate nothing but v.

    The first probe's velocity is there :attr:`latency` cycles after ``begin``, and each other as many after
    ``complete``, v itself after the last.

    Parameters
    ----------
    config : Config

    Attributes
    ----------
    count : int
        Probes of a batch.

    Members
    -------
    new_batch : ``In(1)``
        Forget the sums.
    iterating : ``In(1)``
        An iteration is under way.
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
    more : ``Out(1)``
        Another probe follows the one that is under way.
    last : ``Out``, :func:`payloads.sums`
        Of the last iteration.
    last_squares : ``Out``, :func:`payloads.squares`
    """

    latency = 3

    def __init__(self, config):
        self.config = config
        self.count = len(config.motion_model.names)
        super().__init__(
            {
                **dict.fromkeys(("new_batch", "iterating", "begin", "complete"), In(1)),
                "v": In(payloads.velocity(config)),
                "sums": In(payloads.flow(payloads.sums(config))),
                "squares": In(payloads.squares(config)),
                "o": Out(payloads.flow(payloads.velocity(config))),
                "more": Out(1),
                "last": Out(payloads.sums(config)),
                "last_squares": Out(payloads.squares(config)),
            }
        )

    def elaborate(self, platform):
        m = Module()
        distance = 3 << (self.config.v_frac - 2)
        turn = Signal(self.count)  # a bit for each parameter; none of them: v
        changes = self.begin | (self.complete & turn.any())
        with m.If(changes):
            m.d.sync += turn.eq(turn << 1 | self.begin)
        m.d.comb += [self.more.eq(turn[:-1].any()), self.o.valid.eq(delay(m, changes, 2, name="changes", valid=True))]
        for k, name in enumerate(self.config.motion_model.names):
            v = self.v[name]
            m.d.sync += self.o.payload[name].eq(v + Mux(turn[k], Mux(v[-1], distance, -distance), 0))
        with m.If(self.new_batch):
            m.d.sync += [self.last.eq(0), self.last_squares.eq(0)]
        with m.Elif(self.sums.valid & self.iterating):
            m.d.sync += [self.last.eq(self.sums.payload), self.last_squares.eq(self.squares)]
        return m
