"""Constant ascent against its model: v + η·∂C/∂v, saturation both ways, a flag that sticks until the next batch."""

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.reference.integer.ascent import gain, updater
from cmfpga.rtl.ascent.constant import ConstantAscent
from support.bench import held, play
from support.configs import CONFIGS, ODD
from support.values import edge_integers, random_g, random_value

SHAPES = {
    **CONFIGS,
    # The gradient is shifted left to its format, and the step is shifted left to v's.
    "left": Config(**ODD, gradient_int=4, gradient_frac=32),
    "left step": Config(**ODD, v_frac=16, gradient_int=6, gradient_frac=4, eta_int=6, eta_frac=1),
    # Steps so large that one of them crosses all of v.
    "steep": Config(**ODD, v_int=2, gradient_int=20, gradient_frac=8),
}


def check(config, batches, *, spacing=None, seed=0):
    """Batches of (start or None to keep v, η, list of (Gx, Gy)); compares v and the flag in every cycle."""
    rng = np.random.default_rng(seed)
    block = ConstantAscent(config)
    script, entered, v, saturated, planned = [], [], (0, 0), False, {0: 0}
    timeline = {0: (v, saturated)}
    settings = random_value(block.run.settings.shape(), rng)

    def cycle(**values):
        # No gradient counts without its strobe; the other settings do not matter.
        script.append({"i.payload": random_value(block.i.payload.shape(), rng), "run.settings": settings, **values})

    def xy(pair):
        return dict(zip("xy", pair, strict=True))

    cycle()
    planned[0] = settings["iterations"]
    for start, eta, gradients in batches:
        cycle(**{"run.take": 1})
        settings = random_value(block.run.settings.shape(), rng) | {"eta": eta, "start_last": int(start is None)}
        settings |= {} if start is None else {"v_start": xy(start)}
        saturated = False
        timeline[len(script)] = v, saturated
        planned[len(script)] = settings["iterations"]
        cycle(**{"run.start": 1})
        if start is not None:
            v = start
            timeline[len(script)] = v, saturated
        cycle()
        for g in gradients:
            entered.append(len(script))
            cycle(**{"i.valid": 1, "i.payload": xy(g)})
            steps = [
                updater(config, axis_v, axis_g, gain=gain(config, eta)) for axis_v, axis_g in zip(v, g, strict=True)
            ]
            v = steps[0][0], steps[1][0]
            saturated |= steps[0][1] or steps[1][1]
            timeline[entered[-1] + block.latency] = v, saturated
            for _ in range(block.latency - 1 + (spacing or 0)):
                cycle()
        for _ in range(3):
            cycle()

    watch = ("v", "saturated", "run.updated", "run.planned", "level", "limited")
    recording = play(block, script, flows=(), watch=watch).watch
    for number, wanted in enumerate(held(timeline, len(script))):
        velocity = recording["v"][number]
        got = (velocity["x"], velocity["y"]), bool(recording["saturated"][number])
        assert got == wanted, f"cycle {number}"
    done = [number for number, value in enumerate(recording["run.updated"]) if value]
    assert done == [number + block.latency for number in entered]
    assert recording["run.planned"] == list(held(planned, len(script)))
    assert not any(recording["level"] + recording["limited"])
    return [v for v, _ in timeline.values()], [saturated for _, saturated in timeline.values()]


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
