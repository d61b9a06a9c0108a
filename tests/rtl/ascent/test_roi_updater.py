"""ROI updater against its model: a position that keeps its fraction, limited to the sensor at every border."""

import itertools

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.reference.sequence import RoiFollower
from cmfpga.rtl.ascent.roi_updater import RoiUpdater
from support.bench import held, play
from support.configs import CONFIGS, ODD, TINY
from support.values import edge_integers, random_value

SHAPES = {
    **{name: CONFIGS[name] for name in ("default", "narrow", "odd", "tiny")},
    # The ROI is the sensor: it cannot move. One column and one row of freedom. A gain without fraction bits.
    "whole": Config(roi_width=240, roi_height=180),
    "one": Config(**TINY).replace(sensor_width=3, sensor_height=3),
    "whole gain": Config(**ODD, v_frac=1, roi_gain_frac=0),
}

CORNER = ("corner.roi", "corner.roi_next", "corner.clamped")


def check(config, batches, buffers=1, *, hurry=False, seed=0):
    """Batches of (corner to load or None, v, gain, whether to move); compares corner and flag in every cycle.

    With one buffer a move follows its batch's crop, after any time; a move that is none is ``still`` half of the time,
    and no ``move`` at all otherwise. With two every batch is cropped before the move of the one ahead of it, and the
    next crop follows :attr:`RoiUpdater.settle` cycles later, with ``hurry`` in the first cycle in which it may. Where a
    batch loads its ROI, nothing moves. Returns (corner, clamped) of each crop, and with one buffer of each move.
    """
    config, rng = config.replace(buffers=buffers), np.random.default_rng(seed)
    block, follower = RoiUpdater(config), RoiFollower(config, 1 << config.formats.roi_x.f)
    script, corners, following, ahead = [], {0: ((0, 0), False)}, {}, None

    def cycle(**values):
        """Anything on the other inputs, where nothing counts without its strobe."""
        noise = {"x": random_value(config.geometry.x_bits, rng), "y": random_value(config.geometry.y_bits, rng)}
        noise |= {"v": random_value(block.v.shape(), rng), "still": int(rng.integers(2))}
        noise |= {"roi_gain": random_value(config.formats.roi_gain.width, rng)}
        noise["load"] = 0 if "new_batch" in values else int(rng.integers(2))
        script.append(noise | values)

    def wait(longest=4):
        for _ in range(0 if hurry else int(rng.integers(longest))):
            cycle()

    wait()
    for load, *coming in batches:
        cycle(new_batch=1, **({} if load is None else {"load": 1, "x": load[0], "y": load[1]}))
        corner, clamped = follower.crop(load)
        corners[len(script)] = corner, clamped
        if buffers == 2 and load is not None:  # nothing moves it
            following[len(script) - 1 + block.settle] = follower.next_corner
        wait()
        step, stays = coming if buffers == 1 else ahead if load is None else None, {}
        if step and (buffers == 2 or step[2] or rng.random() < 0.5):
            v, gain, moves = step
            stays = {"v": dict(zip("xy", v, strict=True))}  # from ``move`` on
            cycle(move=1, **stays, roi_gain=gain, still=int(not moves))
        else:
            cycle()
        for _ in range((block.latency if buffers == 1 else block.settle) - 1):
            cycle(**stays)
        ahead, (v, gain, moves) = coming, coming
        # Eq. roi_update, which has a gain of 1: exact, no bit is rounded away.
        limited = follower.move(tuple(axis * gain for axis in v) if moves else None)
        if buffers == 1 and moves:
            corners[len(script)] = follower.next_corner, clamped | limited
        following[len(script)] = follower.next_corner
        wait(9)
        following[len(script)] = follower.next_corner
    cycle()
    recording = play(block, script, flows=(), watch=CORNER).watch
    for number, (corner, clamped) in enumerate(held(corners, len(script))):
        roi = tuple(recording["corner.roi"][number].values())
        assert (roi, bool(recording["corner.clamped"][number])) == (corner, clamped), f"cycle {number}"
    for number, corner in following.items():
        assert tuple(recording["corner.roi_next"][number].values()) == corner, f"cycle {number}"
    assert buffers == 2 or recording["corner.roi_next"] == recording["corner.roi"]
    return list(corners.values())[1:]


