"""Bilinear voter against its model: weights, derivatives, bank and address of each corner, corners outside dropped."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cmfpga.reference.integer.voter import voter
from cmfpga.rtl.image.voter import BilinearVoter
from support.bench import GAPS, flow_script, play
from support.configs import CONFIGS, LEVELS
from support.values import corners, edge_integers, integers_at_edges, random_gaps, shape_range, tensor
from support.votes import vote_payloads


def limits(config):
    """Ranges of x', y' that :class:`Warp` can give."""
    frac = config.position_frac
    return [(-2 << frac, ((size + 1) << frac) - 1) for size in (config.roi_width, config.roi_height)]


def check(config, x, y, dt, gaps, last=None):
    """Compare with the model; the data of a bank that got no vote mean nothing."""
    last = [0] * len(x) if last is None else last
    votes = voter(config, tensor(x), tensor(y), tensor(dt))
    expected = vote_payloads(config, votes)
    items = [{"dt": dt, "x": x, "y": y, "last": last} for x, y, dt, last in zip(x, y, dt, last, strict=True)]
    block = BilinearVoter(config)
    script, pushed = flow_script(block, items, gaps, np.random.default_rng(1))
    recording = play(block, script)
    for item, value, wanted in zip(items, recording.values(), expected, strict=True):
        came = [bank if bank["valid"] else None for bank in value["banks"]]
        assert (came, value["last"]) == (wanted, item["last"]), item
    popped = recording.cycles()
    assert [out - into for out, into in zip(popped, pushed, strict=True)] == [block.latency] * len(items)
    return pushed, popped, votes


def random_positions(config, rng, count):
    """Uniform, at the borders, and with fractions at their ends."""
    columns = []
    for low, high in limits(config):
        uniform = edge_integers(rng, low, high, count)
        frac = config.position_frac
        cell = rng.integers(low >> frac, high >> frac, count, endpoint=True)
        fraction = edge_integers(rng, 0, (1 << frac) - 1, count)
        columns.append(np.where(rng.random(count) < 0.3, uniform, (cell << frac) + fraction).tolist())
    one = 1 << config.dt_frac
    return *columns, edge_integers(rng, -one, one, count).tolist()


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("name", CONFIGS)
def test_matches_model(name, gap, rng):
    config = CONFIGS[name]
    count = 150
    last = rng.integers(0, 2, count).tolist()
    check(config, *random_positions(config, rng, count), random_gaps(rng, count, GAPS[gap]), last)


@pytest.mark.parametrize("name", ["narrow", "odd", "tiny"])
def test_every_border_cell(name):
    """Cells around all four borders and corners: exactly the corners inside vote, each in its bank."""
    config = CONFIGS[name]
    frac = config.position_frac
    xs, ys = ([-2, -1, 0, 1, size - 2, size - 1, size] for size in (config.roi_width, config.roi_height))
    cells = [(column, row) for row in ys for column in xs]
    half = 1 << (frac - 1)
    *_, votes = check(
        config,
        [(column << frac) + half for column, _ in cells],
        [(row << frac) + half for _, row in cells],
        [1 << config.dt_frac] * len(cells),
        [0] * len(cells),
    )
    # The model's own number of votes, counted another way.
    wanted = [
        sum(0 <= column + right < config.roi_width for right in (0, 1))
        * sum(0 <= row + down < config.roi_height for down in (0, 1))
        for column, row in cells
    ]
    assert votes.inside.sum(-1).tolist() == wanted


def test_halves_round_up():
    """Products that lie exactly between two raw values, of both signs."""
    config = CONFIGS["default"].replace(weight_frac=4, derivative_frac=3, position_frac=4, dt_frac=4)
    pairs = [(fx, fy) for fx in range(16) for fy in range(16)]
    weights = [a * b for fx, fy in pairs for a in (fx, 16 - fx) for b in (fy, 16 - fy)]
    assert any(product % 16 == 8 for product in weights)
    for dt in (16, -16, 8, -8, 1, -1, 0):
        check(config, [80 + fx for fx, _ in pairs], [96 + fy for _, fy in pairs], [dt] * len(pairs), [0] * len(pairs))


@corners
@given(st.data())
def test_corners(data):
    config = CONFIGS[data.draw(st.sampled_from(["default", "narrow", "tiny", "fine"]))]
    one = 1 << config.dt_frac
    event = st.tuples(*(integers_at_edges(*limit) for limit in limits(config)), integers_at_edges(-one, one))
    events = data.draw(st.lists(event, min_size=20, max_size=40))
    check(config, *(list(column) for column in zip(*events, strict=True)), [0] * len(events))


# ---------------------------------------------------------------- coarse levels


def check_levels(config, iterations, probability=0.0, seed=0):
    """Iterations of (level, x, y, dt): the level changes while no event is in flight, as soon as it may.

    Otherwise there are only random levels, so that one that is used too early or too late is found.
    """
    rng = np.random.default_rng(seed)
    block = BilinearVoter(config)
    top = shape_range(block.level.shape())[1]
    script, pushed, expected, inside = [], [], [], []
    for level, x, y, dt in iterations:
        votes = voter(config, tensor(x), tensor(y), tensor(dt), level)
        expected += vote_payloads(config, votes)
        inside.append(votes.inside)
        items = [{"dt": dt, "x": x, "y": y, "last": 0} for x, y, dt in zip(x, y, dt, strict=True)]
        part, cycles = flow_script(block, items, random_gaps(rng, len(items), probability), rng, drain=0)
        idle = [{} for _ in range(block.latency - 1)]
        for cycle in [*part[cycles[0] :], *idle]:
            cycle["level"] = level
        pushed += [len(script) + cycle for cycle in cycles]
        script += [*part, *idle]
        if rng.random() < 0.5:
            script += [{"level": int(rng.integers(top, endpoint=True))} for _ in range(rng.integers(1, 4))]
    recording = play(block, [*script, *[{}] * 6])
    for value, wanted in zip(recording.values(), expected, strict=True):
        assert [bank if bank["valid"] else None for bank in value["banks"]] == wanted
    popped = recording.cycles()
    assert [out - into for out, into in zip(popped, pushed, strict=True)] == [block.latency] * len(pushed)
    return inside


def positions_at_level(config, level, rng, count):
    """Anywhere that :class:`Warp` can give, and around the level's own borders above all."""
    frac = config.position_frac
    columns = []
    for (low, high), size in zip(limits(config), config.geometry.level_size(level), strict=True):
        cell = rng.choice([-2, -1, 0, 1, size - 2, size - 1, size, size + 1], count)
        border = (cell << frac) + edge_integers(rng, 0, (1 << frac) - 1, count)
        anywhere = rng.integers(low, high, count, endpoint=True)
        columns.append(np.clip(np.where(rng.random(count) < 0.7, border, anywhere), low, high).tolist())
    one = 1 << config.dt_frac
    return *columns, edge_integers(rng, -one, one, count).tolist()


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("name", LEVELS)
def test_levels_match_model(name, gap, rng):
    """Every change from one level to another, in iterations of a few events."""
    config = LEVELS[name]
    levels = [level for a in range(config.max_level + 1) for b in range(config.max_level + 1) for level in (a, b)]
    check_levels(
        config, [(level, *positions_at_level(config, level, rng, 8)) for level in levels], GAPS[gap], len(levels)
    )


