"""Gradient against its model: exact at every bound of the sums."""

import itertools

import numpy as np
import pytest

from cmfpga.config import Config, preset
from cmfpga.reference.integer.image import Sums, gradient
from cmfpga.rtl.ascent.gradient import Gradient
from support.bench import play
from support.configs import CONFIGS
from support.values import edge_integers, random_value

SHAPES = {
    **CONFIGS,
    # Of whole cells ΣD = 0, and takes nothing; P a power of two, and not.
    "whole": preset("fast").replace(ascent="constant"),
    "whole, 60×40": preset("fast").replace(roi_width=60, roi_height=40),
    # As wide as the exact model allows.
    "widest": Config(roi_width=64, roi_height=64, buffer_events=1 << 14, weight_frac=8, derivative_frac=8),
}


def bounds(config):
    sum_d_max = config.widths.sum_d_max if config.border != "whole" else 0
    ends = [sum_d_max] * 2 + [config.widths.s_max] * 2
    return [(0, config.widths.sum_i_max), *((-most, most) for most in ends)]


def check(config, items, spacing=None, seed=0):
    """Each item's plain sums stand from ``lead`` cycles before its ``valid`` on, Sx and Sy only with it.

    Where items come every ``lead`` cycles, the plain sums of the next stand there already in the cycle of ``valid``.
    """
    block = Gradient(config)
    rng = np.random.default_rng(seed)
    valid = np.cumsum(spacing or [block.lead] * len(items)).tolist()
    script = [{"i.payload": random_value(block.i.payload.shape(), rng)} for _ in range(valid[-1] + block.latency + 5)]
    for sums, at in zip(items, valid, strict=True):
        for cycle in script[at - block.lead : at + 1]:
            cycle["i.payload"] |= {"i": sums.i, "dx": sums.dx, "dy": sums.dy}
        script[at]["i.valid"] = 1
        script[at]["i.payload"] |= dict(zip(("sx", "sy"), sums.s, strict=True))
    recording = play(block, script)
    assert recording.values() == [dict(zip("xy", gradient(config, sums), strict=True)) for sums in items]
    assert [out - into for out, into in zip(recording.cycles(), valid, strict=True)] == [block.latency] * len(items)
    return recording


@pytest.mark.parametrize("name", SHAPES)
def test_matches_model(name, rng):
    config = SHAPES[name]
    columns = (edge_integers(rng, low, high, 60).tolist() for low, high in bounds(config))
    items = [Sums(*values[:3], values[3:]) for values in zip(*columns, strict=True)]
    check(config, items, rng.integers(Gradient.lead, 9, 60).tolist())


@pytest.mark.parametrize("name", SHAPES)
def test_exact_at_the_bounds(name):
    """Every combination of the sums' extremes: G reaches ±g_max and its width holds it."""
    config = SHAPES[name]
    extremes = [sorted({low, 0, high}) for low, high in bounds(config)]
    # y takes the opposite of x, which halves the number of combinations without losing one.
    items = [Sums(i, dx, -dx, (sx, -sx)) for i, dx, sx in itertools.product(extremes[0], extremes[1], extremes[3])]
    came = [value for item in check(config, items).values() for value in item.values()]
    assert max(came) == config.widths.g_max and min(came) == -config.widths.g_max
