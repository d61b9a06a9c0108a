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


def check(config, dt, x, y, vx, vy, levels, gaps):
    """Each event has a level of its own, which stands on ``level`` two cycles after the event only; the positions."""
    rng = np.random.default_rng(1)
    block = Warp(config)
    items = [
        ({"dt": dt, "x": x, "y": y, "last": number % 2}, {"v": {"x": vx, "y": vy}})
        for number, (dt, x, y, vx, vy) in enumerate(zip(dt, x, y, vx, vy, strict=True))
    ]
    script, pushed = flow_script(block, items, gaps, rng)
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
    config, count = SHAPES[name], 150
    levels = rng.integers(0, config.max_level, count, endpoint=True).tolist()
    events = [edge_integers(rng, low, high, count).tolist() for low, high in limits(config)]
    x = check(config, *events, levels, random_gaps(rng, count, GAPS[gap]))[:, 0]
    # Both clamps were met, wherever v can carry an event that far.
    if not config.max_level and config.formats.v.real(config.formats.v.max) > config.roi_width:
        assert (x.min(), x.max()) == (-2 << config.position_frac, ((config.roi_width + 1) << config.position_frac) - 1)
