"""Sign ascent against its model: a step of the schedule by the sign of G, half of it for small G."""

import numpy as np
import pytest

from cmfpga.reference.integer.ascent import lesser, sign_updater
from cmfpga.rtl.ascent.sign import SignAscent
from support.ascents import Player
from support.configs import SIGNS
from support.values import edge_integers, random_g


def check(config, batches, spacing=0):
    """Batches of (start or None to keep v, list of (shift, Gx, Gy, …)); compares everything in every cycle.

    The table is written before each of them: what counts anywhere in it, cold or warm, and anything in all other words.
    A batch that keeps v is warm, so the one before it was not degenerate; one that does not is cold for one reason of
    three, of which two leave no choice if v was not to be kept.
    """
    rng = np.random.default_rng(0)
    player, parameters, entries = (
        Player(SignAscent(config), rng),
        config.motion_model.parameters,
        config.schedule_entries,
    )
    planned, tracking = {}, False
    for start, steps in batches:
        assert len(steps) <= entries
        first = int(rng.integers(entries))
        for k, (shift, *_) in enumerate(steps):
            entry = {"level": int(rng.integers(config.max_level + 1)), "shift": shift, "stride": int(rng.integers(3))}
            write = {"address": (first + k) % entries, "entry": entry}
            player.cycle(**{"schedule_write.valid": 1, "schedule_write.payload": write})
        warm = start is None and tracking
        if start is None and not tracking:  # cold, but where v already is
            start = player.v
        reason = {} if warm else [{"start_last": 0}, {"roi_load": 1}, {}][int(rng.integers(2 if tracking else 3))]
        part = {"warm" if warm else "cold": {"first": first, "count": len(steps)}}
        player.begin(start, wait=3, **{"start_last": 1, "roi_load": 0} | reason | part)
        planned[len(player.script) - 3] = len(steps)
        player.cycle()
        for shift, *g in steps:
            player.give(g)
            player.cycle(2)
            found = [
                sign_updater(one.fmt, axis_v, axis_g, log2_step=shift - config.formats.v.f, halved=half)
                for one, axis_v, axis_g, half in zip(parameters, player.v, g, lesser(config, g), strict=True)
            ]
            player.step((v for v, _ in found), any(limited for _, limited in found))
            player.cycle(spacing)
        player.cycle(3)
        tracking = bool(rng.random() < 0.8)
        player.cycle(**{"run.done": 1, "run.degenerate": int(not tracking)})
    watch = player.check("run.planned")
    assert {cycle: watch["run.planned"][cycle] for cycle in planned} == planned
    return list(player.timeline.values())


def random_batches(config, rng, count, iterations=15):
    batches = []
    for number in range(count):
        parameters = config.motion_model.parameters
        start = tuple(int(edge_integers(rng, one.fmt.min, one.fmt.max, 1)[0]) for one in parameters)
        start = start if number % 3 else None
        steps = [
            (int(rng.integers(config.formats.v.width - 1)), *(random_g(config, rng) for _ in parameters))
            for _ in range(iterations)
        ]
        batches.append((start, steps))
    return batches


def slopes(config, rng):
    """One near the bound or not, and others about half of it or anything; of either sign."""
    bound = config.widths.g_max
    steepest = min(bound, int(2.0 ** rng.uniform(config.widths.s_frac, config.widths.g_bits - 1)))
    near = steepest // 2 + int(rng.integers(-2, 3)) * (1 << config.widths.s_frac - 1) + int(rng.integers(-1, 2))
    sizes = [steepest, *(int(rng.choice([near, random_g(config, rng)])) for _ in config.motion_model.names[1:])]
    signed = [max(-bound, min(bound, size * int(rng.choice([-1, 1])))) for size in sizes]
    return [signed[k] for k in rng.permutation(len(signed))]


@pytest.mark.parametrize("name", SIGNS)
def test_lesser_slopes_move_by_half_a_step(name, rng):
    config = SIGNS[name]
    parameters = config.motion_model.parameters
    batches = []
    for number in range(12):
        start = tuple(int(rng.integers(one.fmt.min, one.fmt.max + 1)) for one in parameters) if number % 3 else None
        steps = [(int(rng.integers(config.formats.v.width - 1)), *slopes(config, rng)) for _ in range(15)]
        batches.append((start, steps))
    told = [lesser(config, g) for _, steps in batches for _, *g in steps]
    assert {sum(each) for each in told} == set(range(len(parameters)))
    timeline = check(config, batches)
    assert {flag for _, flag in timeline} == {False, True}
    # Exactly half is not less; one whole part less is. Of a negative number the whole part is one further.
    unit = 1 << config.widths.s_frac
    rest = [0] * (len(parameters) - 2)
    zero, shift = (0,) * len(parameters), 4
    for g, moved in (((8, 4), 16), ((8, 4 - 1 / unit), 8), ((-8, 4), 16), ((-8, 3), 8), ((8, -5), -16), ((8, -4), -8)):
        timeline = check(config, [(zero, [(shift, *(int(each * unit) for each in g), *rest)])])
        assert timeline[-1][0][1] == moved


@pytest.mark.parametrize("spacing", [0, 3])
@pytest.mark.parametrize("name", SIGNS)
def test_matches_model(name, spacing, rng):
    config = SIGNS[name]
    timeline = check(config, random_batches(config, rng, 8), spacing=spacing)
    assert len({v for v, _ in timeline}) > 10 and {flag for _, flag in timeline} == {False, True}


@pytest.mark.parametrize("name", SIGNS)
def test_every_step_from_every_end(name):
    """Steps of every size from zero and from both ends of v, up, down and not at all; limited to the unit."""
    config = SIGNS[name]
    low, high, rest = config.formats.v.min, config.formats.v.max, (0,) * (len(config.motion_model.names) - 2)
    batches = []
    for shift in range(config.formats.v.width - 1):
        step = 1 << shift
        for start in {0, low, high, *(high - step + near for near in (0, 1)), *(low + step + near for near in (-1, 0))}:
            start = min(max(start, low), high)
            batches += [((start, -1 - start, *rest), [(shift, sign, -sign, *rest)]) for sign in (-1, 0, 1)]
    assert {v[0] for v, _ in check(config, batches)} >= {low, high}


def test_the_axes_are_independent():
    """The sign of one axis and its saturation leave the other alone; each of them raises the flag."""
    config = SIGNS["similarity"]
    for axis, one in enumerate(config.motion_model.parameters):
        for sign in (-1, 1):
            g, start = [0] * 4, [7] * 4
            g[axis], start[axis] = sign, one.fmt.max if sign > 0 else one.fmt.min
            timeline = check(config, [(tuple(start), [(3, *g)])])
            assert timeline[-1] == (tuple(start), True)


def test_the_flag_sticks_and_v_stays(rng):
    """Saturation is remembered until the next batch; without ``load`` v goes on from where it was."""
    config = SIGNS["similarity"]
    top, rest = config.formats.v.max, (0, 0)
    batches = ((top - 1, 0), ((2, 1, 1), (0, -1, 0), (0, 0, 0))), (None, ((0, -1, 1),)), ((5, 6), ((1, 1, -1),))
    batches = [(start and start + rest, [step + rest for step in steps]) for start, steps in batches]
    timeline = check(config, batches)
    assert timeline[-1] == ((7, 4, *rest), False) and ((top - 2, 5, *rest), False) in timeline
    assert [flag for _, flag in timeline[3:7]] == [True, True, True, False]
