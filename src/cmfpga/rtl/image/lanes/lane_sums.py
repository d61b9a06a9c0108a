"""Lane sums: what the votes of all lanes and the steps of all banks add to the sums."""

from amaranth.hdl import Module, Mux
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from ... import payloads
from ...arithmetic import delay


def stages(count):
    """Cycles in which :func:`add_up` adds ``count`` numbers, a power of two."""
    return count.bit_length() - 1


def add_up(m, values, name):
    """The sum of ``values``, :func:`stages` cycles later: two at a time, the fewest LUTs and the shortest paths."""
    if len(values) == 1:
        return values[0]
    pairs = zip(values[::2], values[1::2], strict=True)
    return add_up(m, [delay(m, a + b, 1, name=f"{name}_{k}") for k, (a, b) in enumerate(pairs)], f"{name}_of")


def add_products(m, factors, name):
    """Σ a·b of the pairs ``factors``, two cycles more later: one behind the other, as DSPs add without a LUT.

    Or Σ (a + c)·b of triples (a, c, b), another two cycles later: a DSP has that adder as well. All registers around a
    multiplier have the same reset, so that tools find them in it; factors wait for two cycles or more, of which they
    may move one to the product, for its wire, and terms for three, of which they may move another to the sum.
    """
    total = 0
    for number, each in enumerate(factors):
        waits = max(2, number + 1) + len(each) - 2
        *terms, b = (delay(m, part, waits, name=f"{name}_{number}_{k}", valid=True) for k, part in enumerate(each))
        if len(terms) == 2:
            terms = [delay(m, terms[0] + terms[1], 1, name=f"{name}_sum_{number}", valid=True)]
            b = delay(m, b, 1, name=f"{name}_factor_{number}", valid=True)
        product = delay(m, terms[0] * b, 1, name=f"{name}_product_{number}", valid=True)
        total = delay(m, total + product, 1, name=f"{name}_{number}") if number else product
    return total


#: Banks whose products for one axis a chain of DSPs adds.
CHAINED = 2


class LaneSums(wiring.Component):
    """ΣI, ΣDx, ΣDy, Σ I·Dx and Σ I·Dy, and Σ I² where v's confidence is measured, in one pass.

    As :class:`~cmfpga.rtl.image.one_pass_gradient.OnePassGradient`, but a cycle's steps belong to different events, so
    that each bank has two products for each axis. A step that adds nothing makes them 0. With ``border = whole``, ΣDx
    and ΣDy are 0: the four votes of an event are opposite, or all of them change no derivative.

    Parameters
    ----------
    config : Config
        Of more than one lane.
    ahead : int
        Cycles from the first votes to their steps, at least.

    Members
    -------
    votes : ``In``, array of K arrays of four votes, as in :func:`payloads.votes`
    room : ``In``, array of K
        Those of a lane enter the queues.
    begin : ``In(1)``
        With an iteration's first votes.
    steps : ``In``, array of 4·K :func:`payloads.tagged_step`
        From the banks. The sums are final :attr:`latency` cycles after the last one.
    sums : ``Out``, :func:`payloads.sums`
    squares : ``Out``, :func:`payloads.squares`
        Final :attr:`squares_late` cycles after ``sums``. Only where v's confidence is measured.
    """

    squares_late = 1

    def __init__(self, config, *, ahead):
        self.config, self._ahead = config, ahead
        lanes = config.lanes
        self.latency = 2 + 2 * CHAINED + stages(4 * lanes // CHAINED) + 1
        #: From the last votes until ΣI, ΣDx and ΣDy are final.
        self.plain_latency = 1 + stages(2 * lanes) + 1
        super().__init__(
            {
                "votes": In(data.ArrayLayout(payloads.votes(config)["banks"].shape, lanes)),
                "room": In(1).array(lanes),
                "begin": In(1),
                "steps": In(data.ArrayLayout(payloads.tagged_step(config), 4 * lanes)),
                "sums": Out(payloads.sums(config)),
                **({"squares": Out(payloads.squares(config))} if config.confidence else {}),
            }
        )

    def elaborate(self, platform):
        m = Module()
        begin = delay(m, self.begin, self.plain_latency - 1, name="begin", valid=True)
        rows, columns = ((0, 1), (2, 3)), ((0, 2), (1, 3))
        plain = {"i": rows} | ({"dx": rows, "dy": columns} if self.config.border != "whole" else {})
        for name, pairs in plain.items():
            grown = [self._pair(m, lane, name, *pair) for lane in range(self.config.lanes) for pair in pairs]
            self._total(m, self.sums[name], add_up(m, grown, name), begin)
        begin = delay(m, self.begin, self._ahead + self.latency - 1, name="begin_products", valid=True)
        totals = {f"d{axis}": self.sums[f"s{axis}"] for axis in self.config.motion_model.names}
        for name, total in totals.items():
            products = [pair for step in self.steps for pair in self._products(step, name)]
            self._total_of_products(m, total, products, name, begin)
        if self.config.confidence:
            # w·(I + (I + w)): with a product each there are half as many chains.
            squares = [(step.i, step.total.i, step.add.i) for step in self.steps]
            begin = delay(m, begin, self.squares_late, name="begin_squares", valid=True)
            self._total_of_products(m, self.squares, squares, "i", begin)
        return m

    def _total_of_products(self, m, total, products, name, begin):
        chains = zip(*[iter(products)] * 2 * CHAINED, strict=True)
        grown = [add_products(m, chain, f"{name}_{number}") for number, chain in enumerate(chains)]
        self._total(m, total, add_up(m, grown, f"products_{name}"), begin)

    def _total(self, m, total, growth, begin):
        """Add ``growth`` to ``total``, or to zero; outside iterations there is no growth."""
        m.d.sync += total.eq(growth + Mux(begin, 0, total))

    def _pair(self, m, lane, name, a, b):
        """What two votes of an event add to a plain sum; of derivatives they are opposite."""
        first, second = self.votes[lane][a], self.votes[lane][b]
        if name == "i":
            value = Mux(first.valid, first.i, 0) + Mux(second.valid, second.i, 0)
        else:
            value = Mux(first.valid ^ second.valid, Mux(first.valid, first[name], second[name]), 0)
        return delay(m, Mux(self.room[lane], value, 0), 1, name=f"pair_{name}_{lane}_{a}")

    @staticmethod
    def _products(step, name):
        """What a bank adds to Σ I·D: I·d + w·(D + d)."""
        return (step.i, step.add[name]), (step.total[name], step.add.i)
