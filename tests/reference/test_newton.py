"""A round's step: the integers against exact fractions, their bounds, and rounds of both cores."""

import inspect
from fractions import Fraction

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.config.schedule import DISTANCES, Round
from cmfpga.fixed import bits_for, signed_bits_for
from cmfpga.protocol.confidence import beside
from cmfpga.protocol.settings import BatchSettings
from cmfpga.reference.float_core import FloatCore, newton_step
from cmfpga.reference.integer import ascent as module
from cmfpga.reference.integer.ascent import newton, solve
from cmfpga.reference.integer.core import IntegerCore
from support.configs import ROUNDS

CONFIG = preset("fast")
UNIT = 1 << CONFIG.widths.g_zeros
ENTRIES = [Round(0, distance, limit) for distance in DISTANCES for limit in (1 / 64, 3 / 16, 0.75, 1.0, 1.5, 4.0)]


def gradients(xx, yy, cross, x, y):
    """Four gradients whose sums these are but for rounding, as :func:`solve` has them, in units of G."""
    gx, gy, half = x / 4, y / 4, cross / 4
    four = (gx + xx / 2, gy + half), (gx - xx / 2, gy - half), (gx + half, gy + yy / 2), (gx - half, gy - yy / 2)
    return [tuple(UNIT * round(axis) for axis in one) for one in four]


def drawn(rng):
    """Curvatures of any sign and shape, a gradient of any length beside them."""
    size = 2 ** rng.uniform(18, 28)
    shape = size * rng.uniform(-0.3, 1, 2)
    cross = rng.uniform(-2, 2) * np.sqrt(abs(shape[0] * shape[1]))
    g = size * 2 ** rng.uniform(-8, 3, 2) * rng.choice([-1, 1], 2)
    return gradients(*shape, cross, *g)


def exact(four, entry):
    """(step, damped, peak) in raw units of v, by fractions."""
    x, y = (Fraction(sum(axis), 4) for axis in zip(*four, strict=True))
    h = Fraction(entry.distance, 4)
    xx, yy = (four[0][0] - four[1][0]) / (2 * h), (four[2][1] - four[3][1]) / (2 * h)
    b = (four[0][1] - four[1][1] + four[2][0] - four[3][0]) / (4 * h)
    trace = xx + yy
    if damped := 8 * (xx * yy - b * b) < trace * trace:
        xx, yy = xx + trace / 8, yy + trace / 8
    det, limit = xx * yy - b * b, Fraction(entry.limit)
    if trace <= 0 or det <= 0:
        return [0 if 2 * abs(one) < max(abs(x), abs(y)) else limit * ((one > 0) - (one < 0)) for one in (x, y)], 0, 0
    least = min(limit, 2 * h)
    return [max(-least, min(least, one)) for one in ((yy * x - b * y) / det, (xx * y - b * x) / det)], damped, 1


def compare(solve, count, rng, right=exact):
    """Of ``count`` rounds: how many steps are off by more than what is cut off, and which kinds came."""
    off, kinds = 0, set()
    for _ in range(count):
        four, entry = drawn(rng), ENTRIES[rng.integers(len(ENTRIES))]
        step, damped, peak = right(four, entry)
        found = solve(CONFIG, four, entry)
        kinds.add((bool(damped), bool(peak), tuple(bool(one) for one in step)))
        # A ratio is cut to 1/64 and loses what 17 bits of the sums leave out; h makes up to three of one.
        most = 1 + entry.distance / 4
        off += any(abs(a - 64 * b) > most for a, b in zip(found.step, step, strict=True))
    return off, kinds


def test_steps_are_those_of_fractions(rng):
    off, kinds = compare(solve, 3000, rng)
    assert off <= 9  # where 17 bits decide otherwise whether there is a peak, or whether it is flat
    assert {kind[:2] for kind in kinds} == {(False, True), (True, True), (False, False)}
    assert (False, False, (True, False)) in kinds and (False, False, (True, True)) in kinds


@pytest.mark.parametrize("old, new", [
    ("trace >> 3", "trace >> 2"), ("2 * det < trace", "det < trace"), ("square >> 4", "square >> 5"),
    ("trace > 0 and ", ""), (" and det > 0", ""), ("2 * size <", "size <"),
    ("4 * xx * yy - cross", "4 * xx * yy + cross"),
    ("2 * yy * x - cross * y", "2 * xx * x - cross * y"), ("2 * xx * y - cross * x", "2 * xx * y + cross * x"),
    ("(2 << fmt.f) - 1", "(1 << fmt.f) - 1"), ("+ 2) >> 2, limit)", "+ 2) >> 2, 2 * limit)"),
    ("-size if n < 0 else size", "size"), ("kept(widths.kept_bits,", "kept(9,"),
])  # fmt: skip
def test_another_step_would_be_noticed(old, new, rng):
    source = inspect.getsource(solve)
    assert source.count(old) == 1
    mutant = dict(vars(module))
    exec(source.replace(old, new), mutant)
    off, _ = compare(mutant["solve"], 1500, rng)
    assert off > 20


def test_a_linear_gradient_ends_at_its_zero(rng):
    """Whatever the shape of a peak that is not flat, one round meets it, if it is less than 2·h and the limit away."""
    for _ in range(300):
        turn, sizes, v = rng.uniform(0, np.pi), 2.0**20 * rng.uniform(0.25, 1, 2), rng.integers(-60, 61, 2)
        axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        hessian, top = axes @ np.diag(sizes) @ axes.T, rng.integers(-60, 61, 2) + v
        four = [tuple(UNIT * int(one) for one in hessian @ (top - at) / 64) for at in np.array(beside(v.tolist(), 64))]
        found, saturated = newton(CONFIG, tuple(v.tolist()), four, Round(0, 4, 2.0))
        assert np.abs(np.array(found) - top).max() <= 1 and not saturated


