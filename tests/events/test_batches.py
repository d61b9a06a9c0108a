"""The batch cutter, against plain loops over the events."""

import time

import numpy as np
import pytest

from cmfpga.errors import ConfigError, RecordingError
from cmfpga.events import BatchCutter, Events, MemoryRecording, batches
from support.recordings import assert_same, make_events

ROI = (50, 40, 64, 48)


@pytest.fixture(params=[7, 100, 1 << 16])
def chunk(request, monkeypatch):
    """Sizes of the chunks that are read and scanned: batches within one, and across many."""
    monkeypatch.setattr(batches, "CHUNK_EVENTS", request.param)
    monkeypatch.setattr(batches, "_SCAN_EVENTS", max(3, request.param // 16))


def cut(events, rois=None, /, **options):
    """All batches, and the cutter."""
    options.setdefault("max_events", 10**6)
    cutter = BatchCutter(MemoryRecording(events, 240, 180), **options)
    found = []
    while (batch := cutter.next(None if rois is None else rois(len(found)))) is not None:
        assert cutter.leftover == 0
        assert cutter.position == batch.first_event + len(batch)
        found.append(batch)
    assert cutter.next(ROI) is None
    return found, cutter


def check_nothing_lost(events, found, cutter, start=0):
    """Batches follow each other without gap, and with the leftover they are all events from ``start`` on."""
    firsts = np.cumsum([start, *map(len, found)])
    assert [batch.first_event for batch in found] == firsts[:-1].tolist()
    assert firsts[-1] + cutter.leftover == len(events)
    assert_same(Events.concatenate(found), events[start : firsts[-1]])


def by_duration(events, duration, max_events):
    """(length, cut short, begin of the window) of each batch, event by event; the leftover."""
    found, count, begin = [], 0, int(events.t[0])
    for t in events.t.tolist():
        while t >= begin + duration:
            found.append((count, False, begin))
            count, begin = 0, begin + duration
        if count == max_events:
            found.append((count, True, begin))
            count = 0
        count += 1
    return found, count


def by_roi(events, rois, wanted, max_events):
    found, count, inside = [], 0, 0
    for x, y in zip(events.x.tolist(), events.y.tolist(), strict=True):
        left, top, width, height = rois(len(found))
        count += 1
        inside += left <= x < left + width and top <= y < top + height
        if inside == wanted or count == max_events:
            found.append((count, inside < wanted))
            count, inside = 0, 0
    return found, count


def moving(k):
    return (ROI[0] + 3 * k % 100, ROI[1] - k % 90, *ROI[2:])


@pytest.mark.parametrize("size, start", [(1, 0), (300, 0), (300, 250), (999, 1), (1000, 0), (1001, 0)])
def test_by_events(rng, chunk, size, start):
    events = make_events(rng)
    found, cutter = cut(events, events=size, start_event=start)
    assert [len(batch) for batch in found] == [size] * ((1000 - start) // size)
    assert cutter.leftover == (1000 - start) % size
    assert not any(batch.cut_short or batch.window for batch in found)
    check_nothing_lost(events, found, cutter, start)


@pytest.mark.parametrize("duration, max_events", [(500, 10**6), (500, 60), (500, 1), (37, 5), (10, 3), (10**6, 300)])
def test_by_duration(rng, chunk, duration, max_events):
    events = make_events(rng)
    expected, leftover = by_duration(events, duration, max_events)
    found, cutter = cut(events, duration_us=duration, max_events=max_events)
    assert [(len(b), b.cut_short, b.window[0]) for b in found] == expected
    assert all(b.window[1] - b.window[0] == duration for b in found)
    assert all(((b.t >= b.window[0]) & (b.t < b.window[1])).all() for b in found)
    assert cutter.leftover == leftover
    check_nothing_lost(events, found, cutter)


def test_cases_occur(rng):
    """Empty windows, cut ones, and ones that hold just max_events; by ROI batches that are cut, and others."""
    events = make_events(rng)
    assert any(count == 0 for count, _, _ in by_duration(events, 10, 3)[0])
    assert any(short for _, short, _ in by_duration(events, 500, 60)[0])
    assert any(count == 3 and not short for count, short, _ in by_duration(events, 10, 3)[0])
    assert {short for _, short in by_roi(make_events(rng, 5000), moving, 20, 280)[0]} == {False, True}


def test_windows(chunk):
    """The end of one is exclusive; some are empty."""
    events = Events([100, 119, 120, 150, 210], [1, 2, 3, 4, 5], [0] * 5, [1] * 5)
    found, cutter = cut(events, duration_us=20)
    assert [batch.t.tolist() for batch in found] == [[100, 119], [120], [150], [], []]
    assert [batch.window for batch in found] == [(100, 120), (120, 140), (140, 160), (160, 180), (180, 200)]
    assert [batch.first_event for batch in found] == [0, 2, 3, 4, 4]
    assert cutter.leftover == 1


@pytest.mark.parametrize("max_events, expected", [(3, [3]), (4, []), (2, [2, 1]), (1, [1, 1, 1])])
def test_window_as_large_as_max_events(chunk, max_events, expected):
    """Just full is not cut short; and the last window is complete only if an event follows."""
    events = Events([0, 5, 9] + ([30] if max_events < 4 else []), *[[0] * (3 + (max_events < 4))] * 3)
    found, cutter = cut(events, duration_us=10, max_events=max_events)
    nonempty = [batch for batch in found if len(batch)]
    assert [len(batch) for batch in nonempty] == expected
    assert [batch.cut_short for batch in nonempty] == [True] * (len(expected) - 1) + [False] * bool(expected)
    assert cutter.leftover == (3 if max_events == 4 else 1)


@pytest.mark.parametrize("wanted, max_events", [(1, 10**6), (20, 10**6), (20, 280), (20, 100), (5, 5), (200, 10**6)])
@pytest.mark.parametrize("rois", [
    lambda k: ROI, moving,
    # Across the border of the sensor, and outside of it.
    lambda k: (-10, -10, 20, 20), lambda k: (235, 175, 64, 64), lambda k: (300, 300, 5, 5),
], ids=["fixed", "moving", "top left", "bottom right", "outside"])  # fmt: skip
def test_by_roi_events(rng, chunk, wanted, max_events, rois):
    events = make_events(rng, 5000)
    expected, leftover = by_roi(events, rois, wanted, max_events)
    found, cutter = cut(events, rois, roi_events=wanted, max_events=max_events)
    assert [(len(batch), batch.cut_short) for batch in found] == expected
    assert cutter.leftover == leftover
    check_nothing_lost(events, found, cutter)


def test_errors_of_the_recording_come_through(chunk):
    recording = MemoryRecording(Events([0, 5, 3, 9], [0] * 4, [0] * 4, [0] * 4), 2, 2)
    cutter = BatchCutter(recording, events=4, max_events=10)
    with pytest.raises(RecordingError, match="event 2 is 3 µs, after 5 µs"):
        cutter.next()
    with pytest.raises(RecordingError, match="first event 4"):
        BatchCutter(recording, events=4, max_events=10, start_event=4)


@pytest.mark.parametrize("options, message", [
    ({}, "no size given for batches: one of events, duration_us, roi_events"),
    (dict(events=5, duration_us=5), "events and duration_us given"),
    (dict(events=0), "events = 0: an integer of 1 or more"), (dict(duration_us=-3), "duration_us = -3"),
    (dict(roi_events=2.5), "roi_events = 2.5"), (dict(events=True), "events = True"),
    (dict(events=5, max_events=0), "max_events = 0"),
    (dict(events=101, max_events=100), "events = 101: at most 100"),
    (dict(roi_events=101, max_events=100), "roi_events = 101: at most 100"),
])  # fmt: skip
def test_options_not_allowed(rng, options, message):
    recording = MemoryRecording(make_events(rng), 240, 180)
    with pytest.raises(ConfigError, match=message):
        BatchCutter(recording, **{"max_events": 1000, **options})


@pytest.mark.parametrize("roi", [None, (1, 2, 3), (0, 0, 0, 5), (0, 0, 5, -1), (0.5, 0, 5, 5), 7])
def test_roi_not_allowed(rng, roi):
    cutter = BatchCutter(MemoryRecording(make_events(rng), 240, 180), roi_events=5, max_events=100)
    with pytest.raises(ConfigError, match="roi = "):
        cutter.next(roi)
    assert cutter.next(ROI) is not None


@pytest.mark.parametrize("size, options", [
    *((1 << 16, options) for options in (dict(events=20), dict(duration_us=100), dict(roi_events=2))),
    (10, dict(events=99_999)),
], ids=str)  # fmt: skip
def test_time_grows_with_the_events_only(rng, monkeypatch, size, options):
    """Small batches from large chunks, and one batch from many chunks: at least some 100,000 events/s."""
    monkeypatch.setattr(batches, "CHUNK_EVENTS", size)
    events = make_events(rng, 100_000)
    begin = time.process_time()
    found, cutter = cut(events, lambda k: ROI, **options)
    assert time.process_time() - begin < 5  # about 0.1 s; quadratic cutting takes minutes
    check_nothing_lost(events, found, cutter)
    assert len(found) >= 1000 or size == 10
