"""Tiles around a tile bear it out, or do not: along the direction that its own events leave open."""

import dataclasses
import math

import numpy as np
import pytest

from cmfpga.dense.neighbours import ORDERLY
from cmfpga.dense.window import Window
from cmfpga.protocol.confidence import Curvature, information
from cmfpga.protocol.flags import Flag

BEST, WORST = 80.0, 16.0  # what is known of v across edges and along them, 1/px²


def made(slid, flow, angles, *, flags=None):
    """``slid`` with this flow at each tile's middle, px per half window, and edges whose normal has these angles."""
    outcomes = []
    for k, (outcome, corner) in enumerate(zip(slid.tiles.of(slid.result), slid.tiles.corners, strict=True)):
        told = {"flags": Flag(0) if flags is None else flags[k], "roi_events": 400, "sum_squares": 1 << 22}
        told |= {"sums": (0,) * len(outcome.sums), "v": tuple(flow(k, np.array(corner) + 15.5))}
        one = dataclasses.replace(outcome, curvature=Curvature(1 << 20, 0, 0), **told)
        scale = (1 << 20) / information(slid.config, one)[0]
        cos, sin = math.cos(angles[k]), math.sin(angles[k])
        xx, yy = (BEST * a * a + WORST * b * b for a, b in ((cos, sin), (sin, cos)))
        shape = Curvature(*(round(value * scale) for value in (xx, yy, 2 * (BEST - WORST) * sin * cos)))
        outcomes.append(dataclasses.replace(one, curvature=shape))
    result = dataclasses.replace(slid.result, regions=(*slid.result.regions[: -len(slid.tiles)], *outcomes))
    return Window(0, slid.config, slid.events, result, slid.tiles)


@pytest.fixture
def angles(slid, rng):
    return rng.permutation(np.arange(len(slid.tiles)) % 4) * (math.pi / 4)


@pytest.mark.parametrize("field", [
    pytest.param(lambda at: np.array([3.0, -1.0]), id="constant"),
    pytest.param(lambda at: 0.06 * (at - [63.5, 47.5]), id="zoom"),
    pytest.param(lambda at: 0.06 * (at - [63.5, 47.5])[::-1] * [-1, 1], id="turn"),
])  # fmt: skip
def test_a_field_that_agrees_is_trusted(slid, angles, field):
    window = made(slid, lambda k, at: np.add(field(at), 2), angles)
    assert window.sure.all() and window.trusted.mean() > 0.9


@pytest.mark.parametrize("off, trusted", [(0.2, True), (1.0, False), (3.0, False)])
def test_what_is_off_along_its_own_edges_is_not(slid, angles, off, trusted):
    """The covariance says 0.2 px there; the tiles around see it across their edges."""
    lost = len(slid.tiles) // 2
    along = np.array([-math.sin(angles[lost]), math.cos(angles[lost])])
    window = made(slid, lambda k, at: np.array([3.0, -1.0]) + off * (k == lost) * along, angles)
    assert window.sure[lost] and window.trusted[lost] == trusted
    assert np.delete(window.trusted, lost).mean() > 0.9, "one wrong tile takes no other along"


def test_edges_of_one_direction_bear_nothing_out(slid, angles):
    """The aperture problem of all tiles together: any v along the edges, the same in all, is as good as another."""
    assert not made(slid, lambda k, at: np.array([3.0, -1.0]), np.zeros_like(angles)).trusted.any()


def test_in_disorder_none_is_trusted(slid, angles, rng):
    """Some agree by chance."""
    random = rng.uniform(-4, 4, (len(slid.tiles), 2))
    window = made(slid, lambda k, at: random[k], angles)
    assert window.sure.all() and not window.trusted.any() and ORDERLY > 0


def test_short_and_doubtful_tiles_are_not_trusted(slid, angles):
    flags = [Flag(0), Flag.SHORT, Flag.DOUBTFUL] * len(slid.tiles)
    window = made(slid, lambda k, at: np.array([3.0, -1.0]), angles, flags=flags)
    assert not window.trusted[1::3].any() and not window.trusted[2::3].any() and window.trusted[::3].mean() > 0.8


def test_two_motions_side_by_side_are_both_trusted(slid, angles):
    window = made(slid, lambda k, at: [3.0, -1.0] if at[0] < 64 else [-1.0, 2.0], angles)
    left = np.array(slid.tiles.corners)[:, 0]
    assert window.trusted[left <= 16].mean() > 0.7 and window.trusted[left >= 64].mean() > 0.7
