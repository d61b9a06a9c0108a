"""One-pass gradient: the sums over the images, kept up to date vote by vote."""

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from . import payloads
from .arithmetic import accumulate, delay


class OnePassGradient(wiring.Component):
    """ΣI, ΣDx, ΣDy, Σ I·Dx and Σ I·Dy, complete when the last vote has landed: no sweep.

    When a pixel goes from (I, D) to (I + w, D + d), Σ I·D grows by I·d + w·(D + d); the accumulator has all of these in
    hand. In integers that is the sweep's sum, bit for bit. Sixteen products per cycle, narrow ones: a full pixel by a
    vote.

    One event per cycle; the sums are valid :attr:`latency` cycles after the last votes enter the accumulator, and ΣI,
    ΣDx and ΣDy final :attr:`lead` cycles earlier at the latest.

    Parameters
    ----------
    config : Config
        Widths.

    Members
    -------
    votes : ``In``, flow of :func:`payloads.votes`
        As they enter the accumulator.
    steps : ``In``, array of four :func:`payloads.tagged_step`
        From the accumulator, ``accumulator_latency`` cycles later.
    o : ``Out``, flow of :func:`payloads.sums`
        One item per iteration.
    """

    #: Cycles by which the plain sums are final before the sums of products, as :class:`Gradient` needs.
    lead = 3

    _stages = 4  # multiply, add both products, pairs, total

    def __init__(self, config, *, accumulator_latency):
        self.config = config
        self.accumulator_latency = accumulator_latency
        self.latency = accumulator_latency + self._stages
        super().__init__(
            {
                "votes": In(payloads.flow(payloads.votes(config))),
                "steps": In(data.ArrayLayout(payloads.tagged_step(config), 4)),
                "o": Out(payloads.flow(payloads.sums(config))),
            }
        )

    def elaborate(self, platform):
        m = Module()
        votes, sums = self.votes.payload, self.o.payload
        first = Signal(init=1)
        with m.If(self.votes.valid):
            m.d.sync += first.eq(votes.last)
        for name in ("i", "dx", "dy"):
            values = [Mux(votes.banks[n].valid, votes.banks[n][name], 0) for n in range(4)]
            accumulate(m, values, sums[name], first, self.votes.valid, name=name)

        # Stage 1: multiply. Stage 2: what the bank's vote adds to S. Stages 3, 4: sum.
        for axis in ("x", "y"):
            growths = []
            for n in range(4):
                step = self.steps[n]
                old = step.i * step.add[f"d{axis}"]
                new = step.add.i * step.total[f"d{axis}"]
                old_s1 = delay(m, old, 1, name=f"old_{axis}_{n}")
                new_s1 = delay(m, new, 1, name=f"new_{axis}_{n}")
                valid_s1 = delay(m, step.valid, 1, name=f"valid_{axis}_{n}", valid=True)
                growths.append(delay(m, Mux(valid_s1, old_s1 + new_s1, 0), 1, name=f"growth_{axis}_{n}"))
            cycles = self.accumulator_latency + 2
            active = delay(m, self.votes.valid, cycles, name=f"active_{axis}", valid=True)
            accumulate(
                m, growths, sums[f"s{axis}"], delay(m, first, cycles, name=f"first_{axis}"), active, name=f"s{axis}"
            )
        last = delay(m, self.votes.valid & votes.last, self.latency, name="last", valid=True)
        m.d.comb += self.o.valid.eq(last)
        return m
