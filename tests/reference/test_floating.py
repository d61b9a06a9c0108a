"""The float64 reference against autograd and the article's equations written as loops."""

import numpy as np
import pytest
import torch

from cmfpga.reference import floating
from cmfpga.reference.float_core import ascend
from support.equations import transcription
from support.mutation import mutated

SIZES = [(2, 2), (8, 8), (16, 6), (6, 16), (30, 22), (7, 5), (1, 9)]


def random_events(rng, width, height, n):
    """Events (x, y, dt): some on the ROI's corners and edges, some between pixels, and every dt in [−1, 1]."""
    x, y = rng.integers(width, size=n).astype(float), rng.integers(height, size=n).astype(float)
    border = rng.random(n) < 0.2
    x[border] = rng.choice([0, width - 1], border.sum())
    dithered = rng.random() < 0.5
    if dithered:
        x, y = x + rng.uniform(-0.5, 0.5, n), y + rng.uniform(-0.5, 0.5, n)
    dt = rng.uniform(-1, 1, n)
    if n > 1:
        dt[0], dt[-1] = -1, 1
    return x, y, dt


def random_velocity(rng, width, height):
    """Mostly within the ROI's size, sometimes so large that most events are warped outside."""
    return rng.uniform(-1, 1, 2) * (width, height) * rng.choice([0.1, 0.5, 3])


def interior_events(rng, n=50, width=20, height=12):
    """Events that stay 2 px away from the border for |v| ≤ 2."""
    return rng.integers(4, width - 4, n), rng.integers(4, height - 4, n), rng.uniform(-1, 1, n)


# -------------------------------------------------------------------- equations as loops


def check_equations(module, rng, cases=8, levels=(0, 1, 2, 3)):
    """``module``'s evaluate equals the transcription on random events of every size, dithered or not."""
    close = {"rtol": 1e-12, "atol": 1e-11}
    for width, height in SIZES:
        for level in levels:
            for _ in range(cases):
                x, y, dt = random_events(rng, width, height, int(rng.integers(1, 20)))
                v = random_velocity(rng, width, height)
                image, d_x, d_y, c, grad = transcription(x, y, dt, v, width, height, level)
                it = module.evaluate(x, y, dt, v, width=width, height=height, level=level)
                for got, wanted in (
                    (it.image, image), (it.derivative_x, d_x), (it.derivative_y, d_y), (it.contrast, c),
                    (it.gradient, grad), (it.sum_i, image.sum()), (it.sum_d, (d_x.sum(), d_y.sum())),
                    (it.s, ((image * d_x).sum(), (image * d_y).sum())), (2 * it.g / (width * height) ** 2, grad),
                ):  # fmt: skip
                    np.testing.assert_allclose(got, wanted, **close)


def test_equations_as_loops(rng):
    check_equations(floating, rng)


MUTANTS = {
    "warp with the other sign": ("x - dt * v[0]", "x + dt * v[0]"),
    "y warped by vx": ("y - dt * v[1]", "y - dt * v[0]"),
    "derivative with the other sign": ("(votes.pixel, -dt * votes.by_x", "(votes.pixel, dt * votes.by_x"),
    "Dy from ∂w/∂x": ("-dt * votes.by_y", "-dt * votes.by_x"),
    "a corner's weight of another": ("dx * dy))", "dx * (1 - dy)))"),
    "a whole cell dropped at the border": ("(columns < width)", "(i + 1 < width)"),
    "a column wraps into the next row": ("(columns < width) & ", ""),
    "rows as wide as high": ("rows * width + columns", "rows * height + columns"),
    "without ∂μ/∂v and I's mean": ("centred * (d - d.mean())", "image * d"),
    "sample variance": (".square().mean()", ".var() * 1"),
    "contrast of the raw image": ("(image - image.mean()).square()", "image.square()"),
    "G without its second term": ("pixels * s - sum_i * sum_d", "pixels * s"),
}


@pytest.mark.parametrize("mutant", MUTANTS)
def test_transcription_notices(mutant, rng):
    """The comparison above is worth something only if it fails for wrong equations."""
    module = mutated(floating, *MUTANTS[mutant])
    with pytest.raises((AssertionError, IndexError)):  # an address beyond the image shows as well
        check_equations(module, rng, cases=2, levels=(0, 1))


# -------------------------------------------------------------------- gradient


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize(("width", "height"), SIZES)
def test_gradient_equals_autograd(width, height, level, rng):
    """By v in pixels of the level, so 2^level times that by v."""
    size = [floating.level_size(width, level), floating.level_size(height, level)]
    for _ in range(40 if level else 150):  # 1050 cases over all sizes, and 560 at levels
        x, y, dt = (torch.from_numpy(a) for a in random_events(rng, width, height, int(rng.integers(1, 60))))
        v = torch.from_numpy(random_velocity(rng, width, height)).requires_grad_()
        image = floating.iwe(*(floating.at_level(position, level) for position in floating.warp(x, y, dt, v)), *size)
        c = floating.contrast(torch.nn.functional.pad(image, (0, width - size[0], 0, height - size[1])))
        (auto,) = torch.autograd.grad(c, v)
        it = floating.evaluate(x, y, dt, v.detach(), width=width, height=height, level=level)
        # Where the terms cancel, ∇C is nothing but rounding: 1e-15 is that of sums of order 1.
        error = float((it.gradient - auto * 2**level).norm() - (1e-12 if level else 1e-15))
        assert error <= 1e-9 * float(auto.norm())
        torch.testing.assert_close(it.contrast, c.detach(), rtol=1e-12, atol=0)


