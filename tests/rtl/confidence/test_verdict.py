"""The verdict against the comparison that it makes, in its cycle."""

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.protocol.confidence import Curvature, contrast, is_trusted
from cmfpga.rtl.confidence import verdict
from support.bench import play
from support.mutation import break_blocks

CONFIG = preset("fast").replace(
    sensor_width=40, sensor_height=30, roi_width=16, roi_height=12, buffer_events=48, tag_bits=5
)


def cases(config, rng, count):
    widths, pixels = config.widths, config.geometry.pixels
    for _ in range(count):
        n, limit = int(rng.integers(1, config.buffer_events + 1)), int(rng.choice([0, 1, 90, 1023]))
        sum_i = int(rng.integers(widths.sum_i_max + 1) >> rng.integers(4))
        squares = sum_i**2 // pixels + int(rng.integers(1, 2 ** int(rng.integers(1, 12))))
        by_n, by_limit = widths.judge_scales
        size = by_limit * limit * (pixels * squares - sum_i**2) // (by_n * n) + int(rng.integers(0, 9))
        xx, yy = (int(size * rng.uniform(0.8, 3)) for _ in "xy")
        mixed = int(rng.uniform(-0.7, 0.7) * size)
        if rng.random() < 0.3:  # anything
            xx, yy, mixed = (int(rng.integers(-widths.g_max // 4, widths.g_max // 4)) for _ in range(3))
        if rng.random() < 0.1:  # as large as can be
            xx, yy, mixed = (2 * widths.g_max * rng.choice([-1, 1], 3) * [1, 1, 2]).tolist()
        # Of whole cells G is P·S: its lowest bits are those of P.
        yield n, limit, sum_i, squares, Curvature(*(one >> widths.g_zeros << widths.g_zeros for one in (xx, yy, mixed)))


def expected(config, many):
    for n, limit, sum_i, squares, shape in many:
        yield int(not is_trusted(config, n, limit, shape, contrast(config.geometry.pixels, (sum_i,), squares)))


def decided(config, many):
    block, script = verdict.Verdict(config), []
    for n, limit, sum_i, squares, shape in many:
        given = {"sum_i": sum_i, "squares": squares, "events": n, "limit": limit, "curvature": shape._asdict()}
        script += [{"begin": 1, **given}, *[{}] * (block.latency + 3)]
    watched = play(block, script, flows=(), watch=("done", "doubtful")).watch
    done = [cycle for cycle, value in enumerate(watched["done"]) if value]
    assert done == [block.latency + k * (block.latency + 4) for k in range(len(many))]
    return [watched["doubtful"][cycle + 1] for cycle in done]


VERDICTS = {
    "fast": CONFIG,
    "fractions": CONFIG.replace(weight_frac=3, derivative_frac=6),
    "finer weights": CONFIG.replace(weight_frac=6),
    "ΣI in two pieces": CONFIG.replace(buffer_events=9000, tag_bits=5),
}


@pytest.mark.parametrize("name", VERDICTS)
def test_the_verdict_is_the_models(name, rng):
    config = VERDICTS[name]
    many = list(cases(config, rng, 200))
    wanted = [*expected(config, many)]
    assert 0.2 < np.mean(wanted) < 0.8 and decided(config, many) == wanted


@pytest.mark.parametrize("old, new", [
    ('kept["yy"], by_n, 0', 'kept["xx"], by_n, 0'), ('kept["cross"], by_n', 'kept["xx"], by_n'),
    ("total << 2", "total << 1"), ("Cat(total[-1], a[-1] | ~a_some)", "total[-1]"),
    ("Cat(total[-1], a[-1] | ~a_some)", "a[-1] | ~a_some"),
    ("(b_low, b_low, 1, SUM)", "(b_low, b_low, 0, SUM)"), ("(a_low, c_high, 0, SUM)", "(a_low, c_low, 0, SUM)"),
    ("(a_low, c_low, 0, SHIFTED)", "(a_low, c_low, 0, SUM)"),
    ("pixels - total", "pixels"),
    ("due & ~(fills[by] | full(contrast, by))", "due & ~fills[by]"),
    ("due & ~(fills[by] | full(contrast, by))", "due & ~full(contrast, by)"),
    ("known.eq(full(curvatures, by, moved))", "known.eq(full(curvatures, by))"), ("value << by", "value << 1"),
])  # fmt: skip
def test_another_verdict_would_be_noticed(old, new, rng, monkeypatch):
    break_blocks(monkeypatch, verdict, old, new)
    many = list(cases(CONFIG, rng, 300))
    assert decided(CONFIG, many) != [*expected(CONFIG, many)]
