"""Judge: whether the contrast's peak is sharp enough for v to be trusted, bit by bit."""

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for
from .. import payloads
from ..arithmetic import delay, select


class Judge(wiring.Component):
    """The comparison of :func:`cmfpga.protocol.confidence.is_trusted`, by shifting and adding: no multiplier.

    With G of the last iteration and of the two probes, it

    1. squares ΣI while the probes are summed, for A = P·Σ I² − (ΣI)²;
    2. subtracts, along x and then along y: the curvatures xx, yy, cross;
    3. shifts all four left until one fills its register, and keeps the highest bits;
    4. makes a = 8·n·xx − R·A, c = 8·n·yy − R·A and b = 8·n·cross, one after the other, a bit of 8·n and R a cycle;
    5. makes 4·a·c − b², a bit of a and b a cycle.

    ``done`` is high :attr:`latency` cycles after the gradient of the second probe, and ``doubtful`` right from then on.

    Parameters
    ----------
    config : Config

    Members
    -------
    new_batch : ``In(1)``
        Forget.
    iterating, probing, begin, away : ``In``
        As those of :class:`~.probe.Probe`.
    i : ``In``, flow of :func:`payloads.gradient`
    sum_i : ``In``
        ΣI of the last iteration.
    squares : ``In``, :func:`payloads.squares`
        Of the last iteration.
    events, limit : ``In``
        n, and the setting ``confidence_limit``: R.
    done, doubtful : ``Out(1)``
    """

    def __init__(self, config):
        self.config = config
        widths = config.widths
        by_n, by_limit = widths.judge_scales
        self._drop = widths.curvature_bits - widths.kept_bits  # steps of 3
        self._factor_bits = max(bits_for(by_n * config.buffer_events), widths.limit_bits + by_limit.bit_length() - 1)
        self.latency = 4 + self._drop + 3 * self._factor_bits + widths.judge_bits
        super().__init__(
            {
                **dict.fromkeys(("new_batch", "iterating", "begin"), In(1)),
                **dict.fromkeys(("probing", "away"), In(2)),
                "i": In(payloads.flow(payloads.gradient(config))),
                "sum_i": In(payloads.sums(config)["i"].shape),
                "squares": In(payloads.squares(config)),
                "events": In(bits_for(config.buffer_events)),
                "limit": In(widths.limit_bits),
                "done": Out(1),
                "doubtful": Out(1),
            }
        )

    def elaborate(self, platform):
        config, widths = self.config, self.config.widths
        m = Module()
        wide = {
            name: Signal(signed(widths.curvature_bits), name=name, reset_less=True)
            for name in ("xx", "yy", "cross", "contrast")
        }
        subtracted = self._curvature(m, wide)
        square = self._square(m)
        timer = Signal(range(max(self._drop, self._factor_bits, widths.judge_bits) + 1))
        m.d.sync += timer.eq(timer - 1)

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
        addend = Signal(signed(widths.kept_bits + 1), reset_less=True)
        m.d.sync += [addend.eq(Mux(factors[0][-1], curvature, 0) - limit), adding.eq(0), ends.eq(timer == 0)]
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
                with m.If(subtracted):
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
                    m.d.sync += timer.eq(self._factor_bits - 1)
                    m.next = "SCALE"
            with m.State("SCALE"):
                m.d.sync += [adding.eq(1), *(factor.eq(factor.rotate_left(1)) for factor in factors)]
                with m.If(timer == 0):
                    m.d.sync += [turn.eq(turn + 1), timer.eq(self._factor_bits - 1)]
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
        with m.If(self.new_batch):
            m.d.sync += self.doubtful.eq(0)
        return m

    def _curvature(self, m, wide):
        """Subtract gradients as they come; returns a pulse: all but ``contrast`` is there a cycle later."""
        g, last = self.i.payload, Signal.like(self.i.payload, reset_less=True)
        with m.If(self.i.valid & self.iterating):
            m.d.sync += last.eq(g)
        # G of the last iteration less that of the probe; the other way round where the probe has a smaller v. Along x
        # when it comes, along y a cycle later: it stays.
        came = [self.i.valid & self.probing[k] for k in range(2)]
        fell = [[delay(m, one, cycles, name=f"fell_{k}_{cycles}", valid=True) for cycles in (1, 2)]
                for k, one in enumerate(came)]  # fmt: skip
        y, turn = fell[0][0] | fell[1][0], (self.away & self.probing).any()
        bits = self.config.widths.g_bits
        before, now = (Mux(y, value.y, value.x) ^ turn.replicate(bits).as_signed() for value in (last, g))
        fall = delay(m, before - now, 1, name="fall")
        with m.If(fell[0][0]):
            m.d.sync += wide["xx"].eq(fall)
        with m.If(fell[1][1]):
            m.d.sync += wide["yy"].eq(fall)
        with m.If(fell[0][1]):
            m.d.sync += wide["cross"].eq(fall)
        with m.Elif(fell[1][0]):
            m.d.sync += wide["cross"].eq(wide["cross"] + fall)
        return fell[1][1]

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
