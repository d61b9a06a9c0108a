"""The judge of motions beyond translation against the comparison that it makes, in its cycle."""

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.protocol.confidence import is_sharp, least_fall
from cmfpga.rtl.confidence import probe
from support.bench import play
from support.mutation import break_blocks

SIZE = {"sensor_width": 40, "sensor_height": 30, "roi_width": 20, "roi_height": 12, "buffer_events": 48, "tag_bits": 5}
CONFIGS = {
    "similarity": preset("similarity").replace(**SIZE),
    "rotation": preset("rotation").replace(**SIZE, ram_style="auto", weight_frac=3, derivative_frac=6),
    "coarse derivatives": preset("similarity").replace(**SIZE, weight_frac=6),
    # n has more bits than the limit.
    "many events": preset("similarity").replace(**SIZE | {"buffer_events": 2047, "tag_bits": 9}),
}


def cases(config, rng, count):
    """``(n, limit, Σ I², v, gradient at v, gradients of the probes)``: any verdict, equality among them."""
    widths, parameters = config.widths, config.motion_model.parameters
    by_n, by_limit = widths.judge_scales
    for _ in range(count):
        n, limit = int(rng.integers(1, config.buffer_events + 1)), int(rng.choice([0, 1, 90, 1023]))
        squares = min(int(2 ** rng.uniform(0, widths.squares_bits)), widths.squares_max)
        v = [int(rng.choice([p.fmt.min, -1, 0, p.fmt.max])) for p in parameters]
        if rng.random() < 0.1:  # as large as can be
            last, *probed = (widths.g_max * rng.choice([-1, 1], (len(v) + 1, len(v)))).tolist()
        else:
            equal = by_limit * limit * squares // (by_n * n)
            last = rng.integers(-widths.g_max // 8, widths.g_max // 8, len(v)).tolist()
            beyond = rng.choice([0, 1, 2, equal + 3] if rng.random() < 0.3 else [1, 2, equal + 3], len(v))
            falls = [min(equal + int(more), widths.g_max // 2) for more in beyond]
            if rng.random() < 0.2:
                falls = rng.integers(-widths.g_max // 4, widths.g_max // 4, len(v)).tolist()
            probed = [
                [g + (-fall if at < 0 else fall) if k == j else int(rng.integers(-99, 99)) for j, g in enumerate(last)]
                for k, (fall, at) in enumerate(zip(falls, v, strict=True))
            ]
        yield n, limit, squares, v, last, probed


def check(block, rng, count=80):
    config = block.config
    names, many = config.motion_model.names, [*cases(config, rng, count)]
    script, wanted = [], []
    for n, limit, squares, v, last, probed in many:
        least = least_fall(v, last, probed)
        script.append({
            "new_batch": 1, "events": n, "limit": limit, "squares": squares, "v": dict(zip(names, v, strict=True)),
            "last": {"i": 1, "dx": 2, "dy": 3} | {f"s{name}": g for name, g in zip(names, last, strict=True)},
        })  # fmt: skip
        for g in probed:
            script += [*[{}] * int(rng.integers(3)), {"i.valid": 1, "i.payload": dict(zip(names, g, strict=True))}]
        wanted.append((len(script) - 1 + block.latency, least, int(not is_sharp(config, n, limit, least, squares))))
        script += [{}] * (block.latency + 2)
    assert 0.1 < np.mean([doubtful for *_, doubtful in wanted]) < 0.9
    watched = play(block, script, flows=(), watch=("done", "curvature", "doubtful")).watch
    done = [cycle for cycle, value in enumerate(watched["done"]) if value]
    assert [(cycle, watched["curvature"][cycle]["least"], watched["doubtful"][cycle + 1]) for cycle in done] == wanted


@pytest.mark.parametrize("name", CONFIGS)
def test_the_verdict_is_the_models(name, rng):
    check(probe.LeastJudge(CONFIGS[name]), rng)


def test_nothing_probed_is_no_curvature_and_no_doubt(rng):
    block = probe.LeastJudge(CONFIGS["similarity"])
    probes = [{"i.valid": 1, "i.payload": dict.fromkeys(block.config.motion_model.names, -5)}] * 4
    script = [{"new_batch": 1, "limit": 9, "squares": 7, "events": 3}, *probes, *[{}] * (block.latency + 1)]
    watched = play(block, [*script, {"new_batch": 1}, {}], flows=(), watch=("curvature", "doubtful")).watch
    assert watched["doubtful"][-2:] == [1, 0] and [one["least"] for one in watched["curvature"][-2:]] == [-5, 0]


@pytest.mark.parametrize("old, new", [
    ("difference <= 0", "difference < 0"), ("first_s1 | (fall", "(fall"), ("fall_s1 < least", "fall_s1 > least"),
    ("Mux(above, last - probed", "Mux(~above, last - probed"), ("least * by_n", "least"),
    ("self.squares * by_limit", "self.squares"), ("left - right", "left"), ("factors[-1] << 1", "factors[-1]"),
    ("came.eq(0)", "came.eq(1)"), ("len(names) - 1", "len(names) - 2"), ("_factor_bits + 1,", "_factor_bits,"),
    ("Mux(start, 0, (difference << 1) + addend)", "(difference << 1) + addend"),
])  # fmt: skip
def test_another_judge_would_be_noticed(old, new, monkeypatch, rng):
    break_blocks(monkeypatch, probe, old, new)
    with pytest.raises(AssertionError):
        check(probe.LeastJudge(CONFIGS["similarity"]), rng)
