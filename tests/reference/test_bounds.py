"""The bound between the integer model and the float reference, against integers written out one event at a time."""

from fractions import Fraction
from math import ceil, floor, inf

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.errors import ConfigError
from cmfpga.reference.floating import evaluate, scaled_times, warp
from support.bounds import dt_error, gain_error, gradient_bound, position_error

# -------------------------------------------------------------------- the integer arithmetic, in Python integers


def rounded(numerator, shift):
    """Half up, to ``shift`` bits fewer."""
    return (2 * numerator + (1 << shift)) >> (shift + 1) if shift > 0 else numerator << -shift


def floored(numerator, shift):
    return numerator >> shift if shift >= 0 else numerator << -shift


def integer_dt(config, t, t_first, t_last):
    span = t_last - t_first
    shift = 0
    while span << shift < 1 << (config.span_bits - 1):
        shift += 1
    exponent = config.span_bits - 1 + config.reciprocal_bits
    reciprocal = (1 << exponent) // (span << shift)
    return rounded(((2 * (t - t_first) - span) << shift) * reciprocal, exponent - config.dt_frac)


def integer_position(config, x, dt, v):
    frac = config.dt_frac + config.v_frac
    return floored((x << frac) - dt * v, frac - config.position_frac)


def integer_gradient(config, x, y, dt, v, *, dropped=0, weights_rounded=rounded, derivatives_rounded=rounded):
    """∂C/∂vx, ∂C/∂vy from raw ``dt`` and ``v``, as exact fractions; ``dropped`` columns and rows at the far border."""
    one = 1 << config.position_frac
    image, d_x, d_y = {}, {}, {}
    for x_k, y_k, dt_k in zip(x, y, dt, strict=True):
        x_w, y_w = integer_position(config, x_k, dt_k, v[0]), integer_position(config, y_k, dt_k, v[1])
        i, fx = divmod(x_w, one)
        j, fy = divmod(y_w, one)
        gx, gy = one - fx, one - fy

        def derivative(a, dt_k=dt_k):
            return derivatives_rounded(dt_k * a, config.dt_frac + config.position_frac - config.derivative_frac)

        for column, row, a, b, by_x, by_y in (
            (i, j, gx, gy, derivative(gy), derivative(gx)),
            (i + 1, j, fx, gy, -derivative(gy), derivative(fx)),
            (i, j + 1, gx, fy, derivative(fy), -derivative(gx)),
            (i + 1, j + 1, fx, fy, -derivative(fy), -derivative(fx)),
        ):
            if 0 <= column < config.roi_width - dropped and 0 <= row < config.roi_height - dropped:
                pixel = column, row
                weight = weights_rounded(a * b, 2 * config.position_frac - config.weight_frac)
                image[pixel] = image.get(pixel, 0) + weight
                d_x[pixel] = d_x.get(pixel, 0) + by_x
                d_y[pixel] = d_y.get(pixel, 0) + by_y
    pixels = config.roi_width * config.roi_height
    square = pixels**2
    q = square.bit_length() - 1
    result = []
    for d in (d_x, d_y):
        g = pixels * sum(image[pixel] * d[pixel] for pixel in d) - sum(image.values()) * sum(d.values())
        raw = floored(g, config.weight_frac + config.derivative_frac + q - 1 - config.gradient_frac)
        result.append(Fraction(raw, 1 << config.gradient_frac) / Fraction(square, 1 << q))
    return result


# -------------------------------------------------------------------- cases

SIZES = [(2, 2), (8, 4), (6, 10), (30, 22), (64, 64)]


def random_config(rng, **changes):
    """The paper's formats, those proposed for sign steps, or any others."""
    width, height = SIZES[rng.integers(len(SIZES))]
    size = {"roi_width": width, "roi_height": height, "buffer_events": 64}
    kind = rng.integers(3)
    if kind == 1:
        size |= {"dt_frac": 8, "v_frac": 6, "position_frac": 4, "weight_frac": 4, "derivative_frac": 4}
    if kind == 2:
        size |= {
            name: int(rng.integers(low, high + 1))
            for name, low, high in (
                ("dt_frac", 3, 14),
                ("v_frac", 1, 14),
                ("position_frac", 1, 10),
                ("weight_frac", 1, 14),
                ("derivative_frac", 1, 14),
                ("reciprocal_bits", 5, 17),
                ("gradient_frac", 8, 26),
                ("span_bits", 18, 24),
            )
        }
    return Config(**(size | changes))


