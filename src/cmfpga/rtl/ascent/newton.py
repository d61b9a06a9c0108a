"""The Newton ascent: a step M⁻¹·g of the four gradients of a round."""

from functools import reduce
from operator import or_

from amaranth.hdl import Cat, Const, Mux, Signal, signed
from amaranth.lib.wiring import Out

from ...config.schedule import DISTANCES
from .. import payloads
from ..arithmetic import delay, register, select
from .schedule import ScheduledAscent

SUMS = ("x", "y", "xx", "yy", "cross")


class NewtonAscent(ScheduledAscent):
    """v ← v + h·(2·yy·x − cross·y, 2·xx·y − cross·x)/(4·xx·yy − cross²), of sums over a round's four gradients.

    What is computed, in integers: :mod:`cmfpga.reference.integer.ascent`, whose numbers the steps below have. Two
    multipliers take turns; both axes divide side by side, a bit a cycle. ``k`` is the step in which the sums are
    normalised::

        step    0 ......... 1 .... 2 … k ............ k + 8 ...... k + 9 … .......... + 4
                G₃ (1) ───► load ► normalise (2) ──► multiply ──► load ► divide ────► scale, limit ► move
                                                     (3, 4, 5)           (6)          (7)

    Four gradients in successive cycles, ``latency`` cycles from the last of them to the new v. See
    :class:`~.ascent.Ascent` and :class:`~.schedule.ScheduledAscent` for the other members and attributes.

    Members
    -------
    distance : ``Out``, :func:`payloads.distance`
        How far beside v the round evaluates; changes with ``level``.
    curvature : ``Out``, :func:`payloads.curvature`
        Right from the cycle after the fourth gradient on, until the next round's first. Only where v's confidence is
        measured.
    """

    def __init__(self, config):
        members = {"distance": Out(payloads.distance(config))}
        if config.confidence:
            members["curvature"] = Out(payloads.curvature(config))
        # v and the largest limit: one bit more than either.
        super().__init__(config, target_bits=config.formats.v.width + 1, members=members)
        self._shifts = config.widths.round_shifts
        self._kept = 4 + len(self._shifts)
        self._divided = self._kept + 9 + config.v_frac + 2
        self.latency = self._divided + 5

    def elaborate(self, platform):
        config = self.config
        m = self.scheduled()
        m.d.comb += self.distance.eq(self.schedule.distance)
        last, sums = self._sum(m)
        step, busy, ends = Signal(range(self.latency)), Signal(), Signal()
        m.d.sync += [
            busy.eq(last | (busy & ~ends)),
            step.eq(Mux(last | ends, last, step + busy)),
            ends.eq(step == self.latency - 2),
        ]
        kept = self._normalise(m, step, last, sums)
        peak, det, over = self._solve(m, step, kept)
        ratios = {axis: self._divide(m, step, axis, over[axis], det) for axis in "xy"}

        # Without a peak: the limit, or nothing along an axis of a lesser slope.
        sizes = {axis: delay(m, _size(kept[axis]), 1, name=f"size_{axis}") for axis in "xy"}
        limit = Signal(config.formats.v.width, reset_less=True)
        code = self.schedule.limit
        m.d.sync += limit.eq(((2 | code[0]) << code[1:]) >> 1)
        for axis, other in ("xy", "yx"):
            lesser = (sizes[axis] << 1) < sizes[other]
            none = delay(m, lesser | (kept[axis] == 0), 1, name=f"none_{axis}")
            negative = delay(m, Mux(peak, over[axis][-1], kept[axis][-1]), 1, name=f"negative_{axis}")
            # 7, in four stages.
            ratio_s1 = delay(m, ratios[axis], 1, name=f"ratio_{axis}")
            three_s1 = delay(m, ratios[axis] + (ratios[axis] << 1), 1, name=f"three_{axis}")
            scaled = select(self.distance, [_quarters(each, ratio_s1, three_s1) for each in DISTANCES])
            scaled_s2 = delay(m, scaled, 1, name=f"scaled_{axis}")
            flat = Mux(none, 0, limit)
            size_s3 = Signal(len(limit), name=f"step_{axis}", reset_less=True)
            m.d.sync += size_s3.eq(Mux(peak, Mux(scaled_s2 > limit, limit, scaled_s2), flat))
            v = self.v[axis]
            target = delay(m, Mux(negative, v - size_s3, v + size_s3), 1, name=f"target_{axis}")
            m.d.comb += self.velocity.target[axis].eq(target)
        m.d.comb += self.velocity.move.eq(ends)
        return m

    def _sum(self, m):
        """1: ``(the last gradient comes, the five sums)``, those a cycle later."""
        zeros, bits = self.config.widths.g_zeros, self.config.widths.round_bits
        turn, valid = Signal(2), self.i.valid
        # The fourth comes three cycles after the first, whose delay is known without waiting for it.
        last = delay(m, valid & (turn == 0), 3, name="first", valid=True)
        x, y = (self.i.payload[axis][zeros:].as_signed() for axis in "xy")
        m.d.sync += turn.eq(turn + valid)
        # Of xx, yy and cross the second and the fourth gradient count negative.
        own, other = (Mux(turn[1], *pair) ^ turn[0].replicate(len(x)).as_signed() for pair in ((y, x), (x, y)))
        sums = {name: Signal(signed(bits), name=f"sum_{name}") for name in SUMS}
        grows = {"x": (x, 0, 1), "y": (y, 0, 1), "xx": (own, turn[0], ~turn[1]), "yy": (own, turn[0], turn[1])}
        grows["cross"] = other, turn[0], 1
        for name, (addend, carry, counts) in grows.items():
            begin = turn == (2 if name == "yy" else 0)
            with m.If(self.run.take):
                m.d.sync += sums[name].eq(0)
            with m.Elif(valid & counts):
                m.d.sync += sums[name].eq(Mux(begin, 0, sums[name]) + addend + carry)
        if self.config.confidence:
            m.d.comb += [self.curvature[name].eq(sums[name] << zeros) for name in ("xx", "yy", "cross")]
        return last, sums

    def _normalise(self, m, step, last, sums):
        """2: from step ``_kept`` on. Which bits tell of a size is known first; these decide, a cycle ahead."""
        wide = {name: Signal.like(value, name=f"wide_{name}", reset_less=True) for name, value in sums.items()}
        telling = Signal(self.config.widths.round_bits - 1, reset_less=True)
        sizes = [*map(_size, sums.values())]
        told = [delay(m, reduce(or_, some), 1, name=f"told_{n}") for n, some in enumerate((sizes[:3], sizes[3:]))]
        # Steps 1 and 2, from registers, for much hangs on them.
        loads = delay(m, last, 1, name="loads", valid=True)
        with m.If(loads):
            m.d.sync += [wide[name].eq(value) for name, value in sums.items()]
        with m.If(delay(m, loads, 1, name="tells", valid=True)):
            m.d.sync += telling.eq(told[0] | told[1])
        for by in sorted(set(self._shifts)):
            fits, due, shift = ~telling[-by:].any(), Signal(name=f"due_{by}"), Signal(name=f"shift_{by}")
            m.d.sync += due.eq(Cat(step == 2 + n for n, each in enumerate(self._shifts) if each == by).any())
            m.d.sync += shift.eq(due & fits)
            with m.If(due & fits):
                m.d.sync += telling.eq(telling << by)
            with m.If(shift):
                m.d.sync += [value.eq(value << by) for value in wide.values()]
        return {name: value[-self.config.widths.kept_bits :].as_signed() for name, value in wide.items()}

    def _solve(self, m, step, kept):
        """3 to 5: ``(peak, det, numerators)``, the first from step k + 7, the others from k + 5 and k + 8 on."""
        bits, k = self.config.widths.kept_bits, self._kept
        x, y, xx, yy, cross = (kept[name] for name in SUMS)
        narrow, wide = signed(bits + 1), signed(2 * bits + 2)
        trace, damped_xx, damped_yy = (register(narrow, name) for name in ("trace", "damped_xx", "damped_yy"))
        det_before, more, det = (register(wide, name) for name in ("det_before", "more", "det"))
        damps, peak = Signal(reset_less=True), Signal(reset_less=True)
        over = {axis: register(signed(2 * bits + 1), f"over_{axis}") for axis in "xy"}
        program = {
            k: ((xx, yy), (cross, cross)),
            k + 1: ((trace, trace), (cross, y)),
            k + 2: ((trace, trace), (cross, x)),
            k + 5: ((damped_yy, x), (damped_xx, y)),
        }
        products, which = [], Signal(range(len(program)))
        for number, when in enumerate(program):  # known a cycle ahead
            with m.If(step == when - 1):
                m.d.sync += which.eq(number)
        for number in range(2):
            one, other = (register(narrow, f"factor_{number}_{n}") for n in range(2))
            m.d.sync += [
                factor.eq(select(which, [factors[number][n] for factors in program.values()]))
                for n, factor in enumerate((one, other))
            ]
            products.append(delay(m, one * other, 1, name=f"product_{number}"))
        first, second = products
        cross_y, cross_x = delay(m, second, 1, name="cross_y"), register(wide, "cross_x")
        kept_y = register(wide, "kept_y")
        m.d.sync += trace.eq(xx + yy)
        # From step k + 7 on, in two stages: it is not asked for before the division has ended. Without a trace there is
        # no positive determinant.
        some = delay(m, Cat(det[low : low + 8].any() for low in range(0, len(det), 8)), 1, name="some")
        m.d.sync += peak.eq(some.any() & ~det[-1] & ~trace[-1])
        with m.Switch(step):
            with m.Case(k + 2):
                m.d.sync += det_before.eq((first << 2) - second)
            with m.Case(k + 3):
                m.d.sync += [damps.eq((det_before << 1) < first), more.eq((first >> 1) + (first >> 4))]
            with m.Case(k + 4):
                m.d.sync += [kept_y.eq(cross_y), cross_x.eq(second)]
                m.d.sync += det.eq(det_before + Mux(damps, more, 0))
                m.d.sync += [damped_xx.eq(xx + Mux(damps, trace >> 3, 0)), damped_yy.eq(yy + Mux(damps, trace >> 3, 0))]
            with m.Case(k + 7):
                m.d.sync += [over["x"].eq((first << 1) - kept_y), over["y"].eq((second << 1) - cross_x)]
        return peak, det, over

    def _divide(self, m, step, axis, over, det):
        """6: the ratio, from step ``_divided`` on."""
        bits = self.config.v_frac + 2  # the first says that it is limited
        rest = Signal(signed(len(det) + 3), name=f"rest_{axis}", reset_less=True)
        inverse = Signal(bits, name=f"inverse_{axis}", reset_less=True)  # of the quotient, as the signs come
        # Not restored where it does not fit, but added to: then no choice follows the adder. Its lowest bit carries.
        down = ~rest[-1]
        by = (delay(m, det, 1, name=f"det_{axis}") << 1) ^ down.replicate(len(rest)).as_signed()
        trial = (Cat(Const(1, 1), rest).as_signed() + Cat(down, by).as_signed())[1 : 1 + len(rest)]
        # Known a cycle ahead, for much hangs on it.
        loads, divides = Signal(name=f"loads_{axis}"), Signal(name=f"divides_{axis}")
        m.d.sync += [loads.eq(step == self._kept + 7), divides.eq(step != self._divided - 1)]
        with m.If(loads):
            m.d.sync += rest.eq(_size(over))
        with m.Elif(divides):
            m.d.sync += [rest.eq(trial << 1), inverse.eq(Cat(trial[-1], inverse))]
        return ~(inverse[:-1] & inverse[-1].replicate(bits - 1))


def _size(value):
    """A value, or its bits inverted where it is negative."""
    return (value ^ value[-1].replicate(len(value)).as_signed())[:-1]


def _quarters(quarters, value, three):
    """``quarters``/4 of a value, rounded half up; of a number 2^k or 3·2^k of quarters."""
    power = (quarters // 3 if quarters % 3 == 0 else quarters).bit_length() - 3
    value = three if quarters % 3 == 0 else value
    return value << power if power >= 0 else (value + (1 << -power - 1)) >> -power