def random_batches(config, rng, count):
    batches = []
    for _ in range(count):
        load = None
        if rng.random() < 0.3:
            load = int(rng.integers(config.sensor_width)), int(rng.integers(config.sensor_height))
        fast = rng.random() < 0.3
        limits = (config.formats.v.min, config.formats.v.max) if fast else (-2 << config.v_frac, 2 << config.v_frac)
        gain = edge_integers(rng, 0, config.formats.roi_gain.max, 1)[0]
        batches.append((load, tuple(edge_integers(rng, *limits, 2).tolist()), int(gain), rng.random() < 0.8))
    return batches


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("buffers, hurry", [(1, False), (2, False), (2, True)])
def test_matches_model(name, buffers, hurry, rng):
    corners = check(SHAPES[name], random_batches(SHAPES[name], rng, 200), buffers, hurry=hurry)
    assert {clamped for _, clamped in corners} == {False, True}


def test_with_two_buffers_the_last_move_is_repeated():
    """A constant velocity is met exactly, one batch late; a batch that measured nothing stops it, a load resets it."""
    config = SHAPES["default"]
    unit, pixel = 1 << config.roi_gain_frac, 1 << config.v_frac
    step = ((3 * pixel, -pixel), unit, True)
    nothing = (step[0], unit, False)
    batches = [((50, 60), *step), (None, *step), (None, *step), (None, *nothing), (None, *step), (None, *step)]
    batches += [((50, 60), *step), (None, *step), (None, *step)]
    # The first move is known when the second batch has been cropped, and then repeated for the third.
    assert [corner for corner, _ in check(config, batches, 2)] == [
        (50, 60), (50, 60), (56, 58), (59, 57), (62, 56), (59, 57), (50, 60), (50, 60), (56, 58),
    ]  # fmt: skip


@pytest.mark.parametrize("buffers", [1, 2])
@pytest.mark.parametrize("name", SHAPES)
def test_clamps_at_every_border(name, buffers):
    """To the first and last column and row, by a unit and by far, and back; with two buffers what is ahead, too."""
    config = SHAPES[name]
    unit = 1 << config.roi_gain_frac  # gain 1
    speeds = (1, -1, 1 << config.v_frac, -1 << config.v_frac, config.formats.v.max, config.formats.v.min)
    batches = []
    for corner in itertools.product((0, config.geometry.roi_x_max), (0, config.geometry.roi_y_max)):
        for v in speeds:
            for velocity in ((v, 0), (0, v), (v, -v - (v < 0))):
                batches.append((corner, velocity, unit, True))
                if buffers == 2:
                    batches += [*[(None, velocity, unit, True)] * 2, (None, (0, 0), unit, True)]
                    batches += [(None, velocity, 0, True), (None, velocity, unit, False)]
            # Exactly back to the border sets no flag.
            batches += [(corner, (0, 0), unit, True), (corner, (0, 0), 0, True)]
    assert {clamped for _, clamped in check(config, batches, buffers)} == {False, True}


@pytest.mark.parametrize("buffers", [1, 2])
def test_load_out_of_range(buffers):
    """Every corner beyond the last one is limited and flagged; the last one is not."""
    config = SHAPES["odd"]
    loads = [(config.geometry.roi_x_max + dx, config.geometry.roi_y_max + dy) for dx in (0, 1, 2) for dy in (0, 1, 2)]
    loads += [(63, 0), (0, 31), (63, 31), (0, 0)]
    found = check(config, [(load, (0, 0), 0, False) for load in loads], buffers)
    wanted = [load[0] > config.geometry.roi_x_max or load[1] > config.geometry.roi_y_max for load in loads]
    assert [clamped for _, clamped in found] == wanted


def test_flag_sticks_until_the_next_batch():
    config = SHAPES["odd"]
    still = (None, (0, 0), 16, True)
    # Loaded out of range, then a move that stays inside: still flagged. The next batch clears it.
    timeline = check(
        config, [((60, 0), (-4096, 0), 16, True), still, (None, (config.formats.v.max, 0), 63, True), still]
    )
    assert [clamped for _, clamped in timeline] == [True, True, False, False, False, True, False, False]


def test_slow_motion_adds_up_and_halves_round_up():
    """An eighth of a pixel per batch: the corner follows after four batches, and moves once in eight."""
    config = SHAPES["default"]
    eighth = 1 << (config.v_frac - 3)
    gain = 1 << config.roi_gain_frac
    timeline = check(config, [((10, 20), (0, 0), gain, False), *[(None, (eighth, -eighth), gain, True)] * 20])
    corners = [corner for corner, _ in timeline[1:]][1::2]
    # 10 + n/8 rounds up at the half; 20 − n/8 stays until it is below the half.
    assert [x for x, _ in corners] == [10 + (n + 4) // 8 for n in range(1, 21)]
    assert [y for _, y in corners] == [20 + (4 - n) // 8 for n in range(1, 21)]
