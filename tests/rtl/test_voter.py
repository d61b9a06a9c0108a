"""Bilinear voter against its model: weights, derivatives, bank and address of each corner, corners outside dropped."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cmfpga.reference.integer.voter import voter
from cmfpga.rtl.voter import BilinearVoter

from .bench import (
    CONFIGS,
    GAPS,
    check_throughput,
    corners,
    edge_integers,
    flow_script,
    integers_at_edges,
    np,
    play,
    random_gaps,
    tensor,
    vote_payloads,
)


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


def test_latency_and_throughput(rng):
    config = CONFIGS["default"]
    pushed, popped, _ = check(config, *random_positions(config, rng, 64), [0] * 64)
    check_throughput(pushed, popped)


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
