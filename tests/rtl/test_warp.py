"""Warp against its model: positions floored and clamped, v used in the cycle in which an event enters."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cmfpga.reference.integer.warp import warp
from cmfpga.rtl.warp import Warp

from .bench import (
    CONFIGS,
    GAPS,
    check_flow,
    check_throughput,
    corners,
    edge_integers,
    integers_at_edges,
    np,
    random_gaps,
    tensor,
)


def check(config, dt, x, y, vx, vy, gaps, last=None):
    last = [0] * len(dt) if last is None else last
    positions = warp(config, tensor(x), tensor(y), tensor(dt), (tensor(vx), tensor(vy)))
    items = [
        ({"dt": dt, "x": x, "y": y, "last": last}, {"v": {"x": vx, "y": vy}})
        for dt, x, y, vx, vy, last in zip(dt, x, y, vx, vy, last, strict=True)
    ]
    expected = [
        {"dt": dt, "x": x, "y": y, "last": last}
        for dt, x, y, last in zip(dt, *(p.tolist() for p in positions), last, strict=True)
    ]
    return *check_flow(Warp(config), items, expected, gaps=gaps, rng=np.random.default_rng(1)), positions


def random_events(config, rng, count):
    one = 1 << config.dt_frac
    return (
        edge_integers(rng, -one, one, count).tolist(),
        edge_integers(rng, 0, config.roi_width - 1, count).tolist(),
        edge_integers(rng, 0, config.roi_height - 1, count).tolist(),
        edge_integers(rng, config.v.min, config.v.max, count).tolist(),
        edge_integers(rng, config.v.min, config.v.max, count).tolist(),
    )


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("name", CONFIGS)
def test_matches_model(name, gap, rng):
    config = CONFIGS[name]
    count = 150
    last = rng.integers(0, 2, count).tolist()
    *_, (x, _) = check(config, *random_events(config, rng, count), random_gaps(rng, count, GAPS[gap]), last)
    # Both clamps were met, wherever v can carry an event that far.
    if config.v.real(config.v.max) > config.roi_width:
        assert x.min() == -2 << config.position_frac
        assert x.max() == ((config.roi_width + 1) << config.position_frac) - 1


def test_latency_and_throughput(rng):
    config = CONFIGS["default"]
    pushed, popped, _ = check(config, *random_events(config, rng, 64), [0] * 64)
    check_throughput(pushed, popped)


@corners
@given(st.data())
def test_corners(data):
    """Ends of every format at once."""
    config = CONFIGS[data.draw(st.sampled_from(["default", "narrow", "tiny", "fine"]))]
    one = 1 << config.dt_frac
    event = st.tuples(
        integers_at_edges(-one, one),
        integers_at_edges(0, config.roi_width - 1),
        integers_at_edges(0, config.roi_height - 1),
        integers_at_edges(config.v.min, config.v.max),
        integers_at_edges(config.v.min, config.v.max),
    )
    events = data.draw(st.lists(event, min_size=20, max_size=40))
    check(config, *(list(column) for column in zip(*events, strict=True)), [0] * len(events))


@pytest.mark.parametrize("name", ["default", "narrow"])
def test_floors_and_clamps_at_each_step(name):
    """x' one raw unit below, at and above each whole pixel around both borders: floored, never rounded."""
    config = CONFIGS[name]
    one = 1 << config.dt_frac
    x, dt, v = [], [], []
    # dt = −1, so x' = x + v exactly; dt = −1 + 1 unit puts x' a fraction below.
    for column in (0, config.roi_width - 1):
        for pixels in (-3, -2, -1, 0, 1, 2, 3):
            for raw in (-1, 0, 1):
                velocity = (pixels << config.v_frac) + raw
                x += [column] * 4
                dt += [-one, one, -one + 1, one - 1]
                v += [velocity] * 4
    *_, (positions, _) = check(config, dt, x, [0] * len(x), v, [0] * len(x), [0] * len(x))
    shift = config.v_frac - config.position_frac
    for position, column, time, velocity in zip(positions.tolist(), x, dt, v, strict=True):
        if abs(time) == one:
            exact = (column << config.position_frac) - ((time // one * velocity) / (1 << shift))
            low, high = -2 << config.position_frac, ((config.roi_width + 1) << config.position_frac) - 1
            assert position == min(max(int(np.floor(exact)), low), high)
