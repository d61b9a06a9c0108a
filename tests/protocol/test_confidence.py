"""Confidence, covariance and verdict of raw sums."""

from fractions import Fraction
from math import hypot, sqrt

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.protocol import confidence as judge
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.results import RegionOutcome
from support.mutation import mutated
from support.values import required

CONFIG = preset("fast")


def exact(n, limit, shape, contrast, scales=(4, 1)):
    """Whether the smaller eigenvalue is above the limit, of 4·n·[[xx, b/2], [b/2, yy]] − R·A without rounding."""
    by_n, by_limit = scales[0] * n, scales[1] * limit
    a, c = by_n * shape.xx - by_limit * contrast, by_n * shape.yy - by_limit * contrast
    return a > 0 and c > 0 and 4 * a * c > (by_n * shape.cross) ** 2


def near_the_limit(count, *, scales=(4, 1), seed=5):
    """Random ``(n, limit, curvature, contrast)`` with confidences near a usual limit; along the other axis more."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        n, limit = int(rng.integers(50, 2048)), int(rng.integers(60, 151))
        contrast = int(2 ** rng.uniform(14, 38))
        smaller = scales[1] * limit * contrast / (scales[0] * n) * np.exp(rng.uniform(-0.7, 0.7))
        larger, angle = smaller * np.exp(rng.uniform(0, 2.3)), rng.uniform(0, np.pi)
        c, s = np.cos(angle), np.sin(angle)
        xx, yy = smaller * c * c + larger * s * s, smaller * s * s + larger * c * c
        yield n, limit, judge.Curvature(int(xx), int(yy), int(2 * (larger - smaller) * c * s)), contrast


#: Equal to the limit, or not positive: ``(n, limit, curvature, contrast)``.
EDGES = [
    (n, limit, judge.Curvature(*shape[:3]), shape[3])
    for n, limit, shape in (
        (1, 8, (1, 5, 0, 1)), (1, 8, (5, 1, 0, 1)), (1, 8, (2, 2, 2, 1)), (1, 8, (2, 2, 1, 1)), (1, 8, (2, 2, -2, 1)),
        (3, 1, (1, 1, 2, 0)), (3, 1, (1, 1, -2, 0)), (3, 1, (2, 2, 3, 0)), (3, 1, (-2, -2, 0, 0)),
        (1, 90, (0, 0, 0, 0)),
        (3, 1, (-2, -2, 1, 9)), (9, 1, (-3, 5, 0, 0)), (9, 1, (5, -3, 0, 0)), (7, 1, (1, 0, 0, 0)),
        (7, 1, (0, 1, 0, 0)),
        (2047, 1023, (65535, 65535, 0, 1)), (2047, 1, (65536, 65536, 1, 65535)), (1, 1, (-65536, 1, 0, 0)),
    )
]  # fmt: skip


def test_short_is_below_one_and_a_half_pixels():
    """In any direction; and 1.34 px is, whatever the direction."""
    around = [(np.cos(a), np.sin(a)) for a in np.linspace(0, 2 * np.pi, 64, endpoint=False)]
    assert not any(judge.is_short((1.5 * x, 1.5 * y)) for x, y in around)
    assert all(judge.is_short((1.34 * x, 1.34 * y)) for x, y in around)
    assert judge.is_short((0.5, -0.5, 0.7, 0)) and not judge.is_short((0.5, -0.5, 0.7, -0.6))


def test_verdict_equals_the_eigenvalues():
    """At most one verdict in a thousand differs where the limit is near, and none of small numbers."""
    for case in EDGES:
        assert judge.is_trusted(CONFIG, *case) == exact(*case), case
    cases = list(near_the_limit(10_000))
    trusted = [exact(*case) for case in cases]
    assert 0.3 < np.mean(trusted) < 0.7
    assert sum(judge.is_trusted(CONFIG, *case) != verdict for case, verdict in zip(cases, trusted, strict=True)) <= 10


@pytest.mark.parametrize("fractions", [(6, 3), (3, 6)])
def test_votes_and_derivatives_may_have_other_fractions(fractions):
    weight, derivative = fractions
    config = CONFIG.replace(weight_frac=weight, derivative_frac=derivative, tag_bits=9)
    scales = (32, 1) if weight > derivative else (4, 8)
    assert config.widths.judge_scales == scales
    cases = list(near_the_limit(2_000, scales=scales))
    wrong = sum(judge.is_trusted(config, *case) != exact(*case, scales) for case in cases)
    # A coarse derivative makes the curvature small beside the contrast, so that fewer of its bits are kept.
    assert wrong <= (20 if weight > derivative else 2)


@pytest.mark.parametrize("old, new", [
    ("a > 0 and 4", "4"), ("> b * b", ">= b * b"), ("4 * a * c", "a * c"),
    ("by_n * yy - by_limit", "by_n * yy + by_limit"), ("by_n * xx - by_limit", "by_n * yy - by_limit"),
    ("by_n * cross", "by_n * abs(cross) // 2"), ("value >> drop", "value >> (drop + 5) << 5"),
    ("bit_length() + 1", "bit_length() + 8"), ("(n, limit)", "(n, limit + 1)"),
])  # fmt: skip
def test_another_comparison_would_be_noticed(old, new):
    mutant = mutated(judge, old, new)
    at_edges = sum(mutant.is_trusted(CONFIG, *case) != exact(*case) for case in EDGES)
    assert at_edges or sum(mutant.is_trusted(CONFIG, *case) != exact(*case) for case in near_the_limit(10_000)) > 10


def test_evaluations_lie_on_either_side():
    assert judge.beside((100, -4), 48) == ((52, -4), (148, -4), (100, -52), (100, 44))


def test_a_linear_gradient_gives_its_slope():
    """Of G = (−3·x − y, −5·x − 4·y); the constant cancels."""
    shape = judge.curvature(*((7 - 3 * x - y, 9 - 5 * x - 4 * y) for x, y in judge.beside((10, 20), 2)))
    assert shape == judge.Curvature(xx=4 * 3, yy=4 * 4, cross=4 * (5 + 1))


def peak(n, hessian, contrast_of_all):
    """An outcome whose contrast falls off like a parabola, in the integers of ``fast``."""
    pixels, sum_i = CONFIG.geometry.pixels, 1 << 13
    xx, yy, xy = (round(2 * judge.PROBE * pixels * axis) for axis in hessian)
    squares = (contrast_of_all + sum_i**2) // pixels
    measured = {"sums": (sum_i, 0, 0, 0, 0), "curvature": (xx, yy, 2 * xy), "sum_squares": squares}
    judged = {"confidence_limit": 90, "flags": Flag(0), "iterations": 1}
    return RegionOutcome(**required("region", v=(1.0, -1.0), roi_events=n, **measured, **judged))


def test_confidence_and_covariance_of_a_known_peak():
    """κ = λ_min·n/C, and the covariance is the inverse of the information, by the root of all ROI events."""
    n, contrast_of_all = 800, 4096 * 500_000
    hessian = 40_000.0, 90_000.0, 20_000.0  # of −ΣD·… in units of S: −∂²C/∂v² = 2·h/P
    outcome = peak(n, hessian, contrast_of_all)
    xx, yy, xy = [2 * n * 4096 * h / contrast_of_all for h in hessian]
    wanted = (xx + yy) / 2 - hypot((xx - yy) / 2, xy)
    assert judge.confidence(CONFIG, outcome) == pytest.approx(wanted, rel=1e-3) and wanted > 30
    inverse = np.linalg.inv([[xx, xy], [xy, yy]])
    told = np.array([inverse[0, 0], inverse[1, 1], inverse[0, 1]])
    assert judge.covariance(CONFIG, outcome) == pytest.approx(told * sqrt(n / judge.CALIBRATED_AT), rel=1e-3)
    more = changed(outcome, thinned=1900, overflow=100)
    assert judge.covariance(CONFIG, more) == pytest.approx(told * 2, rel=1e-3), "2,800 of the ROI, stored or not"
    shape, whole = judge.Curvature(*outcome.curvature), judge.contrast(4096, outcome.sums, outcome.sum_squares)
    smaller = Fraction(90) * whole / (4 * n)  # λ_min of the curvature at the limit
    determinant = (shape.xx - smaller) * (shape.yy - smaller) - Fraction(shape.cross, 2) ** 2
    kappa = judge.confidence(CONFIG, outcome)
    assert (determinant > 0) == judge.is_trusted(CONFIG, n, 90, shape, whole) == (kappa > 30)


def test_a_short_motion_is_trusted_as_far_as_its_bias_is_covered():
    good = peak(800, (40_000.0, 90_000.0, 0.0), 4096 * 500_000)
    # 1.2 px may be 5 % too large, 0.9 px 25 %, which only a batch of few events is as uncertain as.
    for v, flags, events, off, trusted in (
        ((0.0, -1.2), Flag.SHORT, 80_000, 1.2 / 21, True), ((0.0, -0.9), Flag.SHORT, 80_000, 0.18, False),
        ((0.0, -0.9), Flag.SHORT, 100, 0.18, True), ((-0.9, 0.0), Flag.SHORT, 200, 0.18, True),
        ((0.0, -0.9), Flag.SHORT, 200, 0.18, False), ((0.0, -1.2), Flag.SHORT | Flag.DOUBTFUL, 800, None, False),
        ((0.0, -2.0), Flag(0), 80_000, 0.0, True),
    ):  # fmt: skip
        outcome = changed(good, v=v, flags=flags, roi_events=events)
        assert judge.is_trustworthy(CONFIG, outcome) == trusted, (v, events, judge.uncertainty(CONFIG, outcome))
        if off is not None:
            assert judge.bias(outcome) == pytest.approx(off)
            (x, y), root = v, sqrt(events / judge.CALIBRATED_AT)
            added = np.array(judge.covariance(CONFIG, outcome)) - root * np.array(judge.uncertainty(CONFIG, outcome))
            assert added == pytest.approx(off**2 * np.array([x * x, y * y, x * y]) / (x * x + y * y), abs=1e-9)


def test_the_probes_distance_is_the_same_in_both_arithmetics():
    assert (3 << CONFIG.v_frac - 2) * CONFIG.formats.v.step == judge.PROBE


def test_motions_are_probed_nearer_to_zero():
    assert judge.probes_towards_zero((100, -4, 0), 48) == ((52, -4, 0), (100, 44, 0), (100, -4, -48))
    # Of G = (−3·x, −5·y, −4·z) and crosswise terms, which do not count; z falls by −7 with another sign.
    for gy, least in ((8 - 5 * 48, 3 * 48), (8 + 7, -7)):
        probes = [(9 + 3 * 48, 0, 0), (0, gy, 0), (0, 0, 7 + 4 * 48)]
        assert judge.least_fall((100, -4, 0), (9, 8, 7), probes) == least


@pytest.mark.parametrize("fractions", [(4, 4), (6, 3), (3, 6)])
@pytest.mark.parametrize("motion", ["similarity", "rotation"])
def test_the_confidence_of_a_motion_and_its_verdict(motion, fractions, rng):
    """κ = n·(−∂²(Σ I²)/∂v²)/Σ I², of the parameter that is known worst; ∂(Σ I²)/∂v = 2·S. The verdict is exact."""
    weight, derivative = fractions
    config = preset(motion).replace(weight_frac=weight, derivative_frac=derivative, tag_bits=10)
    unit, verdicts = 2.0**-config.widths.s_frac, []
    for _ in range(200):
        n, squares, limit = int(rng.integers(1, 8192)), int(rng.integers(1, 1 << 30)), int(rng.integers(1, 1024))
        least = int(squares * 2.0 ** (config.motion_model.frac + derivative - weight) * limit / n)
        least = int(least * rng.uniform(0.06, 0.25))
        outcome = changed(peak(n, (1.0, 1.0, 0.0), 1), curvature=(least,), sum_squares=squares)
        wanted = n * 2 * (least * unit / judge.PROBE) / (squares * 2.0 ** (-2 * weight))
        assert judge.confidence(config, outcome) == pytest.approx(wanted) and judge.covariance(config, outcome) is None
        verdicts.append(judge.is_sharp(config, n, limit, least, squares))
        assert verdicts[-1] == (wanted * 3 > limit)
    assert 0.2 < np.mean(verdicts) < 0.8
    # As large as the limit is not larger.
    by_n, by_limit = config.widths.judge_scales
    assert [judge.is_sharp(config, by_limit, 9, 9 * 5 + more, by_n * 5) for more in (0, 1)] == [False, True]
    assert judge.confidence(config, changed(outcome, sum_squares=0)) == 0


def changed(outcome, **changes):
    return RegionOutcome(**{**vars(outcome), **changes})


def test_where_nothing_was_judged_nothing_is_said():
    good = peak(800, (40_000.0, 90_000.0, 0.0), 4096 * 500_000)
    assert judge.is_judged(good)
    for changes in ({"confidence_limit": 0}, {"confidence_limit": None}, {"flags": Flag.DEGENERATE}):
        outcome = changed(good, **changes)
        assert not judge.is_judged(outcome)
        assert judge.confidence(CONFIG, outcome) is judge.covariance(CONFIG, outcome) is None
    assert judge.covariance(CONFIG, changed(good, flags=Flag.DOUBTFUL)) is None
    assert judge.covariance(CONFIG, peak(800, (40_000.0, -1.0, 0.0), 4096 * 500_000)) is None
    flat = changed(good, sums=(0,) * 5, sum_squares=0)
    assert judge.confidence(CONFIG, flat) == 0 and judge.covariance(CONFIG, flat) is None
