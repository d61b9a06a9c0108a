"""Judge: whether the contrast's peak is sharp enough for v to be trusted, as the probes come."""

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for
from .. import payloads
from ..arithmetic import select
from .curvature import subtract


class Deciding(wiring.Component):
    """What a :class:`Judge` is without its curvatures: the comparison.

    It

    1. squares ΣI, for A = P·Σ I² − (ΣI)²;
    2. waits for the curvatures xx, yy, cross;
    3. shifts all four left until one fills its register, and keeps the highest bits;
    4. makes a = 4·n·xx − R·A, c = 4·n·yy − R·A and b = 4·n·cross, one after the other, a bit of 4·n and R a cycle;
    5. makes 4·a·c − b², a bit of a and b a cycle.

    Steps 3 to 5 take ``_steps`` cycles.
    """

    def __init__(self, config, members):
        self.config = config
        widths = config.widths
        by_n, by_limit = widths.judge_scales
        self._drop = widths.curvature_bits - widths.kept_bits  # steps of 3
        self._factor_bits = max(bits_for(by_n * config.buffer_events), widths.limit_bits + by_limit.bit_length() - 1)
        self._steps = 3 + self._drop + 3 * self._factor_bits + widths.judge_bits
        super().__init__(
            {
                "begin": In(1),
                "sum_i": In(payloads.sums(config)["i"].shape),
                "squares": In(payloads.squares(config)),
                "events": In(bits_for(config.buffer_events)),
                "limit": In(widths.limit_bits),
                "done": Out(1),
                "doubtful": Out(1),
                **members,
            }
        )

    def _decide(self, m, known):
        """Steps 1 and 3 to 5; ``known`` is a pulse: the curvatures are there."""
        config, widths = self.config, self.config.widths
        wide = {
            name: Signal(signed(widths.curvature_bits), name=name, reset_less=True)
            for name in ("xx", "yy", "cross", "contrast")
        }
        square = self._square(m)
        timer = Signal(range(max(self._drop, self._factor_bits, widths.judge_bits) + 1))
        m.d.sync += timer.eq(Mux(timer == 0, self._factor_bits - 1, timer - 1))

        # 3: two's complement, so the highest bits of a register are its value, rounded down.
        full = Cat(*(value[-1] ^ value[-2] for value in wide.values())).any()
        kept = {name: value[-widths.kept_bits :].as_signed() for name, value in wide.items()}
        # 4, in two stages, so that three numbers are never added at once.
        factors = [Signal(self._factor_bits, name=f"factor_{name}") for name in ("n", "limit")]
        a, c, b = (Signal(signed(widths.judge_bits), name=name, reset_less=True) for name in "acb")
        side = Signal.like(b, name="side")
        turn, adding, ends = Signal(2), Signal(), Signal()
        curvature = select(turn, [kept[name] for name in ("xx", "yy", "cross")])
        limit = Mux(factors[1][-1] & (turn != 2), kept["contrast"], 0)
        counted = Mux(factors[0][-1], curvature, 0)
        addend = Signal(signed(widths.kept_bits + 1), reset_less=True)
        m.d.sync += [addend.eq(counted - limit), adding.eq(0), ends.eq(timer == 0)]
        scaled = Signal.like(b, name="scaled")
        m.d.comb += scaled.eq((side << 1) + addend)
        with m.If(adding):
            m.d.sync += side.eq(scaled)
            with m.If(ends):
                m.d.sync += [a.eq(c), c.eq(b), b.eq(scaled), side.eq(Mux(turn == 3, scaled, 0))]
        # 5, as well: the bits of a, and of b in ``side``, move up.
        difference = Signal(signed(2 * widths.judge_bits + 3), reset_less=True)
        growth = Signal(signed(widths.judge_bits + 3), reset_less=True)
        first, none = Signal(), Signal()

        with m.FSM(name="judge"):
            with m.State("COLLECT"):
                with m.If(known):
                    m.d.sync += [wide[name].eq(self.curvature[name]) for name in self.curvature.shape().members]
                    m.d.sync += wide["contrast"].eq(self.squares * config.geometry.pixels - square)
                    m.d.sync += timer.eq(self._drop - 1)
                    m.next = "SHIFT"
            with m.State("SHIFT"):
                with m.If(~full):
                    m.d.sync += [value.eq(value << 1) for value in wide.values()]
                m.d.sync += [side.eq(0), turn.eq(0)]
                for factor, value, scale in zip(factors, (self.events, self.limit), widths.judge_scales, strict=True):
                    m.d.sync += factor.eq(value * scale)
                with m.If(timer == 0):
                    m.next = "SCALE"
            with m.State("SCALE"):
                m.d.sync += [adding.eq(1), *(factor.eq(factor.rotate_left(1)) for factor in factors)]
                with m.If(timer == 0):
                    m.d.sync += turn.eq(turn + 1)
                    with m.If(turn == 2):
                        m.next = "SCALED"
            with m.State("SCALED"):
                m.d.sync += [timer.eq(widths.judge_bits - 1), first.eq(1)]
                m.next = "COMPARE"
            with m.State("COMPARE"):
                m.d.sync += [first.eq(0), a.eq(a << 1), side.eq(side << 1)]
                m.d.sync += growth.eq(Mux(a[-2], c << 2, 0) - Mux(side[-2], b, 0))
                # The sign's bit of b counts negative, and that of a is 0 where it matters.
                with m.If(first):
                    m.d.sync += [difference.eq(Mux(side[-1], b, 0)), none.eq(a <= 0)]
                with m.Else():
                    m.d.sync += difference.eq((difference << 1) + growth)
                with m.If(timer == 0):
                    m.next = "DONE"
            with m.State("DONE"):
                m.d.comb += self.done.eq(1)
                m.d.sync += self.doubtful.eq(none | (difference <= 0))
                m.next = "COLLECT"

    def _square(self, m):
        """(ΣI)²: as many cycles as ΣI has bits, which the probes take anyway."""
        bits = Signal.like(self.sum_i, name="bits", reset_less=True)
        square, left = Signal(2 * len(bits), reset_less=True), Signal(range(len(bits) + 1))
        with m.If(self.begin):
            m.d.sync += [bits.eq(self.sum_i), left.eq(len(bits)), square.eq(0)]
        with m.Elif(left != 0):
            m.d.sync += [bits.eq(bits << 1), left.eq(left - 1)]
            m.d.sync += square.eq((square << 1) + Mux(bits[-1], self.sum_i, 0))
        return square


