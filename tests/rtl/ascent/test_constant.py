"""Constant ascent against its model: v + η·∂C/∂v, saturation both ways, a flag that sticks until the next batch."""

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.reference.integer.ascent import gain, updater
from cmfpga.rtl.ascent.constant import ConstantAscent
from support.ascents import Player
from support.bench import held
from support.configs import CONFIGS, ODD
from support.values import edge_integers, random_g

SHAPES = {
    **CONFIGS,
    # The gradient is shifted left to its format, and the step is shifted left to v's.
    "left": Config(**ODD, gradient_int=4, gradient_frac=32),
    "left step": Config(**ODD, v_frac=16, gradient_int=6, gradient_frac=4, eta_int=6, eta_frac=1),
    # Steps so large that one of them crosses all of v.
    "steep": Config(**ODD, v_int=2, gradient_int=20, gradient_frac=8),
}


def check(config, batches, spacing=0):
    """Batches of (start or None to keep v, η, list of (Gx, Gy)); v and the flag of every change."""
    player = Player(ConstantAscent(config), np.random.default_rng(0))
    planned = {0: player.settings["iterations"]}
    for start, eta, gradients in batches:
        player.begin(start, eta=eta, start_last=int(start is None))
        planned[len(player.script) - 1] = player.settings["iterations"]
        player.cycle()
        for g in gradients:
            player.give(g)
            factor = gain(config, eta)
            steps = [updater(config, *both, gain=factor) for both in zip(player.v, g, strict=True)]
            player.step((v for v, _ in steps), any(limited for _, limited in steps))
            player.cycle(player.block.latency - 1 + spacing)
        player.cycle(3)
    watch = player.check("run.planned", "level")
    assert watch["run.planned"] == list(held(planned, len(player.script))) and not any(watch["level"])
    return zip(*player.timeline.values(), strict=True)


def random_batches(config, rng, count, iterations=12):
    batches = []
    for number in range(count):
        v = edge_integers(rng, config.formats.v.min, config.formats.v.max, 2).tolist()
        start = tuple(v) if number % 3 else None
        eta = int(edge_integers(rng, 0, config.formats.eta.max, 1)[0])
        batches.append((start, eta, [(random_g(config, rng), random_g(config, rng)) for _ in range(iterations)]))
    return batches


@pytest.mark.parametrize("spacing", [0, 3])
@pytest.mark.parametrize("name", SHAPES)
def test_matches_model(name, spacing, rng):
    config = SHAPES[name]
    velocities, flags = check(config, random_batches(config, rng, 8), spacing=spacing)
    assert len(set(velocities)) > 10 and set(flags) == {False, True}


def test_shapes_cover_both_signs_of_every_shift():
    assert {config.widths.gradient_shift > 0 for config in SHAPES.values()} == {True, False}
    assert {config.widths.gradient_shift < 0 for config in SHAPES.values()} == {True, False}
    assert {config.widths.step_shift < 0 for config in SHAPES.values()} == {True, False}
    assert {config.geometry.pixels & (config.geometry.pixels - 1) == 0 for config in SHAPES.values()} == {True, False}


def g_of_slope(config, slope):
    shift = config.widths.gradient_shift
    return slope << shift if shift >= 0 else slope >> -shift


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("name", ["default", "odd", "fine"])
def test_gradient_saturates(name, axis):
    """The flag at exactly one unit beyond the gradient's format, on either axis; with η = 0 v stands still."""
    config = SHAPES[name].replace(gradient_int=1)  # within reach of G
    fmt = config.formats.gradient
    for slope, expected in ((fmt.max, False), (fmt.max + 1, True), (fmt.min, False), (fmt.min - 1, True)):
        g = [0, 0]
        g[axis] = g_of_slope(config, slope)
        assert abs(g[axis]) <= config.widths.g_max
        velocities, flags = check(config, [((5, -7), 0, [tuple(g)])])
        assert flags[-1] == expected and velocities[-1] == (5, -7)


@pytest.mark.parametrize("name", ["default", "odd"])
def test_halves_round_up(name):
    """The smallest gradients and steps of either sign: the gradient is floored, the step rounds half up."""
    config = SHAPES[name]
    shift = max(0, config.widths.gradient_shift)
    unit = 1 << max(0, config.widths.step_shift - config.formats.gain.f)  # slope that moves v by about a unit at η = 1
    eta = config.formats.eta.raw(1.0)
    around = sorted({value + near for value in (0, unit // 2, unit, 3 * unit // 2) for near in (-1, 0, 1)})
    gs = [sign * (slope << shift) + near for slope in around for sign in (-1, 1) for near in (-1, 0, 1)]
    check(config, [((0, 0), eta, [(g, -g) for g in gs])])


@pytest.mark.parametrize("sign", [-1, 1])
def test_v_saturates_and_the_flag_sticks(sign):
    """Up to the end of v's format and not beyond; the flag stays until the next batch, v longer."""
    config = SHAPES["steep"]
    end = config.formats.v.max if sign > 0 else config.formats.v.min
    g = g_of_slope(config, sign * (1 << config.gradient_frac))  # ∂C/∂v = ±1, so v moves by η/ρ, 1.7 px
    eta = config.formats.eta.raw(3.0)
    velocities, flags = check(
        config, [((0, 0), eta, [(0, 0), (g, 0), (0, 0), (g, 0), (g, 0), (-g, 0), (0, -g)]), (None, eta, [(-g, g)])]
    )
    assert (end, 0) in velocities
    assert flags[:5] == (False,) * 5 and flags[-2:] == (False, False) and any(flags)
    first = flags.index(True)
    assert all(flags[first:-2])


def test_keeps_v_from_batch_to_batch(rng):
    """Warm start: with ``start_last`` the next batch goes on from the last v; without it from ``v_start``."""
    config = SHAPES["default"]
    g = g_of_slope(config, 1 << (config.gradient_frac - 3))
    eta = config.formats.eta.raw(1.0)
    velocities, _ = check(config, [(None, eta, [(g, -g)]), (None, eta, [(g, -g)]), ((100, 200), eta, [(g, 0)])])
    step = 1 << (config.v_frac - 3)
    assert velocities[-1] == (100 + step, 200) and (2 * step, -2 * step) in velocities
