"""Bilinear voter against its model: weights, derivatives, bank and address of each corner, corners outside dropped."""

import numpy as np
import pytest

from cmfpga.reference.integer.image import voter
from cmfpga.rtl.image.voter import BilinearVoter
from support.bench import GAPS, check_latency, flow_script, play
from support.configs import CONFIGS, LEVELS
from support.values import edge_integers, random_gaps, shape_range, tensor
from support.votes import vote_payloads

SHAPES = CONFIGS | LEVELS


def limits(config):
    """Ranges of x', y' that :class:`Warp` can give, and of dt."""
    frac, one = config.position_frac, 1 << config.dt_frac
    sizes = config.roi_width, config.roi_height
    return [*((-2 << frac, ((size + 1) << frac) - 1) for size in sizes), (-one, one)]


def check(config, iterations, probability=0.0, seed=0):
    """Iterations of (level, x, y, dt): the level changes while no event is in flight, as soon as it may.

    Otherwise there are only random levels, so that one that is used too early or too late is found. The data of a bank
    that got no vote mean nothing. Returns which corners vote, of each iteration.
    """
    rng = np.random.default_rng(seed)
    block = BilinearVoter(config)
    top = shape_range(block.level.shape())[1]
    script, pushed, expected, inside = [], [], [], []
    for level, x, y, dt in iterations:
        votes = voter(config, tensor(x), tensor(y), tensor(dt), level)
        last = rng.integers(0, 2, len(x)).tolist()
        expected += zip(vote_payloads(config, votes), last, strict=True)
        inside.append(votes.inside)
        items = [dict(zip(("x", "y", "dt", "last"), item, strict=True)) for item in zip(x, y, dt, last, strict=True)]
        part, cycles = flow_script(block, items, random_gaps(rng, len(items), probability), rng, drain=0)
        idle = [{} for _ in range(block.latency - 1)]
        for cycle in [*part[cycles[0] :], *idle]:
            cycle["level"] = level
        pushed += [len(script) + cycle for cycle in cycles]
        script += [*part, *idle]
        if rng.random() < 0.5:
            script += [{"level": int(rng.integers(top, endpoint=True))} for _ in range(rng.integers(1, 4))]
    recording = play(block, [*script, *[{}] * 6])
    for number, (value, wanted) in enumerate(zip(recording.values(), expected, strict=True)):
        came = [bank if bank["valid"] else None for bank in value["banks"]], value["last"]
        assert came == wanted, f"event {number}"
    check_latency(block, pushed, recording)
    return inside


def random_positions(config, level, rng, count):
    """Anywhere, around the borders of the level's image above all, with fractions at their ends."""
    frac, columns = config.position_frac, []
    *ranges, times = limits(config)
    for (low, high), size in zip(ranges, config.geometry.level_size(level), strict=True):
        cell = rng.integers(low >> frac, high >> frac, count, endpoint=True)
        border = rng.choice([-2, -1, 0, 1, size - 2, size - 1, size, size + 1], count)
        place = np.where(rng.random(count) < 0.6, border, cell) << frac
        place += edge_integers(rng, 0, (1 << frac) - 1, count)
        uniform = edge_integers(rng, low, high, count)
        columns.append(np.clip(np.where(rng.random(count) < 0.2, uniform, place), low, high).tolist())
    return *columns, edge_integers(rng, *times, count).tolist()


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("name", SHAPES)
def test_matches_model(name, gap, rng):
    """Every change from one level to another, in iterations of a few events."""
    config = SHAPES[name]
    levels = [level for a in range(config.max_level + 1) for b in range(config.max_level + 1) for level in (a, b)]
    count = max(8, 150 // len(levels))
    check(config, [(level, *random_positions(config, level, rng, count)) for level in levels], GAPS[gap], len(levels))


@pytest.mark.parametrize("name", ["narrow", "odd", "tiny", *LEVELS])
def test_every_border_cell(name):
    """Around all four borders and corners of every level: exactly the corners inside vote, each in its bank."""
    config = SHAPES[name]
    half = 1 << (config.position_frac - 1)
    iterations, wanted = [], []
    for level in range(config.max_level + 1):
        size = [-(-size // (1 << level)) for size in (config.roi_width, config.roi_height)]
        xs, ys = ([-2, -1, 0, 1, s - 2, s - 1, s] for s in size)
        cells = [(column, row) for row in ys for column in xs]
        raw = [[(place << config.position_frac) + half for place in axis] for axis in zip(*cells, strict=True)]
        iterations.append((level, *raw, [1 << config.dt_frac] * len(cells)))
        # The model's own number of votes, counted another way.
        inside = [
            [sum(0 <= at + near < s for near in (0, 1)) for at in axis] for axis, s in ((xs, size[0]), (ys, size[1]))
        ]
        wanted.append([across * down for down in inside[1] for across in inside[0]])
    assert [votes.sum(-1).tolist() for votes in check(config, iterations)] == wanted


def test_halves_round_up():
    """Products that lie exactly between two raw values, of both signs."""
    config = CONFIGS["default"].replace(weight_frac=4, derivative_frac=3, position_frac=4, dt_frac=4)
    pairs = [(fx, fy) for fx in range(16) for fy in range(16)]
    weights = [a * b for fx, fy in pairs for a in (fx, 16 - fx) for b in (fy, 16 - fy)]
    assert any(product % 16 == 8 for product in weights)
    x, y = [80 + fx for fx, _ in pairs], [96 + fy for _, fy in pairs]
    check(config, [(0, x, y, [dt] * len(pairs)) for dt in (16, -16, 8, -8, 1, -1, 0)])