def random_batch(rng, config, n=None):
    """ROI events (t, x, y) of a batch from t_first to t_last, and a raw v, round ones (kinks!) among them."""
    n = int(rng.choice([0, 1, 2, 5, 15, 40])) if n is None else n
    t_first, span = int(rng.integers(10**6)), int(rng.choice([1, 2, 7, 1000, 33_333, 200_001]))
    t = np.sort(rng.integers(t_first, t_first + span + 1, n))
    x, y = rng.integers(config.roi_width, size=n), rng.integers(config.roi_height, size=n)
    if rng.random() < 0.3:  # structure: few places, so that images are high
        x, y = x // 3, y // 3
    reach = rng.choice([0.3, 3, 12])
    v = [config.formats.v.raw(value) for value in rng.uniform(-reach, reach, 2)]
    if rng.random() < 0.3:
        v = [round(value * config.formats.v.step) << config.v_frac for value in v]  # whole pixels, zero among them
    return (t, x, y), (t_first, t_first + span), v


def integers(array):
    return [int(value) for value in array]


def compare(config, events, batch, v, **model):
    """|integer − float| and its bound, [2] each."""
    t, x, y = events
    dt = scaled_times(t, *batch)
    real_v = [config.formats.v.real(value) for value in v]
    raw_dt = [integer_dt(config, t_k, *batch) for t_k in integers(t)]
    exact = evaluate(x, y, dt, real_v, width=config.roi_width, height=config.roi_height).gradient.tolist()
    integer = integer_gradient(config, integers(x), integers(y), raw_dt, v, **model)
    error = [abs(float(a - Fraction(b))) for a, b in zip(integer, exact, strict=True)]
    return np.array(error), gradient_bound(config, x, y, dt, real_v).numpy()


def coarse_format(value):
    """Name of a test case: the format that is changed."""
    return next(iter(value))


def ratios_of(error, bound):
    """actual/bound along both axes; 0 where nothing is rounded and both are 0."""
    return (error / np.where(bound > 0, bound, 1)).tolist()


def test_bound_holds_and_is_not_absurdly_loose(rng):
    ratios, few, crossings = [], [], 0
    for _ in range(500):
        config = random_config(rng)
        events, batch, v = random_batch(rng, config)
        error, bound = compare(config, events, batch, v)
        assert (error <= bound).all()
        assert np.isfinite(bound).all()
        if len(events[0]):
            ratio = ratios_of(error, bound)
            ratios += ratio
            few += ratio if len(events[0]) <= 2 else []
            dt = scaled_times(events[0], *batch)
            for axis, place in enumerate(warp(*events[1:], dt, [config.formats.v.real(value) for value in v])):
                below, above = position_error(config, dt, config.formats.v.real(v[axis]))
                crossings += int(((place - below).floor() < (place + above).floor()).sum())
    print(f"actual/bound: median {np.median(ratios):.3f}, at most 2 events {np.median(few):.3f}, max {max(ratios):.3f}")
    assert crossings > 500  # the hard case did occur
    # Independent errors add up like √n, their bounds like n; with few events the two must be near.
    assert np.median(ratios) > 0.02
    assert np.median(few) > 0.04
    assert max(ratios) > 0.5


FINE = {"dt_frac": 14, "position_frac": 12, "weight_frac": 14, "derivative_frac": 14, "gradient_frac": 26}


@pytest.mark.parametrize(
    "coarse",
    [{"dt_frac": 3}, {"position_frac": 1}, {"weight_frac": 2}, {"derivative_frac": 2}],
    ids=coarse_format,
)
def test_each_error_alone_is_bounded_tightly(coarse, rng):
    """One coarse format among fine ones and few events: its share of the bound holds by itself and is approached."""
    config = Config(roi_width=6, roi_height=4, buffer_events=8, **(FINE | coarse))
    worst = 0.0
    for _ in range(120):
        events, batch, v = random_batch(rng, config, n=int(rng.integers(1, 4)))
        error, bound = compare(config, events, batch, v)
        assert (error <= bound).all()
        worst = max(worst, *ratios_of(error, bound))
    print(f"actual/bound up to {worst:.3f}")
    assert worst > 0.4