@pytest.mark.parametrize("name", LEVELS)
def test_every_border_cell_of_every_level(name):
    """As at full resolution: exactly the corners inside the level's image vote."""
    config = LEVELS[name]
    half = 1 << (config.position_frac - 1)
    iterations, wanted = [], []
    for level in range(config.max_level + 1):
        scale = 1 << level
        size = [-(-size // scale) for size in (config.roi_width, config.roi_height)]
        xs, ys = ([-2, -1, 0, 1, s - 2, s - 1, s] for s in size)
        cells = [(column, row) for row in ys for column in xs]
        raw = [[(place << config.position_frac) + half for place in axis] for axis in zip(*cells, strict=True)]
        iterations.append((level, *raw, [1 << config.dt_frac] * len(cells)))
        wanted.append(
            [
                sum(0 <= column + right < size[0] for right in (0, 1))
                * sum(0 <= row + down < size[1] for down in (0, 1))
                for column, row in cells
            ]
        )
    inside = check_levels(config, iterations)
    assert [votes.sum(-1).tolist() for votes in inside] == wanted


@corners
@given(st.data())
def test_corners_with_levels(data):
    config = LEVELS[data.draw(st.sampled_from(sorted(LEVELS)))]
    one = 1 << config.dt_frac
    event = st.tuples(*(integers_at_edges(*limit) for limit in limits(config)), integers_at_edges(-one, one))
    iterations = []
    for _ in range(4):
        events = data.draw(st.lists(event, min_size=1, max_size=10))
        iterations.append((data.draw(st.integers(0, config.max_level)), *map(list, zip(*events, strict=True))))
    check_levels(config, iterations, data.draw(st.sampled_from([0.0, 0.4])), data.draw(st.integers(0, 100)))
