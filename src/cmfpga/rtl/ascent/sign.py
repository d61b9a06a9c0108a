"""The fast ascent: a step of the schedule up the gradient, by its sign alone."""

from amaranth.hdl import Cat, Const, Mux, Signal
from amaranth.lib.wiring import Out

from .. import payloads
from ..arithmetic import delay, register
from .schedule import ScheduledAscent


class SignAscent(ScheduledAscent):
    """v ← v + 2^shift · sign(G), each parameter by itself; v saturates. No multiplier, no normalisation.

    Half of that step, rounded down, where |G| is less than half of the steepest parameter's: steps of one size go to
    and fro across a ridge, on which parameters balance each other.

    The schedule says level, shift and stride of each iteration. A gradient every three cycles. See
    :class:`~.ascent.Ascent` and :class:`~.schedule.ScheduledAscent` for the other members and attributes.

    Members
    -------
    stride : ``Out``
        The next replay uses one event in 2^stride; from the fourth cycle after ``run.take``, the third after
        ``run.updated`` on.
    """

    latency = 2

    def __init__(self, config):
        super().__init__(config, target_bits=None, members={"stride": Out(payloads.STRIDE_BITS)})

    def elaborate(self, platform):
        m = self.scheduled()
        m.d.comb += [
            self.stride.eq(self.schedule.stride),
            self.velocity.move.eq(delay(m, self.i.valid, 1, name="valid", valid=True)),
        ]
        lesser, parameters = self._lesser(m), self.config.motion_model.parameters
        clipped = [self._target(m, one.name, one.fmt, lesser[one.name]) for one in parameters]
        m.d.comb += self.velocity.clipped.eq(Cat(*clipped).any())
        return m

    def _lesser(self, m):
        """Which parameters' slopes are less than half of the steepest one's, a cycle after the gradient: by name."""
        names, sizes = self.config.motion_model.names, {}
        for name in names:
            whole = self.i.payload[name][self.config.widths.s_frac :]
            sizes[name] = whole[:-1] ^ whole[-1].replicate(len(whole) - 1)
        lesser = {}
        for name in names:
            lesser[name], double = Signal(name=f"lesser_{name}", reset_less=True), Cat(Const(0, 1), sizes[name])
            # The sign of a difference: a carry chain, where Yosys makes LUTs in a row of a comparison.
            others = Cat((double - sizes[other])[-1] for other in names if other != name)
            m.d.sync += lesser[name].eq(others.any())
        return lesser

    def _target(self, m, name, fmt, lesser):
        """Where one parameter is to go; returns whether that was limited."""
        v, g = self.v[name], self.i.payload[name]
        # Long before the gradient: v up and down, because v and the step stand.
        step = register(self.config.formats.v.width - 1, f"step_{name}")
        m.d.sync += step.eq(1 << self.schedule.shift)

        def ways(step, size):
            """Both, and whether they are beyond the format."""
            found = []
            for way, target in (("up", v + step), ("down", v - step)):
                found.append(Cat(register(v.shape(), f"{way}{size}_{name}"), register(1, f"beyond_{way}{size}_{name}")))
                over = target[fmt.width - 1 :]
                m.d.sync += found[-1].eq(Cat(target[: fmt.width], over.any() & ~over.all()))
            return found

        # Stage 1: sign, and which parts of G are zero. Stage 2: choose, and limit.
        whole, half = ways(step, ""), ways(step >> 1, "_halved")
        parts, negative_s1 = -(-len(g) // 4), register(1, f"negative_s1_{name}")
        some_s1 = register(4, f"some_s1_{name}")
        m.d.sync += [negative_s1.eq(g[-1]), some_s1.eq(Cat(g[k * parts : (k + 1) * parts].any() for k in range(4)))]

        whole, half = (Mux(negative_s1, down, up) for up, down in (whole, half))
        chosen, moves = Mux(lesser, half, whole), some_s1.any()
        limited = Mux(chosen[-1], Mux(negative_s1, fmt.min, fmt.max), chosen[:-1].as_signed())
        m.d.comb += self.velocity.target[name].eq(Mux(moves, limited, v))
        return moves & chosen[-1]
