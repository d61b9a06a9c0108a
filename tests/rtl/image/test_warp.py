"""Warp against its model: positions floored and clamped, v used in the cycle in which an event enters, level later."""

import numpy as np
import pytest
import torch

from cmfpga.reference.integer.image import warp
from cmfpga.rtl.image.warp import Warp
from support.bench import GAPS, check_latency, flow_script, play
from support.configs import CONFIGS, LEVELS
from support.values import edge_integers, random_gaps, shape_range, tensor

SHAPES = CONFIGS | LEVELS


def limits(config):
    """Ranges of dt, of columns and rows, dithered if they are, and of both axes of v."""
    one, half = 1 << config.dt_frac, (1 << config.dither_frac) >> 1
    places = [
        (-half, ((size - 1) << config.dither_frac) + max(0, half - 1)) for size in (config.roi_width, config.roi_height)
    ]
    return [(-one, one), *places, *[(config.formats.v.min, config.formats.v.max)] * 2]


def clamps(config):
    """The first and last x' that there are."""
    return -2 << config.position_frac, ((config.roi_width + 1) << config.position_frac) - 1


def check(config, dt, x, y, vx, vy, levels=None, gaps=None):
    """Each event has a level of its own, which stands on ``level`` two cycles after the event only; the positions."""
    rng = np.random.default_rng(1)
    block = Warp(config)
    levels = levels or [0] * len(x)
    items = [
        ({"dt": dt, "x": x, "y": y, "last": number % 2}, {"v": {"x": vx, "y": vy}})
        for number, (dt, x, y, vx, vy) in enumerate(zip(dt, x, y, vx, vy, strict=True))
    ]
    script, pushed = flow_script(block, items, gaps or [0] * len(x), rng)
    top = shape_range(block.level.shape())[1]
    for cycle in script:
        cycle["level"] = int(rng.integers(top, endpoint=True)) if config.max_level else 0
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
    check_latency(block, pushed, recording)
    return positions


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("name", SHAPES)
def test_matches_model(name, gap, rng):
    """Levels mixed at random, and the dither's fractions."""
    config, count = SHAPES[name], 150
    levels = rng.integers(0, config.max_level, count, endpoint=True).tolist()
    events = [edge_integers(rng, low, high, count).tolist() for low, high in limits(config)]
    x = check(config, *events, levels, random_gaps(rng, count, GAPS[gap]))[:, 0]
    # Both clamps were met, wherever v can carry an event that far.
    if not config.max_level and config.formats.v.real(config.formats.v.max) > config.roi_width:
        assert (x.min(), x.max()) == clamps(config)


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
                x += [column] * 4
                dt += [-one, one, -one + 1, one - 1]
                v += [(pixels << config.v_frac) + raw] * 4
    positions = check(config, dt, x, [0] * len(x), v, [0] * len(x))[:, 0]
    shift = config.v_frac - config.position_frac
    low, high = clamps(config)
    for position, column, time, velocity in zip(positions.tolist(), x, dt, v, strict=True):
        if abs(time) == one:
            exact = (column << config.position_frac) - ((time // one * velocity) / (1 << shift))
            assert position == min(max(int(np.floor(exact)), low), high)


@pytest.mark.parametrize("level", range(4))
def test_a_coarse_pixel_is_centred_on_the_pixels_it_covers(level):
    """Against fractions: x'' = (x' + ½)/2^level − ½, floored, clamped; both borders, at rest and by whole pixels."""
    config = LEVELS["fast odd"]
    assert level <= config.max_level
    columns = range(*limits(config)[1])
    count = len(columns)
    low, high = clamps(config)
    for pixels in (-4, 0, 1):
        raw = pixels << config.v_frac
        events = [-1 << config.dt_frac] * count, list(columns), [0] * count, [raw] * count, [0] * count
        for column, (position, _) in zip(columns, check(config, *events, [level] * count).tolist(), strict=True):
            # dt = −1, so that x' = x + v. All these numbers are exact in binary.
            warped = column / (1 << config.dither_frac) + pixels
            exact = (warped + 0.5) / (1 << level) - 0.5
            assert position == min(max(int(np.floor(exact * (1 << config.position_frac))), low), high)
