"""ROI filter against its model: cropping, time range, counters, time stamps that wrap, step back or run too far."""

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.reference.integer.roi_filter import roi_filter
from cmfpga.rtl.ingest.roi_filter import RoiFilter
from support.bench import GAPS, flow_script, play
from support.configs import CONFIGS, NARROW, ODD, TINY
from support.values import edge_integers, random_gaps

SHAPES = {
    "default": CONFIGS["default"],
    "narrow": Config(**NARROW, time_bits=16, span_bits=12),
    "odd": Config(**ODD, time_bits=20, span_bits=19),
    "tiny": Config(**TINY, time_bits=8, span_bits=4),
    # No room to move: the ROI is the whole sensor.
    "whole": Config(roi_width=240, roi_height=180),
    # The span is half of the counter: nothing can lie beyond it, it would be a step back.
    "half": Config(**ODD, time_bits=8, span_bits=7),
}
COUNTERS = ("outside", "time_back", "time_span", "span", "t_first")


def check(config, batches, probability=0.0, seed=0):
    """Batches of (t, x, y, roi), back to back; returns the models' results."""
    rng = np.random.default_rng(seed)
    block = RoiFilter(config)
    script, pushed, expected, ends, results = [], set(), [], [], []
    for t, x, y, roi in batches:
        # `start` comes when the batch before is through; the ROI stays for the whole batch.
        script.append({"start": 1, "roi": {"x": roi[0], "y": roi[1]}})
        events = [{"t": t, "x": x, "y": y, "last": int(rng.integers(2))} for t, x, y in zip(t, x, y, strict=True)]
        gaps = random_gaps(rng, len(events), probability)
        part, cycles = flow_script(block, events, gaps, rng, drain=block.latency + 1)
        pushed |= {len(script) + cycle for cycle in cycles}
        model = roi_filter(config, t, x, y, roi=roi)
        script += part
        ends.append(len(script) - 1)
        results.append(model)
        expected += zip(model.t.tolist(), model.x.tolist(), model.y.tolist(), strict=True)
    recording = play(block, script, watch=[f"measured.{name}" for name in COUNTERS])
    assert [(value["t"], value["x"], value["y"]) for value in recording.values()] == expected
    assert {cycle - block.latency for cycle in recording.cycles()} <= pushed
    for (t, *_), end, model in zip(batches, ends, results, strict=True):
        got = {name: recording.watch[f"measured.{name}"][end] for name in COUNTERS}
        if len(t):
            assert got == {name: model.counts[name] for name in COUNTERS[:4]} | {"t_first": t[0]}
            assert model.counts["events"] == len(model.t) + got["outside"] + got["time_back"] + got["time_span"]
        else:
            assert [got[name] for name in COUNTERS[:4]] == [0, 0, 0, 0]
    return results


def random_batch(config, rng, count, *, errors=0.0):
    """Around the ROI's borders as often as anywhere; ``errors`` is the share of bad time stamps."""
    roi = (int(rng.integers(config.geometry.roi_x_max + 1)), int(rng.integers(config.geometry.roi_y_max + 1)))
    columns = []
    for corner, size, limit in zip(
        roi, (config.roi_width, config.roi_height), (config.sensor_width, config.sensor_height), strict=True
    ):
        border = rng.choice([corner - 1, corner, corner + 1, corner + size - 1, corner + size], count)
        inside = rng.integers(corner, corner + size, count)
        anywhere = rng.integers(0, limit, count)
        column = np.choose(rng.integers(0, 3, count), [border, inside, anywhere])
        columns.append(np.clip(column, 0, limit - 1).tolist())
    wrap = 1 << config.time_bits
    span = min(1 << config.span_bits, wrap // 2) - 1
    t = np.sort(rng.integers(0, span, count, endpoint=True))
    wrong = rng.random(count) < errors
    t = np.where(wrong, t + edge_integers(rng, -span, span + 1, count), t)  # just beyond, too
    return ((t + rng.integers(wrap)) % wrap).tolist(), *columns, roi


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("name", SHAPES)
def test_matches_model(name, gap, rng):
    """Batches of many sizes back to back, half of them with wrong time stamps."""
    config = SHAPES[name]
    batches = [
        random_batch(config, rng, count, errors=errors)
        for count in (40, 1, 3, 60, 2, 25) for errors in (0.0, 0.3)
    ]  # fmt: skip
    results = check(config, batches, GAPS[gap])
    assert sum(len(model.t) for model in results) > 20
    assert sum(model.counts["time_back"] for model in results) > 5
    assert name == "whole" or sum(model.counts["outside"] for model in results) > 5


def test_nothing_leaves_without_an_event():
    """An idle filter stays silent, from the first cycle."""
    assert all(model.counts["events"] == 0 for model in check(SHAPES["tiny"], [([], [], [], (0, 0))] * 3))


WRAP, LIMIT = 1 << 16, 1 << 12  # of "narrow"
#: Configuration, times, x, y; times that pass, the span; how many events lie outside, step back, run too far.
TIMES = {
    "the counter wraps": ("narrow", range(WRAP - 20, WRAP + 20, 2), 1, 1, list(range(0, 40, 2)), 38, (0, 0, 0)),
    # Against the last good event, however far back it is: 9, 3, −1 step back; 5 + half the counter's range lies beyond
    # the span; what follows is good again.
    "steps back": ("narrow", (5, 10, 9, 10, 3, -1, 11, WRAP // 2 + 4, 12), 1, 1, [0, 5, 5, 6, 7], 7, (0, 3, 1)),
    "the span ends exactly at its width": (
        "narrow", [7 + at for at in (0, LIMIT - 1, LIMIT, LIMIT + 1, LIMIT - 1, LIMIT - 2)], 0, 0,
        [0, LIMIT - 1, LIMIT - 1], LIMIT - 1, (0, 1, 2),
    ),
    "the first event, outside the ROI, sets the origin": (
        "odd", (1000, 1001, 1005), (39, 3, 3), (29, 3, 3), [1, 5], 5, (1, 0, 0)
    ),
    # One event, one counter.
    "a bad time comes before a wrong place": ("narrow", (100, 99, 100 + LIMIT, 101), 99, 49, [], 1, (2, 1, 1)),
}  # fmt: skip


@pytest.mark.parametrize("case", TIMES)
def test_times(case):
    name, t, x, y, passed, span, dropped = TIMES[case]
    config = SHAPES[name]
    columns = (np.broadcast_to(axis, len(t)).tolist() for axis in (x, y))
    (model,) = check(config, [([at % (1 << config.time_bits) for at in t], *columns, (0, 0))])
    assert (model.t.tolist(), model.counts["span"]) == (passed, span)
    assert tuple(model.counts[name] for name in ("outside", "time_back", "time_span")) == dropped


@pytest.mark.parametrize("name", ["narrow", "odd", "tiny", "whole"])
def test_every_border_of_every_corner_position(name):
    config = SHAPES[name]
    batches = []
    for roi in [(x, y) for x in (0, config.geometry.roi_x_max) for y in (0, config.geometry.roi_y_max)]:
        xs, ys = (
            {0, at - 1, at, at + side - 1, at + side, size - 1}
            for at, side, size in zip(
                roi, (config.roi_width, config.roi_height), (config.sensor_width, config.sensor_height), strict=True
            )
        )
        points = [(x, y) for x in xs for y in ys if 0 <= x < config.sensor_width and 0 <= y < config.sensor_height]
        batches.append(([3] * len(points), *map(list, zip(*points, strict=True)), roi))
    check(config, batches)