class Judge(Deciding):
    """The comparison of :func:`cmfpga.protocol.confidence.is_trusted`, by shifting and adding: no multiplier.

    ΣI is squared while the probes are summed (:class:`Deciding`), and their gradients are added and
    subtracted as they come (:class:`~.curvature.Curvature`).

    ``done`` is high :attr:`latency` cycles after the gradient of the last probe, and ``doubtful`` right from then on.

    Parameters
    ----------
    config : Config

    Members
    -------
    new_batch : ``In(1)``
        Forget.
    begin : ``In(1)``
        As that of :class:`~.probe.Probe`.
    i : ``In``, flow of :func:`payloads.gradient`
        Of the four probes, in their order.
    sum_i : ``In``
        ΣI of the last iteration.
    squares : ``In``, :func:`payloads.squares`
        Of the last iteration.
    events, limit : ``In``
        n, and the setting ``confidence_limit``: R.
    curvature : ``Out``, :func:`payloads.curvature`
        Right from ``done`` on; 0 if nothing was probed since ``new_batch``.
    done, doubtful : ``Out(1)``
    """

    def __init__(self, config):
        super().__init__(
            config,
            {
                "new_batch": In(1),
                "i": In(payloads.flow(payloads.gradient(config))),
                "curvature": Out(payloads.curvature(config)),
            },
        )
        self.latency = self._steps

    def elaborate(self, platform):
        m = Module()
        self._decide(m, subtract(m, self, self.config.widths.g_zeros))
        with m.If(self.new_batch):
            m.d.sync += self.doubtful.eq(0)
        return m


class SerialVerdict(Deciding):
    """The comparison of :func:`cmfpga.protocol.confidence.is_trusted` by itself, of curvatures that are there already.

    ``done`` is high :attr:`latency` cycles after ``begin``, and ``doubtful`` right from the cycle after that on.

    Parameters and members are those of :class:`~.verdict.Verdict`.
    """

    def __init__(self, config):
        super().__init__(config, {"curvature": In(payloads.curvature(config))})
        self._squaring = len(self.sum_i) + 1
        self.latency = self._squaring + self._steps - 1

    def elaborate(self, platform):
        m = Module()
        timer = Signal(range(self._squaring + 1))
        with m.If(self.begin):
            m.d.sync += timer.eq(self._squaring)
        with m.Elif(timer != 0):
            m.d.sync += timer.eq(timer - 1)
        self._decide(m, timer == 1)
        return m
