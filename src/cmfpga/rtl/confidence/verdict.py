"""Means of a round's evaluations, and the verdict: whether the contrast's peak is sharp enough for v to be trusted."""

from amaranth.hdl import Cat, Const, Module, Mux, Signal, signed
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for
from .. import Block, payloads
from ..arithmetic import PIECE, delay, select


class Means(Block):
    """ΣI, S and Σ I², added up over the four evaluations of a round, then divided by four, rounded down. ΣD is 0.

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
        sums, squares = payloads.sums(config), payloads.squares(config) if config.confidence else None
        super().__init__(
            config,
            new_batch=In(1),
            i=In(payloads.flow(sums)),
            done=Out(1),
            o=Out(sums),
            **({"squares": In(squares), "o_squares": Out(squares)} if config.confidence else {}),
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


#: What a product is added to: nothing, the sum so far, or that with all its bits moved up by a piece.
NOTHING, SUM, SHIFTED = range(3)


class Verdict(Block):
    """The comparison of :func:`cmfpga.protocol.confidence.is_trusted`, by one multiplier.

    It

    1. squares ΣI, for A = P·Σ I² − (ΣI)²;
    2. shifts A and the curvatures xx, yy, cross left, by four bits or by one a cycle, until one fills its register, and
       keeps the highest bits;
    3. makes a = 4·n·xx − R·A, c = 4·n·yy − R·A and b = 4·n·cross;
    4. makes 4·a·c − b², of halves of :data:`PIECE` bits and the rest.

    A shift too many, of small numbers, changes nothing: it makes all of them larger alike.

    ``done`` is high :attr:`latency` cycles after ``begin``, and ``doubtful`` right from the cycle after that on.

    Members
    -------
    begin : ``In(1)``
        The numbers are there, and stay until ``done``.
    sum_i : ``In``
        The mean of ΣI in the last round.
    squares : ``In``, :func:`payloads.squares`
        The same of Σ I².
    curvature : ``In``, :func:`payloads.curvature`
    events, limit : ``In``
        n, and the setting ``confidence_limit``: R.
    done, doubtful : ``Out(1)``
    """

    _first = 2

    def __init__(self, config):
        widths = config.widths
        super().__init__(
            config,
            begin=In(1),
            sum_i=In(payloads.sums(config)["i"].shape),
            squares=In(payloads.squares(config)),
            curvature=In(payloads.curvature(config)),
            events=In(bits_for(config.buffer_events)),
            limit=In(widths.limit_bits),
            done=Out(1),
            doubtful=Out(1),
        )
        drop = widths.curvature_bits - widths.kept_bits
        self._fours = drop // 4
        self._shifts = self._fours + min(drop, 3)
        # The cycles in which each part of the program begins. A product is added up five cycles after it is asked for.
        self._contrast = (1 if len(self.sum_i) <= PIECE else 4) + 4 + self._first
        self._scale = self._contrast + 1 + self._shifts
        self._compare = self._scale + 9
        self.latency = self._compare + 12

    def elaborate(self, platform):
        config, widths = self.config, self.config.widths
        m = Module()
        step = Signal(range(self.latency + 1))
        wide = {
            name: Signal(signed(widths.curvature_bits), name=name, reset_less=True)
            for name in ("xx", "yy", "cross", "contrast")
        }
        kept = {name: value[-widths.kept_bits :].as_signed() for name, value in wide.items()}
        a, b = (Signal(signed(widths.judge_bits), name=name, reset_less=True) for name in "ab")
        c = Signal(signed(widths.judge_bits + 2), reset_less=True)  # 4·c
        by_n, by_limit = (
            value * scale for value, scale in zip((self.events, self.limit), widths.judge_scales, strict=True)
        )
        program = {}  # by step: two factors, whether their product counts negative, and what it is added to
        for begin, lines in (
            (self._first, _square_of(self.sum_i)),
            (self._scale, [(kept["xx"], by_n, 0, NOTHING), (kept["contrast"], by_limit, 1, SUM)]),
            (self._scale + 2, [(kept["yy"], by_n, 0, NOTHING), (kept["contrast"], by_limit, 1, SUM)]),
            (self._scale + 4, [(kept["cross"], by_n, 0, NOTHING)]),
            (self._compare, _difference(a, c, b)),
        ):
            program |= {begin + k: line for k, line in enumerate(lines)}
        total = self._multiply(m, step, program)

        running = Signal()
        m.d.sync += [
            self.done.eq(step == self.latency - 1),
            running.eq(self.begin | (running & ~self.done)),
            step.eq(Mux(self.done, 0, step + running) | self.begin),
        ]
        # Pulses come from registers, for much hangs on them.
        curves, loads, keeps_a, keeps_c, keeps_b, ends = (
            self._at(m, step, name, when)
            for name, when in (
                ("curves", self._contrast - 2),
                ("loads", self._contrast),
                ("keeps_a", self._scale + 6),
                ("keeps_c", self._scale + 8),
                ("keeps_b", self._scale + 9),
                ("ends", self.latency),
            )
        )
        with m.If(curves):
            m.d.sync += [wide[name].eq(self.curvature[name]) for name in self.curvature.shape().members]
        with m.If(loads):
            m.d.sync += wide["contrast"].eq(self.squares * config.geometry.pixels - total)
        self._shift(m, step, wide)
        with m.If(keeps_a):
            m.d.sync += a.eq(total)
        with m.If(keeps_c):
            m.d.sync += c.eq(total << 2)
        with m.If(keeps_b):
            m.d.sync += b.eq(total)
        # Whether both are positive, in parts.
        some = Signal(-(-len(total) // 8), init=1)
        negative = Signal(2)
        a_some = delay(m, a.any(), 1, name="a_some")
        with m.If(ends):
            m.d.sync += [
                some.eq(Cat(total[low : low + 8].any() for low in range(0, len(total), 8))),
                negative.eq(Cat(total[-1], a[-1] | ~a_some)),
            ]
        m.d.comb += self.doubtful.eq(negative.any() | ~some.any())
        return m

    def _shift(self, m, step, wide):
        """2. Whether a curvature fills its register is known a cycle ahead."""
        first, contrast = self._contrast + 1, [wide["contrast"]]
        curvatures = [value for name, value in wide.items() if name != "contrast"]

        def full(values, by, moved=0):
            """Whether one cannot be shifted by ``by``, when all have been by ``moved``."""
            tops = (value[-1 - moved - by : len(value) - 1 - moved] ^ value[-1].replicate(by) for value in values)
            return Cat(top.any() for top in tops).any()

        fills, shifts = {by: Signal(name=f"fills_{by}") for by in (4, 1)}, {}
        for by, begin, count in ((4, first, self._fours), (1, first + self._fours, self._shifts - self._fours)):
            due = self._at(m, step, f"due_{by}", *range(begin, begin + count))
            shifts[by] = due & ~(fills[by] | full(contrast, by))
            with m.If(shifts[by]):
                m.d.sync += [value.eq(value << by) for value in wide.values()]
        for by, known in fills.items():
            m.d.sync += known.eq(full(curvatures, by))
            for moved, shift in shifts.items():
                if moved >= by:  # first all shifts by four
                    with m.If(shift):
                        m.d.sync += known.eq(full(curvatures, by, moved))

    def _at(self, m, step, name, *when):
        """High in these steps, which begin at 2 at the earliest."""
        pulse = Signal(name=name)
        m.d.sync += pulse.eq(Cat(step == each - 1 for each in when).any())
        return pulse

    def _multiply(self, m, step, program):
        """What the products of the program add up to: factors, product, its sign and sum have a register each."""
        factors = [[line[k] for line in program.values()] for k in range(2)]
        x, y = (
            Signal(signed(max(len(value) + (not value.shape().signed) for value in values)), name=name, reset_less=True)
            for name, values in zip("xy", factors, strict=True)
        )
        product = delay(m, x * y, 1, name="product")
        total = Signal(signed(2 * self.config.widths.judge_bits + 3), reset_less=True)
        minus, to = Signal(), Signal(range(3))
        base = select(to, [Const(0), total, total << PIECE])[: len(total)].as_signed()
        # What counts negative is inverted, and the adder's lowest bit carries: one adder for both.
        inverse = delay(m, product ^ minus.replicate(len(product)).as_signed(), 1, name="inverse")
        carry = delay(m, minus, 1, name="carry")
        m.d.sync += total.eq((Cat(Const(1, 1), base).as_signed() + Cat(carry, inverse).as_signed()) >> 1)
        # Which line comes next is known two cycles ahead, and which factors it has, one. They are chosen in two stages:
        # one of each four, and among these.
        line = Signal(range(len(program)))
        m.d.sync += line.eq(line + 1)
        with m.Switch(step):
            for number, k in enumerate(program):
                if k - 1 not in program:
                    with m.Case(k - 2):
                        m.d.sync += line.eq(number)
        for number, factor in enumerate((x, y)):
            values = list({id(one[number]): one[number] for one in program.values()}.values())
            places = {id(value): place for place, value in enumerate(values)}
            which = Signal(range(len(values)), name=f"which_{factor.name}")
            found = [Const(places[id(one[number])], len(which)) for one in program.values()]
            fours = [
                delay(m, select(which[:2], values[first : first + 4]), 1, name=f"four_{factor.name}_{first}")
                for first in range(0, len(values), 4)
            ]
            four = delay(m, which[2:], 1, name=f"four_{factor.name}")
            m.d.sync += [which.eq(select(line, found)), factor.eq(select(four, fours))]
        for later, target in ((2, minus), (3, to)):
            with m.Switch(step):
                for k, one in program.items():
                    with m.Case(k + later):
                        m.d.sync += target.eq(one[later])
        return total


def _halves(value):
    """A value's bits from :data:`PIECE` on, and those below."""
    high = value[PIECE:]
    return high.as_signed() if value.shape().signed else high, value[:PIECE]


def _square_of(value):
    """Lines of the program that square a value which is not negative."""
    if len(value) <= PIECE:
        return [(value, value, 0, NOTHING)]
    high, low = _halves(value)
    return [(high, high, 0, NOTHING), (high, low, 0, SHIFTED), (high, low, 0, SUM), (low, low, 0, SHIFTED)]


def _difference(a, c, b):
    """Lines of a·c − b²."""
    (a_high, a_low), (c_high, c_low), (b_high, b_low) = map(_halves, (a, c, b))
    return [
        (a_high, c_high, 0, NOTHING),
        (b_high, b_high, 1, SUM),
        (a_high, c_low, 0, SHIFTED),
        (a_low, c_high, 0, SUM),
        (b_high, b_low, 1, SUM),
        (b_high, b_low, 1, SUM),
        (a_low, c_low, 0, SHIFTED),
        (b_low, b_low, 1, SUM),
    ]
