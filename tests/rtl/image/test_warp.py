"""Warp against its model: positions floored and clamped, v used in the cycle in which an event enters, level later."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from cmfpga.reference.integer.warp import warp
from cmfpga.rtl.image.warp import Warp
from support.bench import GAPS, check_flow, flow_script, play
from support.configs import CONFIGS, LEVELS
from support.values import corners, edge_integers, integers_at_edges, random_gaps, shape_range, tensor


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
        edge_integers(rng, config.formats.v.min, config.formats.v.max, count).tolist(),
        edge_integers(rng, config.formats.v.min, config.formats.v.max, count).tolist(),
    )


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("name", CONFIGS)
def test_matches_model(name, gap, rng):
    config = CONFIGS[name]
    count = 150
    last = rng.integers(0, 2, count).tolist()
    *_, (x, _) = check(config, *random_events(config, rng, count), random_gaps(rng, count, GAPS[gap]), last)
    # Both clamps were met, wherever v can carry an event that far.
    if config.formats.v.real(config.formats.v.max) > config.roi_width:
        assert x.min() == -2 << config.position_frac
        assert x.max() == ((config.roi_width + 1) << config.position_frac) - 1


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
        integers_at_edges(config.formats.v.min, config.formats.v.max),
        integers_at_edges(config.formats.v.min, config.formats.v.max),
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


# ---------------------------------------------------------------- coarse levels and dither


def limits(config):
    """Ranges of dithered columns and rows."""
    half = (1 << config.dither_frac) >> 1
    return [
        (-half, ((size - 1) << config.dither_frac) + max(0, half - 1)) for size in (config.roi_width, config.roi_height)
    ]


def dithered_events(config, rng, count):
    one = 1 << config.dt_frac
    return [
        edge_integers(rng, low, high, count).tolist()
        for low, high in ((-one, one), *limits(config), *[(config.formats.v.min, config.formats.v.max)] * 2)
    ]


def check_levels(config, dt, x, y, vx, vy, levels, gaps):
    """As :func:`check`, each event with a level of its own; it stands on ``level`` two cycles after the event only."""
    rng = np.random.default_rng(1)
    block = Warp(config)
    items = [
        ({"dt": dt, "x": x, "y": y, "last": number % 2}, {"v": {"x": vx, "y": vy}})
        for number, (dt, x, y, vx, vy) in enumerate(zip(dt, x, y, vx, vy, strict=True))
    ]
    script, pushed = flow_script(block, items, gaps, rng)
    top = shape_range(block.level.shape())[1]
    for cycle in script:
        cycle["level"] = int(rng.integers(top, endpoint=True))
    for cycle, level in zip(pushed, levels, strict=True):
        script[cycle + 2]["level"] = level
    v = tensor(vx), tensor(vy)
    by_level = [
        torch.stack(warp(config, tensor(x), tensor(y), tensor(dt), v, level)) for level in range(config.max_level + 1)
    ]
    positions = torch.stack([by_level[level][:, k] for k, level in enumerate(levels)])
    recording = play(block, script)
    came = [(item["x"], item["y"], item["dt"], item["last"]) for item in recording.values()]
    wanted = [(*xy, item["dt"], item["last"]) for xy, (item, _) in zip(positions.tolist(), items, strict=True)]
    for number, (value, right) in enumerate(zip(came, wanted, strict=True)):
        assert value == right, f"item {number}, level {levels[number]}: {items[number]}"
    assert [out - into for out, into in zip(recording.cycles(), pushed, strict=True)] == [block.latency] * len(pushed)
    return pushed, recording.cycles(), positions


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("name", LEVELS)
def test_levels_match_model(name, gap, rng):
    """Levels mixed at random, and the dither's fractions."""
    config = LEVELS[name]
    levels = rng.integers(0, config.max_level, 200, endpoint=True).tolist()
    check_levels(config, *dithered_events(config, rng, 200), levels, random_gaps(rng, 200, GAPS[gap]))


@pytest.mark.parametrize("level", range(4))
def test_a_coarse_pixel_is_centred_on_the_pixels_it_covers(level):
    """Against fractions: x'' = (x' + ½)/2^level − ½, floored, clamped; both borders, at rest and by whole pixels."""
    config = LEVELS["fast odd"]
    assert level <= config.max_level
    columns = range(*limits(config)[0])
    count = len(columns)
    for pixels in (-4, 0, 1):
        raw = pixels << config.v_frac
        events = [-1 << config.dt_frac] * count, list(columns), [0] * count, [raw] * count, [0] * count
        *_, positions = check_levels(config, *events, [level] * count, [0] * count)
        low, high = -2 << config.position_frac, ((config.roi_width + 1) << config.position_frac) - 1
        for column, (position, _) in zip(columns, positions.tolist(), strict=True):
            # dt = −1, so that x' = x + v. All these numbers are exact in binary.
            warped = column / (1 << config.dither_frac) + pixels
            exact = (warped + 0.5) / (1 << level) - 0.5
            assert position == min(max(int(np.floor(exact * (1 << config.position_frac))), low), high)


@corners
@given(st.data())
def test_corners_with_levels(data):
    config = LEVELS[data.draw(st.sampled_from(sorted(LEVELS)))]
    one = 1 << config.dt_frac
    event = st.tuples(
        integers_at_edges(-one, one),
        *(integers_at_edges(*limit) for limit in limits(config)),
        integers_at_edges(config.formats.v.min, config.formats.v.max),
        integers_at_edges(config.formats.v.min, config.formats.v.max),
        st.integers(0, config.max_level),
    )
    events = data.draw(st.lists(event, min_size=20, max_size=40))
    check_levels(config, *(list(column) for column in zip(*events, strict=True)), [0] * len(events))
