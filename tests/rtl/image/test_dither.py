"""Dither against its model: the k-th event of every replay gets the k-th offset, whatever came before."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cmfpga.reference.integer.dither import dither
from cmfpga.rtl.image.dither import Dither
from support.bench import GAPS, check_flow
from support.configs import LEVELS
from support.values import corners, edge_integers, integers_at_edges, random_gaps, tensor

SHAPES = LEVELS | {
    "one bit": LEVELS["fast"].replace(dither_frac=1),
    "sensor": LEVELS["fast"].replace(roi_width=240, roi_height=180, tag_bits=10),
}


def check(config, replays, gaps):
    """``replays`` are lists of (t, x, y), played one after the other."""
    items, expected = [], []
    for events in replays:
        _, x, y = (list(column) for column in zip(*events, strict=True))
        moved = dither(config, tensor(x), tensor(y))
        for k, (event, position) in enumerate(
            zip(events, zip(*(axis.tolist() for axis in moved), strict=True), strict=True)
        ):
            last = int(k == len(events) - 1)
            items.append({"t": event[0], "x": event[1], "y": event[2], "last": last})
            expected.append({"t": event[0], "x": position[0], "y": position[1], "last": last})
    return check_flow(Dither(config), items, expected, gaps=gaps, rng=np.random.default_rng(1))


def random_replay(config, rng, count):
    return list(
        zip(
            rng.integers(0, 1 << config.span_bits, count).tolist(),
            edge_integers(rng, 0, config.roi_width - 1, count).tolist(),
            edge_integers(rng, 0, config.roi_height - 1, count).tolist(),
            strict=True,
        )
    )


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("name", SHAPES)
def test_matches_model(name, gap, rng):
    """Replays of any length back to back: the sequence begins anew behind each last event, and only there."""
    config = SHAPES[name]
    lengths = [1, 1, 2, 50, 1, 3, 80]
    replays = [random_replay(config, rng, count) for count in lengths]
    check(config, replays, random_gaps(rng, sum(lengths), GAPS[gap]))


def test_every_replay_of_a_batch_is_the_same(rng):
    config = SHAPES["fast"]
    events = random_replay(config, rng, 20)
    check(config, [events] * 4, [0] * 80)


@corners
@given(st.data())
def test_corners(data):
    config = SHAPES[data.draw(st.sampled_from(sorted(SHAPES)))]
    event = st.tuples(
        integers_at_edges(0, (1 << config.span_bits) - 1),
        integers_at_edges(0, config.roi_width - 1),
        integers_at_edges(0, config.roi_height - 1),
    )
    replays = data.draw(st.lists(st.lists(event, min_size=1, max_size=12), min_size=1, max_size=5))
    gaps = data.draw(st.lists(st.integers(0, 2), min_size=sum(map(len, replays)), max_size=sum(map(len, replays))))
    check(config, replays, gaps)


# ---------------------------------------------------------------- the model


@pytest.mark.parametrize("frac", [1, 4, 8])
def test_offsets_are_those_of_the_r2_sequence(frac):
    """frac((k + ½)·α) − ½ with α of many digits, floored; the constants' 24 bits may move an offset by one step."""
    g = Fraction("1.32471795724474602596090885447809734")
    assert abs(g**3 - g - 1) < Fraction(1, 10**30)
    config = SHAPES["fast"].replace(dither_frac=frac)
    count = 4096
    offsets = [axis.tolist() for axis in dither(config, tensor([0] * count), tensor([0] * count))]
    one, half = 1 << frac, 1 << (frac - 1)
    for offset, alpha in zip(offsets, (1 / g, 1 / g**2), strict=True):
        exact = [(Fraction(2 * k + 1, 2) * alpha) % 1 for k in range(count)]
        # By so much k constants of 24 bits can be off.
        slack = Fraction(count, 1 << 24)
        for raw, value in zip(offset, exact, strict=True):
            assert raw + half in {int((value + near) % 1 * one) for near in (-slack, 0, slack)}
        assert (min(offset), max(offset)) == (-half, half - 1)


def test_offsets_cover_the_pixel_evenly():
    """Each of 16 × 16 places of the pixel gets its share of 2048 events, to within what no random sequence would."""
    config = SHAPES["fast"]
    x, y = (axis.numpy() + 8 for axis in dither(config, tensor([0] * 2048), tensor([0] * 2048)))
    counts = np.bincount(16 * y + x, minlength=256)
    assert len(counts) == 256 and 5 <= counts.min() and counts.max() <= 11


def test_no_dither_leaves_positions_alone(rng):
    config = SHAPES["fast"].replace(dither_frac=0)
    x, y = tensor(rng.integers(0, 64, 9)), tensor(rng.integers(0, 64, 9))
    assert all((a == b).all() for a, b in zip(dither(config, x, y), (x, y), strict=True))