@pytest.mark.parametrize("name", ROUNDS)
def test_words_hold_what_they_are_said_to(name, rng):
    config, widths = ROUNDS[name], ROUNDS[name].widths
    unit = 1 << widths.g_zeros
    ends = [-widths.g_max // unit * unit, 0, widths.g_max // unit * unit]
    seen = []
    for number in range(4000):
        if number % 2:
            four = [tuple(int(one) for one in rng.choice(ends, 2)) for _ in range(4)]
        else:
            four = [tuple(int(end * rng.uniform(-1, 1)) // unit * unit for _ in "xy") for end in [ends[2]] * 4]
        found = solve(config, four, Round(0, 3, 0.75))
        assert all(one % unit == 0 for one in found.sums)
        assert all(signed_bits_for(abs(one) // unit) <= widths.round_bits for one in found.sums)
        assert all(-(1 << 16) <= one < 1 << 16 for one in found.kept)
        assert signed_bits_for(abs(found.det)) <= 36
        assert found.ratio == (0, 0) if not found.peak else max(map(bits_for, found.ratio)) <= config.v_frac + 1
        seen.append((found.peak, found.damped))
    assert {(True, True), (True, False), (False, True)} <= set(seen)


def test_nothing_measured_moves_nothing_and_the_format_limits():
    assert newton(CONFIG, (5, -7), [(0, 0)] * 4, Round(0, 3, 4.0)) == ((5, -7), False)
    up = gradients(-(1 << 20), -(1 << 20), 0, 1 << 20, -(1 << 18))
    assert newton(CONFIG, (2000, -7), up, Round(0, 3, 0.75)) == ((2047, -7), True)  # y is lesser
    assert newton(CONFIG, (1999, -7), up, Round(0, 3, 0.75)) == ((2047, -7), False)


def test_float_and_integer_steps_are_alike(rng):
    def right(four, entry):
        return newton_step(four, entry.distance / 4, entry.limit), None, None

    assert compare(solve, 1000, rng, right)[0] <= 4


def events(rng, v, n=500):
    """Times, columns and rows of points that move at ``v`` px per half batch in the ROI of ``CONFIG``."""
    t = np.sort(rng.integers(0, 20_000, n))
    t[0], t[-1] = 0, 20_000
    points = rng.uniform(18, 46, (40, 2))
    at = points[rng.integers(len(points), size=n)] + (t / 10_000 - 1)[:, None] * v
    x, y = np.clip(np.floor(at + 0.5), 0, 63).astype(np.int64).T
    return t, x, y


@pytest.mark.parametrize("start", [(0.0, 0.0), (3.0, -1.5)])
def test_batches_of_both_cores(start, rng):
    """v within a few hundredths, the same verdict, and a trace that says what each evaluation found."""
    v = np.array([3.3, -1.2])
    config = CONFIG.replace(start="given", v_start_x=start[0], v_start_y=start[1])
    settings, batch = BatchSettings.from_config(config, (0, 0)), events(rng, v)
    core, real = IntegerCore(config), FloatCore(config)
    found, wanted = core.run(*batch, settings, keep=True), real.run(*batch, settings)
    assert np.abs(np.array(found.v) - v).max() < 0.15
    assert np.abs(np.array(found.v) - wanted.v).max() < 0.1 and found.flags == wanted.flags
    plan, trace = core.plan, found.trace
    assert found.iterations == len(plan) == len(settings.cold) and trace.v.shape == (len(plan) + 1, 2)
    assert trace.sum_i.shape == (len(plan), 4) and trace.s.shape == trace.sum_d.shape == (len(plan), 4, 2)
    assert wanted.trace.s.shape == trace.s.shape and not trace.sum_d.any()
    for k, entry in enumerate(plan):
        each = core.iterations[4 * k : 4 * k + 4]
        assert [one.v for one in each] == [*beside(tuple(trace.v[k].tolist()), 16 * entry.distance)]
        assert newton(config, tuple(trace.v[k].tolist()), [one.g for one in each], entry)[0] == tuple(trace.v[k + 1])
        assert [one.sums.s for one in each] == [tuple(one) for one in trace.s[k].tolist()]
    assert found.sums == tuple(sum(one.sums[k] for one in each) // 4 for k in range(3)) + tuple(
        sum(one.sums.s[k] for one in each) // 4 for k in range(2)
    )
    assert found.sum_squares == sum(int((one.images.i**2).sum()) for one in each) // 4
    four = [one.g for one in each]
    assert found.curvature == (
        four[0][0] - four[1][0], four[2][1] - four[3][1], four[0][1] - four[1][1] + four[2][0] - four[3][0],
    )  # fmt: skip
    assert found == IntegerCore(config.replace(evaluators=4)).run(*batch, settings)


def test_velocities_beside_the_end_of_the_format_are_not_limited(rng):
    config = CONFIG.replace(start="given", v_start_x=31.98, v_start_y=-32.0, cold="0:3:1/64")
    core = IntegerCore(config)
    core.run(*events(rng, (1, 1)), BatchSettings.from_config(config, (0, 0)), keep=True)
    x, y = config.formats.v.raw(31.98), config.formats.v.min
    assert [one.v for one in core.iterations] == [(x - 192, y), (x + 192, y), (x, y - 192), (x, y + 192)]
