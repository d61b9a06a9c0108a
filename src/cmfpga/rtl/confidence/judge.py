"""Judge: whether the contrast's peak is sharp enough for v to be trusted, bit by bit."""

from amaranth.hdl import Cat, Module, Mux, Signal, signed
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ...fixed import bits_for
from .. import payloads


class Judge(wiring.Component):
    """The comparison of :func:`cmfpga.protocol.confidence.is_trusted`, by shifting and adding: no multiplier.

    With G of the last iteration and of the two probes, it

    1. squares ΣI while the probes are summed, for A = P·Σ I² − (ΣI)²;
    2. subtracts: the curvatures xx, yy, cross (two cycles);
    3. shifts all four left until one fills its register, and keeps the highest bits;
    4. makes a = 8·n·xx − R·A, c = 8·n·yy − R·A and b = 8·n·cross, a bit of 8·n and R a cycle;
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
        self.latency = 2 + self._drop + self._factor_bits + widths.judge_bits
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
        # 4
        factors = [Signal(self._factor_bits, name=f"factor_{name}") for name in ("n", "limit")]
        bits = [factor.bit_select(timer, 1) for factor in factors]
        m.d.comb += [
            factor.eq(value * scale)
            for factor, value, scale in zip(factors, (self.events, self.limit), widths.judge_scales, strict=True)
        ]
        sides = {name: Signal(signed(widths.judge_bits), name=name, reset_less=True) for name in ("a", "c", "b")}
        limit = Mux(bits[1], kept["contrast"], 0)
        terms = {
            "a": Mux(bits[0], kept["xx"], 0) - limit,
            "c": Mux(bits[0], kept["yy"], 0) - limit,
            "b": Mux(bits[0], kept["cross"], 0),
        }
        # 5
        difference = Signal(signed(2 * widths.judge_bits + 3), reset_less=True)
        a, c, b = sides.values()
        growth = Mux(a.bit_select(timer, 1), c << 2, 0) - Mux(b.bit_select(timer, 1), b, 0)

        with m.FSM(name="judge"):
            with m.State("COLLECT"):
                with m.If(subtracted):
                    m.d.sync += wide["contrast"].eq(self.squares * config.geometry.pixels - square)
                    m.d.sync += timer.eq(self._drop - 1)
                    m.next = "SHIFT"
            with m.State("SHIFT"):
                with m.If(~full):
                    m.d.sync += [value.eq(value << 1) for value in wide.values()]
                m.d.sync += [value.eq(0) for value in sides.values()]
                with m.If(timer == 0):
                    m.d.sync += timer.eq(self._factor_bits - 1)
                    m.next = "SCALE"
            with m.State("SCALE"):
                m.d.sync += [sides[name].eq((sides[name] << 1) + terms[name]) for name in sides]
                with m.If(timer == 0):
                    m.d.sync += timer.eq(widths.judge_bits - 1)
                    m.next = "COMPARE"
            with m.State("COMPARE"):
                # The sign's bit of b counts negative, and that of a is 0 where it matters.
                with m.If(timer == widths.judge_bits - 1):
                    m.d.sync += difference.eq(Mux(b[-1], b, 0))
                with m.Else():
                    m.d.sync += difference.eq((difference << 1) + growth)
                with m.If(timer == 0):
                    m.next = "DONE"
            with m.State("DONE"):
                m.d.comb += self.done.eq(1)
                m.d.sync += self.doubtful.eq((a <= 0) | (difference <= 0))
                m.next = "COLLECT"
        with m.If(self.new_batch):
            m.d.sync += self.doubtful.eq(0)
        return m

    def _curvature(self, m, wide):
        """Subtract gradients as they come; returns a pulse: all but ``contrast`` is there a cycle later."""
        g = self.i.payload
        last = Signal.like(g, reset_less=True)
        mixed = Signal.like(wide["cross"], name="mixed", reset_less=True)

        def fall(axis, probe):
            """G of the last iteration less that of the probe; the other way round where the probe has a smaller v."""
            turn = self.away[probe].replicate(len(mixed)).as_signed()
            return (last[axis] ^ turn) + (g[axis] ^ ~turn) + 1

        with m.If(self.i.valid & self.iterating):
            m.d.sync += last.eq(g)
        with m.If(self.i.valid & self.probing[0]):
            m.d.sync += [wide["xx"].eq(fall("x", 0)), mixed.eq(fall("y", 0))]
        subtracted = Signal()
        m.d.sync += subtracted.eq(self.i.valid & self.probing[1])
        with m.If(self.i.valid & self.probing[1]):
            m.d.sync += [wide["yy"].eq(fall("y", 1)), wide["cross"].eq(fall("x", 1))]
        with m.If(subtracted):
            m.d.sync += wide["cross"].eq(wide["cross"] + mixed)
        return subtracted

    def _square(self, m):
        """(ΣI)²: as many cycles as ΣI has bits, which the probes take anyway."""
        bits = len(self.sum_i)
        square = Signal(2 * bits, reset_less=True)
        left = Signal(range(bits + 1))
        with m.If(self.begin):
            m.d.sync += [left.eq(bits), square.eq(0)]
        with m.Elif(left != 0):
            m.d.sync += left.eq(left - 1)
            m.d.sync += square.eq((square << 1) + Mux(self.sum_i.bit_select((left - 1)[: len(left)], 1), self.sum_i, 0))
        return square
