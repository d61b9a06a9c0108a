"""One-pass gradient: the sums over the images, kept up to date vote by vote."""

from functools import reduce
from operator import or_

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import data
from amaranth.lib.wiring import In, Out

from .. import Block, payloads
from ..arithmetic import PIECE, delay
from .moments import Moments


class OnePassGradient(Block):
    """ΣI, ΣDx, ΣDy, Σ I·Dx and Σ I·Dy, complete when the last vote has landed: no sweep.

    When a pixel goes from (I, D) to (I + w, D + d), Σ I·D grows by I·d + w·(D + d); the accumulator has all of these in
    hand. In integers that is the sweep's sum, bit for bit.

    The two corners of a cell's row have opposite ∂w/∂vx, those of a column opposite ∂w/∂vy. So the four I·d of an axis
    are two products, each of a difference of two I; with the four w·(D + d) that makes twelve products a cycle, narrow
    ones: a full pixel by a vote. The differences and the sums of two products fit the adders inside the DSPs.

    Where four evaluations of an event come one after the other, each has its own sums, which go round through the same
    adder: a sum comes back in the cycle of its evaluation. So all four items leave it one after the other, too.

    In a motion beyond translation an event's increments go on to the :class:`~.moments.Moments`, two cycles more.

    One event per cycle; the sums are valid :attr:`latency` cycles after the last votes enter the accumulator, and ΣI,
    ΣDx and ΣDy final :attr:`lead` cycles earlier at the latest.

    Members
    -------
    votes : ``In``, flow of :func:`payloads.votes`
        As they enter the accumulator. Valid ones are opposite: banks 0 and 1, 2 and 3 in dx, 0 and 2, 1 and 3 in dy.
    steps : ``In``, array of four :func:`payloads.tagged_step`
        From the accumulator, ``accumulator_latency`` cycles later. A step that is not valid has ``add.i`` = 0; beside a
        valid one it has ``i`` = 0, and the derivatives that it did not add are opposite, too.
    o : ``Out``, flow of :func:`payloads.sums`
        One item per evaluation.
    squares : ``Out``, :func:`payloads.squares`
        Σ I², with ``o``. Only where v's confidence is measured.
    """

    def __init__(self, config, *, accumulator_latency):
        self.accumulator_latency = accumulator_latency
        self._turns = 1 << config.geometry.turn_bits
        # In rounds what is multiplied waits for a cycle, in the multipliers' own registers. Among four images, whose
        # wires are long, what the pairs add is added up in a cycle of its own, too.
        self._waits = int(config.ascent_rule.evaluations > 1)
        self._adds = int(config.evaluators > 1)
        self._stages = self._waits + self._adds + 4  # multiply, add pairs, add both kinds of products, total
        self.moments = Moments(config) if config.motion_model.basis else None
        self.latency = accumulator_latency + self._stages + (Moments.latency - 1 if self.moments else 0)
        #: Cycles by which the plain sums, which take two, are final before the sums of products.
        self.lead = self.latency - 2
        super().__init__(
            config,
            votes=In(payloads.flow(payloads.votes(config))),
            steps=In(data.ArrayLayout(payloads.tagged_step(config), 4)),
            o=Out(payloads.flow(payloads.sums(config))),
            **({"squares": Out(payloads.squares(config))} if config.confidence else {}),
        )

    def elaborate(self, platform):
        m = Module()
        votes, sums = self.votes.payload, self.o.payload
        first = Signal(init=1)
        over = self.votes.valid
        if self._turns > 1:
            turn = Signal(range(self._turns))
            m.d.sync += turn.eq(turn + self.votes.valid)
            over &= turn == self._turns - 1
        with m.If(over):
            m.d.sync += first.eq(votes.last)
        begin = delay(m, self.votes.valid & first, 1, name="begin", valid=True)
        self._sum_votes(m, begin)
        begin = delay(m, begin, self.accumulator_latency + self._stages - 2, name="begin_products", valid=True)
        grown, far = {}, {}
        for axis, pairs in (("x", ((0, 1), (2, 3))), ("y", ((0, 2), (1, 3)))):
            growth = [self._growth(m, axis, *pair) for pair in pairs]
            grown[axis] = delay(m, growth[0] + growth[1], self._adds, name=f"grown_{axis}")
            if self.config.motion_model.of_pixels:
                far[axis] = self._far(m, axis, pairs, growth)
            if not self.moments:
                # Stage 4: sum.
                self._total(m, sums[f"s{axis}"], grown[axis], begin, f"s{axis}")
        if self.moments:
            m.submodules.moments = moments = self.moments
            until = self.accumulator_latency + self._stages - 1
            # 0 where no vote is valid: what is not known, times no growth, is not known in a simulator.
            basis = votes.cell if far else votes.basis
            known = Signal.like(basis)
            m.d.comb += known.eq(basis.as_value() & self.votes.valid.replicate(len(basis.as_value())))
            found = delay(m, known, until, name="basis")
            m.d.comb += [
                *(getattr(moments, f"growth_{axis}").eq(value) for axis, value in grown.items()),
                *(moments.basis[name].eq(found[name]) for name in self.config.motion_model.basis),
                *(moments.far[axis][name].eq(value) for axis, each in far.items() for name, value in each.items()),
                *([moments.level.eq(found.level)] if far else []),
                moments.begin.eq(begin),
                *(sums[f"s{name}"].eq(moments.o[name]) for name in self.config.motion_model.names),
            ]
        if self.config.confidence:
            growth = [self._growth_of_squares(m, *pair) for pair in ((0, 1), (2, 3))]
            grown = delay(m, growth[0] + growth[1], self._adds, name="grown_squares")
            self._total(m, self.squares, grown, begin, "squares")
        last = delay(m, self.votes.valid & votes.last, self.latency - self._turns + 1, name="last", valid=True)
        turns = [last]  # each evaluation's, as long as there are others
        for turn in range(1, self._turns):
            turns.append(delay(m, turns[-1], 1, name=f"last_{turn}", valid=True))
        m.d.comb += self.o.valid.eq(reduce(or_, turns))
        return m

    def _total(self, m, total, growth, begin, name):
        """Add ``growth`` to ``total``, or to zero; outside iterations there is no growth.

        With several evaluations in turn, to what it was a turn ago.
        """
        before = delay(m, total, self._turns - 1, name=f"total_{name}")
        m.d.sync += total.eq(growth + Mux(begin, 0, before))

    def _sum_votes(self, m, begin):
        """ΣI, ΣDx and ΣDy: two pairs, then both onto the total."""
        banks = self.votes.payload.banks
        valid = [self.votes.valid & bank.valid for bank in banks]
        plain = {"i": ((0, 1), (2, 3)), "dx": ((0, 1), (2, 3)), "dy": ((0, 2), (1, 3))}
        if self.config.ascent_rule.evaluations > 1:  # whose border is whole: ΣD = 0
            plain = {"i": plain["i"]}
        for name, pairs in plain.items():
            growth = []
            for a, b in pairs:
                first, second = banks[a][name], banks[b][name]
                if name == "i":
                    value = Mux(valid[a], first, 0) + Mux(valid[b], second, 0)
                else:  # the two are opposite
                    value = Mux(valid[a] ^ valid[b], Mux(valid[a], first, second), 0)
                growth.append(delay(m, value, 1, name=f"pair_{name}_{a}"))
            total = self.o.payload[name]
            if self._turns > 1:  # the others wait for the sums of products, and go round meanwhile
                total = Signal(total.shape(), name=f"total_{name}", reset_less=True)
                waits = (self.latency - 2) % self._turns
                m.d.comb += self.o.payload[name].eq(delay(m, total, waits, name=f"waiting_{name}"))
            self._total(m, total, growth[0] + growth[1], begin, name)

    def _growth_of_squares(self, m, a, b):
        """What two banks add to Σ I²: w·(2·I + w) each; three cycles, or four.

        Where that factor is too wide for a multiplier, 2·w·(I + ⌊w/2⌋), and w where it is odd.
        """
        halves = len(self.steps[a].i) > PIECE  # a multiplier of 18 bits takes as many without a sign
        products, odd = [], []
        for n in (a, b):
            step = self.steps[n]
            i, w = step.i, step.add.i
            both = (i + (w >> 1))[: len(i)] if halves else (2 * i + w)[: len(i) + 1]  # I before and after
            waits = 1 + self._waits
            w_s1 = delay(m, w, waits, name=f"w_{n}")
            products.append(delay(m, delay(m, both, waits, name=f"both_{n}") * w_s1, 1, name=f"square_{n}"))
            odd.append(Mux(w_s1[0], w_s1, 0))
        growth = products[0] + products[1]
        if halves:
            growth = (growth << 1) + delay(m, odd[0] + odd[1], 1, name=f"odd_{a}")
        return delay(m, growth, 1, name=f"squares_{a}")

    def _far(self, m, axis, pairs, growth):
        """What the right (``p``) and the lower (``q``) pixels of a cell add to Σ I·D along ``axis``; three cycles."""
        cell, own, other = self.votes.payload.cell, *(("p", "q") if axis == "x" else ("q", "p"))
        odd = {
            name: delay(m, cell[f"odd_{line}"], self.accumulator_latency, name=f"odd_{line}_{axis}")
            for name, line in (("p", "column"), ("q", "row"))
        }
        # Pairs lie across the other line: of an odd cell the far one is the even one.
        odd_s3 = delay(m, odd[other], 3, name=f"odd_{axis}")
        beyond = []
        for a, b in pairs:  # the far one of each
            first, second = self.steps[a], self.steps[b]
            number = f"{axis}_{a}"
            i_s1 = delay(m, Mux(odd[own], first.i, second.i), 1, name=f"far_i_{number}")
            valid = first.valid | second.valid
            d_s1 = delay(m, Mux(valid, first.add[f"d{axis}"], 0), 1, name=f"far_d_{number}")
            products_s1 = [
                delay(m, step.total[f"d{axis}"] * step.add.i, 1, name=f"far_{number}_{n}")
                for n, step in enumerate((first, second))
            ]
            odd_s1 = delay(m, odd[own], 1, name=f"far_odd_{number}")
            old_s2 = delay(m, i_s1 * Mux(odd_s1, d_s1, -d_s1), 1, name=f"far_old_{number}")
            new_s2 = delay(m, Mux(odd_s1, *products_s1), 1, name=f"far_new_{number}")
            beyond.append(delay(m, old_s2 + new_s2, 1, name=f"far_growth_{number}"))
        return {own: beyond[0] + beyond[1], other: Mux(odd_s3, growth[0], growth[1])}

    def _growth(self, m, axis, a, b):
        """What two banks, whose derivatives along ``axis`` are opposite, add to Σ I·D; three cycles, or four."""
        first, second, waits = self.steps[a], self.steps[b], self._waits

        # Stage 1: w·(D + d), and the difference of I.
        products_s1 = [
            delay(
                m,
                delay(m, step.total[f"d{axis}"], waits, name=f"total_{axis}_{n}")
                * delay(m, step.add.i, waits, name=f"added_{axis}_{n}"),
                1,
                name=f"product_{axis}_{n}",
            )
            for n, step in ((a, first), (b, second))
        ]
        # I waits before the subtraction, which is then the multiplier's own.
        before, beside = (delay(m, step.i, waits, name=f"i_{axis}_{n}") for n, step in ((a, first), (b, second)))
        difference_s1 = delay(m, before - beside, 1, name=f"difference_{axis}_{a}")
        d_s1 = delay(m, Mux(first.valid | second.valid, first.add[f"d{axis}"], 0), 1 + waits, name=f"d_{axis}_{a}")
        # Stage 2: their sum, and I·d of both.
        sum_s2 = delay(m, products_s1[0] + products_s1[1], 1, name=f"sum_{axis}_{a}")
        product_s2 = delay(m, difference_s1 * d_s1, 1, name=f"old_{axis}_{a}")
        # Stage 3: all four products.
        return delay(m, product_s2 + sum_s2, 1, name=f"growth_{axis}_{a}")
