"""Mask of hot pixels and filter of background activity against their model, and the model against its definition."""

import dataclasses

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.protocol.settings import BatchSettings
from cmfpga.protocol.tables import mask_words
from cmfpga.reference.integer.filters import NoiseFilter
from cmfpga.rtl.ingest.noise_filter import BackgroundFilter, HotMask
from support.bench import GAPS, check_latency, flow_script, play
from support.configs import NARROW, ODD, TINY
from support.values import random_gaps

BOTH = {"hot_pixels": 1, "background": 1}
SHAPES = {
    "odd": Config(**ODD, **BOTH, span_bits=12, background_cell=2),
    "narrow": Config(**NARROW, **BOTH, span_bits=10, background_cell=3),
    "tiny": Config(**TINY, **BOTH, time_bits=8, span_bits=6, background_cell=1),
    # The whole sensor is one cell, and time stamps count as far as the camera's.
    "one cell": Config(**TINY, **BOTH, time_bits=10, span_bits=9, background_cell=6),
}


def random_batches(config, rng, count=6):
    """``(t, x, y, settings)`` each: often the same cell or pixel again; times that wrap, jump, and step back."""
    time, batches = int(rng.integers(1 << config.time_bits)), []
    for _ in range(count):
        n = int(rng.integers(1, 90))
        near = rng.integers(0, 1 << config.background_cell, (2, n))
        x, y = rng.integers(0, config.sensor_width, n), rng.integers(0, config.sensor_height, n)
        burst = rng.random(n) < 0.6
        x[burst], y[burst] = (axis[burst] + start for axis, start in zip(near, (x[0], y[0]), strict=True))
        same = rng.random(n) < 0.3
        x[same], y[same] = x[0], y[0]
        x, y = np.minimum(x, config.sensor_width - 1), np.minimum(y, config.sensor_height - 1)
        step = rng.integers(0, 5, n) + (rng.random(n) < 0.05) * rng.integers(0, 1 << config.span_bits, n)
        step[rng.random(n) < 0.05] *= -1
        t = (time + np.cumsum(step)) % (1 << config.time_bits)
        time = int(t[-1])
        pixels = [(int(rng.integers(config.sensor_width)), int(rng.integers(config.sensor_height))) for _ in range(4)]
        hot = tuple(sorted({*pixels, (int(x[0]), int(y[0]))})) if rng.random() < 0.6 else ()
        most = config.widths.background_us_max
        period = int(rng.choice([0, 1, 3, 10, most // 2, most]))
        settings = dataclasses.replace(BatchSettings.from_config(config), hot_mask=hot, background_us=min(period, most))
        batches.append((t.tolist(), x.tolist(), y.tolist(), settings))
    return batches


def by_definition(config, batches):
    """``(hot, noise)`` of each batch, event by event, from all events that came before."""
    wrap, seen, found = 1 << config.span_bits, [], []
    for t, x, y, settings in batches:
        marks = []
        for time, column, row in zip(t, x, y, strict=True):
            if (column, row) in settings.hot_mask:
                marks.append((True, False))
                continue
            cell = column >> config.background_cell, row >> config.background_cell
            others = [then for then, where, pixel in seen if where == cell and pixel != (column, row)]
            old = not others or (time - others[-1]) % wrap > settings.background_us
            marks.append((False, bool(settings.background_us and old)))
            seen.append((time, cell, (column, row)))
        found.append(marks)
    return found


def masked(config, pixels):
    """The script that writes a mask: all words of it, those without a hot pixel too."""
    words = mask_words(config, pixels)
    places = ((column, row) for row in range(config.sensor_height) for column in range(config.geometry.mask_columns))
    return [
        {"write.valid": 1, "write.payload": {"column": column, "row": row, "bits": words.get((column, row), 0)}}
        for column, row in places
    ]


def through(block, batches, rng, probability, *, before, start, hot=None):
    """Play batches; what came out for each of their events, which is checked to be itself, and in its cycle.

    ``before(number, settings)`` is a script, and ``start(settings)`` are inputs, of each batch; ``hot`` the events'
    marks.
    """
    script, sent, pushed = [], [], []
    for number, (t, x, y, settings) in enumerate(batches):
        script += before(number, settings)
        script.append({"start": 1, **start(settings)})
        events = [{"t": t, "x": x, "y": y, "last": 0} for t, x, y in zip(t, x, y, strict=True)]
        if hot:
            events = [event | {"hot": int(mark)} for event, mark in zip(events, hot[number], strict=True)]
        part, cycles = flow_script(block, events, random_gaps(rng, len(events), probability), rng)
        pushed += [len(script) + cycle for cycle in cycles]
        script += part
        sent += events
    recording = play(block, script)
    recording.flows["o"] = [item for item in recording.flows["o"] if item[0] >= pushed[0]]  # what came before is noise
    check_latency(block, pushed, recording)
    assert all(event.items() <= value.items() for event, value in zip(sent, recording.values(), strict=True))
    return recording.values()


def noise(config, batches, rng, probability=0.0, *, hot=None, used=()):
    """Play batches through a background filter that is cleared before the first, after the script ``used``."""
    block = BackgroundFilter(config)
    clear = [*used, {"clear": 1}, *[{}] * (config.geometry.cell_depth + block.latency)]
    return through(
        block, batches, rng, probability, hot=hot,
        before=lambda number, _: [] if number else clear,
        start=lambda settings: {"period": settings.background_us},
    )  # fmt: skip


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("name", SHAPES)
def test_hardware_and_model_are_as_defined(name, gap, rng):
    """Batches of one cell and of one pixel in consecutive cycles; the memories begin with anything."""
    config = SHAPES[name]
    batches = random_batches(config, rng)
    wanted = by_definition(config, batches)
    assert {mark for marks in wanted for mark in marks} == {(False, False), (False, True), (True, False)}
    model = NoiseFilter(config)
    for (t, x, y, settings), marks in zip(batches, wanted, strict=True):
        assert list(zip(*(mask.tolist() for mask in model.judge(t, x, y, settings)), strict=True)) == marks
    hot = [[mark for mark, _ in marks] for marks in wanted]

    came = through(
        HotMask(config), batches, rng, GAPS[gap],
        before=lambda number, settings: masked(config, settings.hot_mask),
        start=lambda settings: {"enable": int(bool(settings.hot_mask))},
    )  # fmt: skip
    assert [bool(value["hot"]) for value in came] == [mark for marks in hot for mark in marks]

    used = [{"i.valid": 1, "i.payload": {"t": k, "x": k % 3, "y": 0, "last": 0, "hot": 0}} for k in range(40)]
    came = noise(config, batches, rng, GAPS[gap], hot=hot, used=used)
    assert [(bool(value["hot"]), bool(value["noise"])) for value in came] == [m for marks in wanted for m in marks]


def test_a_mask_that_is_not_enabled_marks_nothing(rng):
    """Whatever a reset left in it; and a batch under way keeps what it began with."""
    config = SHAPES["odd"]
    batches = [([1, 2], [3, 4], [5, 6], None)] * 2
    everything = masked(config, [(x, y) for x in range(config.sensor_width) for y in range(config.sensor_height)])
    enabled = iter((0, 1))
    came = through(
        HotMask(config), batches, rng, 0.0,
        before=lambda number, _: [{"enable": 1 - number}, *everything], start=lambda _: {"enable": next(enabled)},
    )  # fmt: skip
    assert [value["hot"] for value in came] == [0, 0, 1, 1]


def test_cleared_after_exactly_one_sweep():
    config = SHAPES["odd"]
    cells = config.geometry.cell_depth
    recording = play(BackgroundFilter(config), [{"clear": 1}, *[{}] * (cells + 4)], watch=["cleared"])
    assert recording.watch["cleared"] == [0] * (cells + 1) + [1] * 4


def test_background_without_a_mask(rng):
    """The block has no mark to look at."""
    config = SHAPES["odd"].replace(hot_pixels=0)
    settings = dataclasses.replace(BatchSettings.from_config(config), background_us=5)
    batches = [([0, 2, 3, 100, 104, 110], [8, 8, 9, 9, 9, 8], [4] * 6, settings)]
    came = noise(config, batches, rng)
    # Alone; the same pixel; supported; too late; the same pixel, 9's neighbour last at 2; supported 6 µs ago: too late.
    assert [value["noise"] for value in came] == [1, 1, 0, 1, 1, 1]
    assert [mark for _, mark in by_definition(config, batches)[0]] == [1, 1, 0, 1, 1, 1]
    assert NoiseFilter(config).judge(*batches[0])[1].tolist() == [1, 1, 0, 1, 1, 1]


@pytest.mark.parametrize("distance", range(1, 8))
def test_support_reaches_exactly_as_far_as_it_says(distance, rng):
    """Two events so many cycles apart: each forwarding register, and the RAM behind them; 7 µs is enough, 8 is not."""
    config = SHAPES["odd"]
    settings = dataclasses.replace(BatchSettings.from_config(config), background_us=7)
    others = [(30, 20 + k) for k in range(distance - 1)]  # of other cells, or of none
    for late in (7, 8):
        events = [(0, 8, 4), *((0, x, y) for x, y in others), (late, 9, 4)]
        model = NoiseFilter(config).judge(*(np.array(column) for column in zip(*events, strict=True)), settings)
        batch = (*map(list, zip(*events, strict=True)), settings)
        came = noise(config, [batch], rng, hot=[[0] * len(events)])
        assert [value["noise"] for value in came] == model[1].tolist()
        assert came[-1]["noise"] == (late == 8)
