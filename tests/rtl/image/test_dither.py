"""Dither against its model: the k-th stored event gets the k-th offset in every replay, whatever came before."""

import numpy as np
import pytest

from cmfpga.reference.integer.event_path import dither
from cmfpga.rtl.image.dither import Dither
from support.bench import GAPS, play
from support.configs import LEVELS, SIGNS
from support.values import edge_integers, random_gaps, random_values, tensor

SHAPES = (
    LEVELS
    | SIGNS
    | {
        "one bit": LEVELS["fast"].replace(dither_frac=1),
        "sensor": LEVELS["fast"].replace(roi_width=240, roi_height=180, tag_bits=10),
    }
)


def check(config, replays, gaps):
    """``replays`` are lists of (t, x, y), played one after the other, each a subset of which is used."""
    rng = np.random.default_rng(1)
    block = Dither(config)
    noise = random_values(block.i.payload.shape(), rng)
    script, expected, cycles, gaps = [], [], [], iter(gaps)
    for events in replays:
        _, x, y = (tensor(column) for column in zip(*events, strict=True))
        moved = [axis.tolist() for axis in dither(config, x, y)]
        chosen, subset = range(len(events)), {}
        if config.ascent_rule.strides:  # else a replay begins behind the last event
            stride = int(rng.integers(3))
            first = int(rng.integers(min(1 << stride, len(events))))
            subset = {"subset": {"stride": stride, "first": first}}
            script.append({"started": 1, "i.payload": next(noise)} | subset)
            chosen = chosen[first :: 1 << stride]
        for k in chosen:
            t, last = events[k][0], int(k == chosen[-1])
            script += [{"i.payload": next(noise)} | subset] * next(gaps)
            cycles.append(len(script) + block.latency)
            item = {"t": t, "x": events[k][1], "y": events[k][2], "last": last}
            script.append({"i.valid": 1, "i.payload": item} | subset)
            expected.append({"t": t, "x": moved[0][k], "y": moved[1][k], "last": last})
    recording = play(block, [*script, *[{}] * 3])
    assert recording.values() == expected and recording.cycles() == cycles


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
    """Replays of any length and subset back to back: the sequence begins anew with each of them, and only then."""
    config = SHAPES[name]
    lengths = [1, 1, 2, 50, 1, 3, 80]
    replays = [random_replay(config, rng, count) for count in lengths]
    check(config, replays, random_gaps(rng, sum(lengths), GAPS[gap]))


def test_every_replay_of_a_batch_is_the_same(rng):
    config = SHAPES["similarity"]
    check(config, [random_replay(config, rng, 20)] * 4, [0] * 80)
