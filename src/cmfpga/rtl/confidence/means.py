"""Means: what a round's evaluations found on average."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from .. import payloads
from ..arithmetic import delay


class Means(wiring.Component):
    """ΣI, S and Σ I², added up over the four evaluations of a round, then divided by four, rounded down. ΣD is 0.

    Parameters
    ----------
    config : Config

    Members
    -------
    new_batch : ``In(1)``
        Forget.
    i : ``In``, flow of :func:`payloads.sums`
        Of the four evaluations.
    squares : ``In``, :func:`payloads.squares`
        With ``i``. Only where v's confidence is measured.
    done : ``Out(1)``
        A pulse, a cycle after a round's last item: from then on ``o`` is right, until another round's first one.
    o : ``Out``, :func:`payloads.sums`
    o_squares : ``Out``, :func:`payloads.squares`
        Only where v's confidence is measured.
    """

    def __init__(self, config):
        self.config = config
        sums, squares = payloads.sums(config), payloads.squares(config) if config.confidence else None
        super().__init__(
            {
                "new_batch": In(1),
                "i": In(payloads.flow(sums)),
                "done": Out(1),
                "o": Out(sums),
                **({"squares": In(squares), "o_squares": Out(squares)} if config.confidence else {}),
            }
        )

    def elaborate(self, platform):
        m = Module()
        turn = Signal(2)
        m.d.sync += turn.eq(turn + self.i.valid)
        m.d.comb += self.done.eq(delay(m, self.i.valid & turn.all(), 1, name="last", valid=True))
        names = ("i", *(f"s{name}" for name in self.config.motion_model.names))
        pairs = {name: (self.i.payload[name], self.o[name]) for name in names}
        if self.config.confidence:
            pairs["squares"] = self.squares, self.o_squares
        for name, (each, mean) in pairs.items():
            total = Signal((each + each + each + each).shape(), name=f"total_{name}")
            m.d.comb += mean.eq(total >> 2)
            with m.If(self.new_batch):
                m.d.sync += total.eq(0)
            with m.Elif(self.i.valid):
                m.d.sync += total.eq(each + Mux(turn == 0, 0, total))
        return m