WRONG = {
    "weights floored": ({"weight_frac": 3}, {"weights_rounded": floored}),
    "derivatives floored": ({"derivative_frac": 3}, {"derivatives_rounded": floored}),
    "a border that drops corners": ({}, {"dropped": 1}),
}


@pytest.mark.parametrize("name", WRONG)
def test_bound_notices_wrong_integers(name, rng):
    """With fine formats but one, the bound is near enough to tell a wrong rounding from the right one."""
    coarse, model = WRONG[name]
    config = Config(roi_width=6, roi_height=4, buffer_events=8, **(FINE | coarse))
    seen = 0
    for _ in range(100):
        events, batch, v = random_batch(rng, config, n=2)
        error, bound = compare(config, events, batch, v, **model)
        seen += (error > bound).any()
        error, bound = compare(config, events, batch, v)
        assert (error <= bound).all()
    assert seen >= 2


def votes(config, x, y, dt):
    """Unrounded votes of one warped event: {(column, row): (w, ∂w/∂vx)}."""
    i, j = floor(x), floor(y)
    corners = {}
    for column, across, sign in ((i, 1 - x + i, -1), (i + 1, x - i, 1)):
        for row, down in ((j, 1 - y + j), (j + 1, y - j)):
            if 0 <= column < config.roi_width and 0 <= row < config.roi_height:
                corners[column, row] = across * down, -dt * sign * down
    return corners


def extremes(low, high):
    """Ends of a range, and both sides of the grid lines in it."""
    lines = range(ceil(low), floor(high) + 1)
    return [low, high, *lines, *(line - 1e-9 for line in lines if line - 1e-9 > low)]


@pytest.mark.parametrize("coarse", [{"dt_frac": 5}, {"position_frac": 3}], ids=coarse_format)
def test_an_adversary_within_the_formats_reaches_the_bound(coarse, rng):
    """Errors chosen against us, event by event, as large as the formats allow: the bound holds, with little spare."""
    config = Config(roi_width=8, roi_height=6, buffer_events=8, **(FINE | coarse))
    ratios = []
    for _ in range(60):
        n = int(rng.integers(1, 7))
        x, y = rng.integers(8, size=n), rng.integers(6, size=n)
        dt = rng.uniform(-1, 1, n)
        v = [config.formats.v.real(config.formats.v.raw(value)) for value in rng.uniform(-3, 3, 2)]
        exact = evaluate(x, y, dt, v, width=8, height=6)
        phi = (exact.image - exact.image.mean()).T.tolist()
        psi = (exact.derivative_x - exact.derivative_x.mean()).T.tolist()
        dt_errors = dt_error(config, dt).tolist()
        boxes = []
        for axis, place in enumerate(warp(x, y, dt, v)):
            below, above = position_error(config, dt, v[axis])
            boxes.append(list(zip((place - below).tolist(), (place + above).tolist(), strict=True)))
        bound = float(gradient_bound(config, x, y, dt, v)[0])
        for worst in (max, min):
            image, derivative = np.zeros((8, 6)), np.zeros((8, 6))
            for k in range(n):
                choices = [
                    votes(config, x_k, y_k, t_k)
                    for x_k in extremes(*boxes[0][k])
                    for y_k in extremes(*boxes[1][k])
                    for t_k in (dt[k] - dt_errors[k], dt[k] + dt_errors[k])
                ]

                def effect(vote, phi=phi, psi=psi):
                    return sum(psi[i][j] * w + phi[i][j] * d for (i, j), (w, d) in vote.items())

                for pixel, (w, d) in worst(choices, key=effect).items():
                    image[pixel] += w
                    derivative[pixel] += d
            reached = 2 * ((image - image.mean()) * (derivative - derivative.mean())).mean()
            ratios.append(abs(reached - float(exact.gradient[0])) / bound)
    print(f"reached/bound: median {np.median(ratios):.2f}, max {max(ratios):.3f}")
    assert max(ratios) <= 1
    assert np.median(ratios) > 0.4


# -------------------------------------------------------------------- parts


def test_dt_error_holds_and_is_reached(rng):
    worst = 0.0
    for _ in range(300):
        config = random_config(rng)
        (t, _, _), batch, _ = random_batch(rng, config, n=40)
        dt = scaled_times(t, *batch)
        raw = np.array([integer_dt(config, t_k, *batch) for t_k in integers(t)])
        ratio = np.abs(config.formats.dt.real(raw) - dt.numpy()) / dt_error(config, dt).numpy()
        assert ratio.max() <= 1
        worst = max(worst, ratio.max())
    assert worst > 0.95


