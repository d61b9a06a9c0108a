"""Lane sums: what the votes of all lanes and the steps of all banks add to the sums."""

from amaranth.hdl import Module, Mux
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from ... import payloads
from ...arithmetic import delay

#: Numbers that are added in one cycle.
FAN_IN = 4


def stages(count):
    """Cycles in which :func:`add_up` adds ``count`` numbers."""
    return 0 if count <= 2 else 1 + stages(-(-count // FAN_IN))


def add_up(m, values, name):
    """``values`` added to one or two numbers, :func:`stages` cycles later."""
    if len(values) <= 2:
        return values
    groups = zip(*[iter(values)] * FAN_IN, strict=True)
    sums = [delay(m, (a + b) + (c + d), 1, name=f"{name}_{k}") for k, (a, b, c, d) in enumerate(groups)]
    return add_up(m, sums, f"{name}_of")


class LaneSums(wiring.Component):
    """ΣI, ΣDx, ΣDy, Σ I·Dx and Σ I·Dy, and Σ I² where v's confidence is measured, in one pass.

    As :class:`~cmfpga.rtl.image.one_pass_gradient.OnePassGradient`, but a cycle's steps belong to different events, so
    that each bank has two products for each axis. A step that adds nothing makes them 0.

    Parameters
    ----------
    config : Config
        Of more than one lane.
    ahead : int
        Cycles from the first votes to their steps, at least.

    Members
    -------
    votes : ``In``, array of K arrays of four votes, as in :func:`payloads.votes`
        As they enter the queues.
    begin : ``In(1)``
        With an iteration's first votes.
    steps : ``In``, array of 4·K :func:`payloads.tagged_step`
        From the banks. The sums are final :attr:`latency` cycles after the last one.
    sums : ``Out``, :func:`payloads.sums`
    squares : ``Out``, :func:`payloads.squares`
        Only where v's confidence is measured.
    """

    def __init__(self, config, *, ahead):
        self.config, self._ahead = config, ahead
        lanes = config.lanes
        self.latency = 2 + stages(4 * lanes) + 1
        #: From the last votes until ΣI, ΣDx and ΣDy are final.
        self.plain_latency = 1 + stages(2 * lanes) + 1
        super().__init__(
            {
                "votes": In(data.ArrayLayout(payloads.votes(config)["banks"].shape, lanes)),
                "begin": In(1),
                "steps": In(data.ArrayLayout(payloads.tagged_step(config), 4 * lanes)),
                "sums": Out(payloads.sums(config)),
                **({"squares": Out(payloads.squares(config))} if config.confidence else {}),
            }
        )

    def elaborate(self, platform):
        m = Module()
        begin = delay(m, self.begin, self.plain_latency - 1, name="begin", valid=True)
        for name, pairs in (("i", ((0, 1), (2, 3))), ("dx", ((0, 1), (2, 3))), ("dy", ((0, 2), (1, 3)))):
            grown = [self._pair(m, lane, name, *pair) for lane in range(self.config.lanes) for pair in pairs]
            self._total(m, self.sums[name], add_up(m, grown, name), begin)
        begin = delay(m, self.begin, self._ahead + self.latency - 1, name="begin_products", valid=True)
        totals = {f"d{axis}": self.sums[f"s{axis}"] for axis in self.config.motion_model.names}
        if self.config.confidence:
            totals["i"] = self.squares
        for name, total in totals.items():
            grown = [self._growth(m, name, number) for number in range(4 * self.config.lanes)]
            self._total(m, total, add_up(m, grown, f"products_{name}"), begin)
        return m

    def _total(self, m, total, growth, begin):
        """Add ``growth`` to ``total``, or to zero; outside iterations there is no growth."""
        m.d.sync += total.eq(sum(growth) + Mux(begin, 0, total))

    def _pair(self, m, lane, name, a, b):
        """What two votes of an event add to a plain sum; of derivatives they are opposite."""
        first, second = self.votes[lane][a], self.votes[lane][b]
        if name == "i":
            value = Mux(first.valid, first.i, 0) + Mux(second.valid, second.i, 0)
        else:
            value = Mux(first.valid ^ second.valid, Mux(first.valid, first[name], second[name]), 0)
        return delay(m, value, 1, name=f"pair_{name}_{lane}_{a}")

    def _growth(self, m, name, number):
        """What a bank adds to Σ I·D, I·d + w·(D + d), or to Σ I², where D is I; two cycles."""
        step = self.steps[number]
        old = delay(m, step.i * step.add[name], 1, name=f"old_{name}_{number}")
        new = delay(m, step.total[name] * step.add.i, 1, name=f"new_{name}_{number}")
        return delay(m, old + new, 1, name=f"growth_{name}_{number}")
