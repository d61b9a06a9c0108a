"""Dither and coarse levels in float64: against loops, and the integer model against them."""

from math import floor

import numpy as np
import pytest
import torch

from cmfpga.config import preset
from cmfpga.config.dither import DITHER_BITS, FACTORS
from cmfpga.reference.floating import R2, dither, evaluate, level_size, scaled_times
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.reference.integer.event_path import dither as integer_dither
from cmfpga.reference.integer.event_path import time_scaler

#: Formats so wide that the integer model has next to nothing to round.
WIDE = preset("fast").replace(
    roi_width=48, roi_height=36, buffer_events=1024, dt_frac=14, v_frac=14, position_frac=12, weight_frac=14,
    derivative_frac=14, dither_frac=8, reciprocal_bits=17,
)  # fmt: skip


def moving_object(rng, v, n=600, width=48, height=36):
    """Times (µs) and whole pixels of ``n`` events of points that move at ``v`` px per half batch, and of noise."""
    t = np.sort(rng.integers(0, 20_000, n))
    t[0], t[-1] = 0, 20_000
    dt = scaled_times(t, 0, 20_000).numpy()
    points = rng.uniform((14, 12), (width - 14, height - 12), (40, 2))
    at = points[rng.integers(len(points), size=n)] + dt[:, None] * v
    noise = rng.random(n) < 0.1
    at[noise] = rng.uniform(0, (width - 1, height - 1), (noise.sum(), 2))
    x, y = np.clip(np.floor(at + 0.5), 0, (width - 1, height - 1)).astype(np.int64).T
    return t, x, y


def test_the_constants_are_those_of_r2():
    g = 1.3247179572447460
    assert g**3 == pytest.approx(g + 1, abs=1e-15)
    assert pytest.approx((1 / g, 1 / g**2), abs=1e-15) == R2


def test_dither_is_the_sequence_written_as_a_loop():
    x, y = dither(300)
    assert x.dtype == y.dtype == torch.float64
    for k in range(300):
        for axis, alpha in ((x, 0.7548776662466927), (y, 0.5698402909980532)):
            product = (k + 0.5) * alpha
            assert float(axis[k]) == pytest.approx(product - floor(product) - 0.5, abs=1e-12)
    assert [len(axis) for axis in dither(0)] == [0, 0]


def test_dither_covers_the_pixel_evenly():
    x, y = dither(4096)
    assert float(x.min()) >= -0.5 and float(x.max()) < 0.5
    counts, *_ = np.histogram2d(x, y, bins=8, range=[[-0.5, 0.5]] * 2)
    assert counts.min() >= 56 and counts.max() <= 72  # 64 each; random offsets scatter from about 42 to 86


@pytest.mark.parametrize("frac", [0, 1, 4, 8])
def test_the_hardwares_dither_is_this_one_floored(frac):
    """Apart from its α, which has 24 fraction bits: half a unit off at most, times k."""
    none = torch.zeros(2000, dtype=torch.int64)
    config = WIDE.replace(dither_frac=frac)
    for exact, raw, factor, alpha in zip(dither(2000), integer_dither(config, none, none), FACTORS, R2, strict=True):
        assert abs(factor - alpha * (1 << DITHER_BITS)) <= 0.5
        below = exact - raw / (1 << frac) if frac else raw  # without dither nothing is added
        units = exact * (1 << frac)
        near = (units - units.round()).abs() < 0.05  # where 24 bits decide about the floor
        assert bool(((below >= 0) & (below < 1 / (1 << frac)))[~near].all()) and near.sum() < 300
        assert not frac or (int(raw.min()), int(raw.max())) == (-(1 << frac) // 2, (1 << frac) // 2 - 1)


@pytest.mark.parametrize("level", [0, 1, 2, 3])
def test_images_sum_to_the_votes_inside(level, rng):
    """Events away from the border count fully at every level; those far outside not at all."""
    x, y, dt = rng.integers(8, 24, 70), rng.integers(8, 24, 70), rng.uniform(-1, 1, 70)
    inside = evaluate(x, y, dt, (2.3, -1.1), width=32, height=32, level=level)
    assert float(inside.sum_i) == pytest.approx(70, abs=1e-11)
    assert inside.sum_d.tolist() == pytest.approx([0, 0], abs=1e-11)
    assert inside.derivative_x.abs().sum() > 1
    assert inside.image[level_size(32, level) :].abs().sum() + inside.image[:, level_size(32, level) :].abs().sum() == 0
    assert float(evaluate(x, y, dt * 0 + 1, (200.0, 0.0), width=32, height=32, level=level).sum_i) == 0


def test_a_coarse_pixel_covers_its_fine_ones():
    """The middle of the first 2^level pixels is the middle of the first coarse one."""
    for level in range(4):
        middle = ((1 << level) - 1) / 2
        image = evaluate([middle], [middle], [0.5], (0.0, 0.0), width=16, height=16, level=level).image
        assert float(image[0, 0]) == 1.0 == float(image.sum())


def compare(config, rng, batches=12, tiny=0.06):
    """(signs of G that differ though |G| is not tiny, signs compared, largest difference), near the motion and off it.

    At each velocity of the integer model the reference takes the exact dither. Its arithmetic is judged stage by stage
    in ``test_integer_against_float.py``. A tiny G is a share of the terms that G is the difference of.
    """
    wrong = compared = 0
    worst = 0.0
    unit, core = 2.0 ** -(config.weight_frac + config.derivative_frac), IntegerCore(config)
    for _ in range(batches):
        motion = rng.uniform(-6, 6, 2)
        t, x, y = (torch.from_numpy(column) for column in moving_object(rng, motion))
        span, size = int(t[-1]), {"width": 48, "height": 36, "border": config.border}
        raw = *integer_dither(config, x, y), time_scaler(config, t, span=span)
        exact = [axis.double() + offset for axis, offset in zip((x, y), dither(len(t)), strict=True)]
        for k in range(20):
            real_v = motion * (k / 20) + rng.uniform(-1, 1, 2)
            v, level = [int(axis * (1 << config.v_frac)) for axis in real_v], k % 3
            _, _, found = core.evaluate(*raw, v, level)
            real_v = [config.formats.v.real(axis) for axis in v]
            it = evaluate(*exact, scaled_times(t, 0, span), real_v, level=level, **size)
            centred = (it.image - it.image.mean()).abs()
            for got, g, d in zip(found, it.g, (it.derivative_x, it.derivative_y), strict=True):
                scale = float(config.geometry.pixels * (centred * (d - d.mean()).abs()).sum())
                worst = max(worst, abs(got * unit - float(g)) / scale)
                if abs(float(g)) > tiny * scale:
                    compared += 1
                    wrong += (got > 0) != (float(g) > 0)
    return wrong, compared, worst


def test_with_wide_formats_the_model_is_the_reference(rng):
    """With dither of 8 bits, floored: 1/512 px on average. Without dither the comparison fails."""
    wrong, compared, worst = compare(WIDE, rng)
    print(f"largest difference {worst:.5f}; {compared} signs compared")
    assert wrong == 0 and compared > 250
    assert worst < 0.06
    assert compare(WIDE.replace(dither_frac=0), rng)[2] > 0.1