def test_position_error_holds_and_is_reached(rng):
    low, high = inf, -inf
    for _ in range(300):
        config = random_config(rng)
        (t, x, _), batch, (v, _) = random_batch(rng, config, n=40)
        dt = scaled_times(t, *batch)
        raw = [
            integer_position(config, x_k, integer_dt(config, t_k, *batch), v)
            for t_k, x_k in zip(integers(t), integers(x), strict=True)
        ]
        error = np.array(raw) * 2.0**-config.position_frac - warp(x, x, dt, (config.formats.v.real(v), 0.0))[0].numpy()
        below, above = (b.numpy() for b in position_error(config, dt, config.formats.v.real(v)))
        assert (error >= -below - 1e-12).all() and (error <= above + 1e-12).all()
        if v:
            low, high = min(low, (error / below).min()), max(high, (error / above).max())
        else:
            assert not below.any() and not above.any() and not error.any()
    assert low < -0.9 and high > 0.9


def test_only_an_event_that_may_cross_a_grid_line_gets_the_jump():
    """The floor moves down by up to 2^-8 px: 6 + 2^-9 may land in the cell of 5, 6 − 2^-9 and 5.5 stay in theirs."""
    config = Config(roi_width=16, roi_height=16, buffer_events=8)

    def bound(position):  # of two events; the second one from 5 to `position`
        return float(gradient_bound(config, [5, 5], [5, 5], np.array([-0.37, (5 - position) / 2]), (2.0, 0.0))[0])

    assert bound(6 + 2**-9) > 20 * bound(6 - 2**-9)
    assert bound(6 - 2**-9) < 3 * bound(5.5)


def test_nothing_is_floored_where_the_product_is_coarse():
    """dt·v in eighths of a pixel needs no rounding to 1/256; at v = 1/4096 it does."""
    config = Config(dt_frac=3)
    below, above = position_error(config, [0.5], 1.0)
    assert below == above > 0
    below, above = position_error(config, [0.5], 2.0**-12)
    assert float(below - above) == pytest.approx(2.0**-8 - 2.0**-15)


def test_no_events():
    config = Config()
    assert gradient_bound(config, [], [], [], (1.0, 0.5)).tolist() == [config.formats.gradient.step] * 2
    assert position_error(config, [], 1.0)[0].shape == (0,)


def test_bound_is_infinite_where_the_gradient_may_saturate():
    fits = Config(roi_width=2, roi_height=2, buffer_events=64)
    narrow = fits.replace(gradient_int=1)
    events = [0] * 64, [0] * 64, np.full(64, 0.3)
    assert np.isfinite(gradient_bound(fits, *events, (0.5, 0.0)).numpy()).all()
    assert gradient_bound(narrow, *events, (0.5, 0.0))[0] == inf


@pytest.mark.parametrize("v", [0.3, 40.0])
def test_v_must_be_the_hardwares(v):
    with pytest.raises(ConfigError, match=r"format Q5\.12"):
        gradient_bound(Config(), [1], [1], [0.5], (0.0, v))


@pytest.mark.parametrize(("width", "height"), SIZES)
@pytest.mark.parametrize("eta", [0.0, 1.0, 0.37, 63.9])
def test_gain_error(width, height, eta):
    config = Config(roi_width=width, roi_height=height, eta=eta)
    square = (width * height) ** 2
    rho = Fraction(square, 1 << (square.bit_length() - 1))
    # Python's ceil(x − 1/2) rounds half down, the hardware half up: no tie occurs in these cases.
    mantissa = ceil(Fraction(1 << 16) / rho - Fraction(1, 2))
    eta_raw = ceil(Fraction(eta) * 1024 - Fraction(1, 2))
    gain = Fraction(ceil(Fraction(eta_raw * mantissa, 256) - Fraction(1, 2)), 1 << 18)
    expected = abs(float(gain * rho / Fraction(eta) - 1)) if eta else 0.0
    assert gain_error(config) == pytest.approx(expected, rel=1e-9)
    assert gain_error(config) <= 2.0**-11 / (eta or 1) + 2.0**-15
    if rho == 1 and eta in (0.0, 1.0):
        assert gain_error(config) == 0