# -------------------------------------------------------------------- images


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [
        (1.25, 1.0, {(1, 1): 0.75, (2, 1): 0.25}),
        (-0.25, 1.5, {(0, 1): 0.375, (0, 2): 0.375}),  # left corners outside
        (2.75, 0.0, {(2, 0): 0.25}),  # right ones
        (-0.5, -0.5, {(0, 0): 0.25}),  # three
        (2.5, 3.5, {(2, 3): 0.25}),
        (-1.0, 1.0, {}),
        (3.0, 1.0, {}),
        (1.0, 4.0, {}),
        (1e300, -1e300, {}),
    ],
)
def test_corners_outside_are_dropped_alone(x, y, expected):
    image = floating.iwe([x], [y], 3, 4)
    assert image.shape == (4, 3)
    got = {(i, j): float(image[j, i]) for j in range(4) for i in range(3) if image[j, i]}
    assert got == expected


def test_signs_of_the_derivatives():
    """An event after t_ref moves left as vx grows: the left pixels gain."""
    d_x, d_y = floating.derivative_images(floating.bilinear_votes([0.25], [0.5], 2, 2), 0.5, 2, 2)
    assert d_x.tolist() == [[0.25, -0.25], [0.25, -0.25]]
    assert d_y.tolist() == [[0.375, 0.125], [-0.375, -0.125]]


@pytest.mark.parametrize("n", [0, 1])
def test_few_events(n):
    it = floating.evaluate([2] * n, [1] * n, [1.0] * n, (0.0, 0.0), width=4, height=4)
    assert it.image.dtype == it.gradient.dtype == torch.float64
    assert it.image.sum() == n
    assert float(it.contrast) == pytest.approx(n / 16 * (1 - 1 / 16))
    assert it.gradient.tolist() == ([0, 0] if n == 0 else pytest.approx([2 / 16, 2 / 16]))
    trace = ascend([2] * n, [1] * n, [1.0] * n, width=4, height=4, v_start=(0.5, 0.25), eta=1.0, iterations=3)
    assert trace.v.shape == (4, 2)
    if n == 0:
        assert trace.v.tolist() == [[0.5, 0.25]] * 4


# -------------------------------------------------------------------- invariances


def test_whole_pixel_translation_changes_nothing(rng):
    x, y, dt = interior_events(rng)
    v = (1.7, -0.6)
    a = floating.evaluate(x, y, dt, v, width=24, height=16)
    b = floating.evaluate(x + 3, y + 2, dt, v, width=24, height=16)
    torch.testing.assert_close(b.image[2:, 3:], a.image[:-2, :-3])
    torch.testing.assert_close(b.contrast, a.contrast)
    torch.testing.assert_close(b.gradient, a.gradient)
    other = floating.evaluate(x + 1 - 0.5, y, dt, v, width=24, height=16)  # half a pixel does change it
    assert abs(float(other.contrast - a.contrast)) > 1e-3


def test_time_reversal_flips_v(rng):
    t = np.sort(rng.integers(1000, 90000, 40))
    x, y, _ = interior_events(rng, 40)
    forth = floating.scaled_times(t, t[0], t[-1])
    back = floating.scaled_times(t[0] + t[-1] - t[::-1], t[0], t[-1])
    v = np.array([1.1, -0.7])
    a = floating.evaluate(x, y, forth, v, width=20, height=12)
    b = floating.evaluate(x[::-1], y[::-1], back, -v, width=20, height=12)
    torch.testing.assert_close(a.image, b.image)
    torch.testing.assert_close(a.gradient, -b.gradient)
    up, down = (
        ascend(*events, width=20, height=12, v_start=start, eta=0.05, iterations=5)
        for events, start in (((x, y, forth), v), ((x[::-1], y[::-1], back), -v))
    )
    torch.testing.assert_close(up.v, -down.v)
    assert not torch.equal(up.v[0], up.v[-1])


def test_swapping_the_axes_swaps_the_gradient(rng):
    x, y, dt = random_events(rng, 9, 6, 30)
    a = floating.evaluate(x, y, dt, (0.7, -1.9), width=9, height=6)
    b = floating.evaluate(y, x, dt, (-1.9, 0.7), width=6, height=9)
    torch.testing.assert_close(a.image, b.image.T)
    torch.testing.assert_close(a.gradient, b.gradient.flip(0))


# -------------------------------------------------------------------- time


def test_dt_spans_the_whole_batch(rng):
    t = np.sort(rng.integers(10**6, 2 * 10**6, 500))
    in_roi = rng.random(500) < 0.2
    in_roi[[0, -1]] = False
    assert t[in_roi][0] > t[0] and t[in_roi][-1] < t[-1]
    everything = floating.scaled_times(t, t[0], t[-1])
    assert everything.dtype == torch.float64
    assert (float(everything[0]), float(everything[-1])) == (-1.0, 1.0)
    roi = floating.scaled_times(t[in_roi], t[0], t[-1])
    assert torch.equal(roi, everything[torch.from_numpy(in_roi)])  # not stretched to its own first and last event
    t_ref, half = t[0] + (t[-1] - t[0]) / 2, (t[-1] - t[0]) / 2
    np.testing.assert_allclose(roi, (t[in_roi] - t_ref) / half, rtol=1e-13, atol=1e-15)


def test_dt_is_exact_for_huge_time_stamps():
    start = (1 << 62) + 1
    t = np.array([start, start + 1, start + 2, start + 3, start + 4])
    assert floating.scaled_times(t, start, start + 4).tolist() == [-1.0, -0.5, 0.0, 0.5, 1.0]


def test_dt_of_a_batch_without_duration_and_of_none():
    assert floating.scaled_times([7, 7], 7, 7).tolist() == [0.0, 0.0]
    assert floating.scaled_times([], 3, 9).shape == (0,)
    assert floating.scaled_times(np.zeros(0, np.int64), 3, 9).dtype == torch.float64


@pytest.mark.parametrize("t", [[4, 5], [5, 10]])
def test_dt_refuses_times_outside_the_batch(t):
    with pytest.raises(ValueError, match="outside the batch, 5 to 9"):
        floating.scaled_times(t, 5, 9)


def test_only_float64_is_accepted():
    with pytest.raises(TypeError, match="float32"):
        floating.warp(np.zeros(2, np.float32), [1, 2], [0.0, 0.0], (0.0, 0.0))
    with pytest.raises(TypeError, match="float32"):
        floating.evaluate([1.0], [1.0], [0.0], torch.zeros(2), width=4, height=4)
    with pytest.raises(TypeError, match="integer"):
        floating.scaled_times([0.5], 0, 1)
    x, _ = floating.warp(np.array([3], np.uint16), [0.1], [0.1], (0.3, 0.0))
    assert float(x) == 3 - 0.1 * 0.3  # Python numbers never pass through float32


# -------------------------------------------------------------------- ascent


def moving_points(rng, v, points=12, per_point=15):
    """Points that stand on pixels of a 40 × 32 ROI at t_ref and move at ``v``: events (x, y, dt) between pixels."""
    at = np.stack((rng.permutation(np.arange(8, 32))[:points], rng.permutation(np.arange(8, 24))[:points]))
    t = np.sort(rng.integers(0, 50_000, points * per_point))
    dt = floating.scaled_times(t, t[0], t[-1]).numpy()
    position = at[:, rng.integers(points, size=len(t))]
    return position[0] + dt * v[0], position[1] + dt * v[1], dt


@pytest.mark.parametrize("truth", [(3.0, -2.0), (-5.5, 0.75), (0.0, 4.0)])
def test_ascent_finds_the_motion(truth, rng):
    x, y, dt = moving_points(rng, truth)
    start = np.add(truth, (0.4, -0.3))
    trace = ascend(x, y, dt, width=40, height=32, v_start=start, eta=0.02, iterations=100)
    assert trace.v.shape == (101, 2) and trace.contrast.shape == (100,) and trace.gradient.shape == (100, 2)
    assert trace.v[0].tolist() == start.tolist()
    assert float(trace.contrast[-1]) > 1.5 * float(trace.contrast[0])
    # At the truth C has a cusp, around which a constant step swings by up to η·|∇C|.
    swing = 0.02 * float(trace.gradient.abs().max())
    assert float((trace.v[-1] - torch.tensor(truth)).abs().max()) < swing + 1e-6


def test_ascent_repeats_evaluate(rng):
    x, y, dt = random_events(rng, 12, 9, 40)
    trace = ascend(x, y, dt, width=12, height=9, v_start=(0.5, 0.25), eta=0.75, iterations=6)
    for k in range(6):
        it = floating.evaluate(x, y, dt, trace.v[k], width=12, height=9)
        assert torch.equal(it.gradient, trace.gradient[k]) and torch.equal(it.contrast, trace.contrast[k])
        assert torch.equal(it.gradient, floating.gradient(it.image, it.derivative_x, it.derivative_y))
        assert torch.equal(trace.g[k], it.g)
        assert torch.equal(trace.v[k + 1], trace.v[k] + 0.75 * it.gradient)  # Eq. v_update
    none = ascend(x, y, dt, width=12, height=9, v_start=(0.5, 0.25), eta=0.75, iterations=0)
    assert none.v.tolist() == [[0.5, 0.25]] and len(none.contrast) == 0
