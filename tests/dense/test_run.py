"""Windows: every event is in one or left over, their length suits the motion, each stands on its own."""

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.errors import ConfigError
from cmfpga.events import Events, MemoryRecording, generate
from cmfpga.protocol.regions import Region, RegionTable
from cmfpga.protocol.settings import BatchSettings
from cmfpga.verilog.simulation import VerilatedCore
from support.flowing import FIELDS, measured


@pytest.mark.parametrize("how", [{"window_events": 7000}, {"window_us": 30_000}, {}, {"windows": 1}])
def test_events_in_are_events_out(sliding, how):
    windows, run = measured(sliding.recording(), **how, start_event=100)
    assert windows[0].events.first_event == 100
    parts = [window.events.t for window in windows]
    assert 100 + sum(map(len, parts)) + run.leftover == len(sliding.events)
    assert (np.concatenate(parts) == sliding.events.t[100 : 100 + sum(map(len, parts))]).all()
    assert [window.index for window in windows] == [*range(len(windows))] and run.leftover > 0
    if not how:  # as many events as suit the motion
        assert all(2.5 <= window.moved <= 5.5 for window in windows) and not run.limited


@pytest.mark.usefixtures("long_tools")
def test_slow_motion_meets_the_room_of_the_hardware():
    scene = generate(**{**FIELDS, "duration_us": 400_000}, size=(200, 160), velocity=(12.0, 5.0), contrast=8.0)
    windows, run = measured(scene.recording(), windows=1)
    assert len(windows[0].events) == 32767 and run.limited and windows[0].moved < 3


def test_of_one_small_object_windows_become_shorter():
    """On the first trial, of all events, it leaves its tiles; few tiles see it at all."""
    scene = generate(**FIELDS | {"duration_us": 300_000}, size=(24, 24), velocity=(120.0, -40.0), noise=0.1)
    windows, _ = measured(scene.recording(), windows=3)
    for window in windows:
        off = np.hypot(*(window.v - np.array([120.0, -40.0]) * window.half_s)[window.trusted].T)
        assert 2.5 <= window.moved <= 5.5 and len(off) >= 3 and np.median(off) < 0.8


def test_a_window_does_not_know_what_was_before_it(sliding):
    both, _ = measured(sliding.recording(), window_events=7000, windows=2)
    alone, _ = measured(sliding.recording(), window_events=7000, windows=1, start_event=7000)
    assert both[1].result == alone[0].result
    assert (both[0].v != both[1].v).any()


@pytest.mark.usefixtures("long_tools")
@pytest.mark.parametrize("how", [{"window_events": 8000}, {"window_us": 30_000}])
def test_a_window_for_every_slice(sliding, how):
    """Each is what it is alone; each event counts in every window that it lies in."""
    windows, run = measured(sliding.recording(), slices=4, start_event=100, **how)
    (mode, size), events = *how.items(), sliding.events
    begins = [window.events.first_event for window in windows]
    if mode == "window_events":
        assert begins == [*range(100, len(events) - size + 1, size // 4)]
        assert run.leftover == (len(events) - 100) % (size // 4)
    else:
        times = events.t[100] + np.arange(len(windows)) * size // 4
        assert begins == np.maximum(100, np.searchsorted(events.t, times)).tolist()
    assert len(windows) > 4 and [window.index for window in windows] == [*range(len(windows))]
    for window in windows[:: len(windows) - 1]:
        count = len(window.events)
        alone, _ = measured(sliding.recording(), window_events=count, windows=1, start_event=window.events.first_event)
        assert window.result == alone[0].result and window.t_ref == alone[0].t_ref
        assert (window.events.t == alone[0].events.t).all()
        first, last = window.events.t[[0, -1]]
        assert window.t_ref == (first + last) / 2 and 28_000 < last - first


@pytest.mark.parametrize("how, slices, why", [
    ({}, 4, "windows of 4 slices: a length"),
    ({"window_events": 8001}, 4, "a multiple of 4 events"),
    ({"window_us": 10_001}, 4, "a multiple of 4 µs"),
    ({"window_events": 40_000}, 4, "at most 32764 are allowed"),
    ({"window_events": 40_000}, 1, "at most 32767 are allowed"),
])  # fmt: skip
def test_lengths_that_are_refused(sliding, how, slices, why):
    with pytest.raises(ConfigError, match=why):
        measured(sliding.recording(), slices=slices, **how)


@pytest.mark.usefixtures("long_tools")
@pytest.mark.parametrize("slices", [1, 3])
def test_a_pause_does_not_end_a_run(sliding, slices):
    """Slices without events are counted and passed over: windows have the last slices with events."""
    events, late = sliding.events, sliding.events.t.copy()
    half = len(late) // 2
    late[half:] += 60_000
    paused = MemoryRecording(Events(late, events.x, events.y, events.p), 128, 96)
    windows, run = measured(paused, window_us=30_000, start_event=100, slices=slices)
    begin = late[100]
    # Windows of 30 ms, or slices of 10, of which those with events count; the last one is incomplete.
    number = ((late[100:] - begin) * slices // 30_000).astype(int)
    held = [np.flatnonzero(number == k) + 100 for k in range(number[-1])]
    with_events = [part for part in held if len(part)]
    assert len(with_events) < len(held)
    if slices == 1:
        assert [len(window.events) for window in windows] == [*map(len, held)] and not run.passed_over
        assert all(window.result.events == len(part) for window, part in zip(windows, held, strict=True))
        return
    assert run.passed_over == len(held) - len(with_events)
    assert len(windows) == len(with_events) - slices + 1 and [w.index for w in windows] == [*range(len(windows))]
    for k, window in enumerate(windows):
        first, last = with_events[k][0], with_events[k + slices - 1][-1]
        assert (window.events.t == late[first : last + 1]).all()
        assert window.result.events == len(window.events) == last + 1 - first
        assert window.result.span == late[last] - late[first]
    across = [window for window in windows if window.events.t[-1] - window.events.t[0] > 60_000]
    assert len(across) == slices - 1


def test_a_simulation_waits_for_whole_windows(monkeypatch):
    """Of objects with 16 slices: for as many events as the slices before may have, not only for those of the last."""
    config = preset("objects").replace(slices=16)
    hardware, waited = object.__new__(VerilatedCore), []
    hardware.config, hardware.table = config, RegionTable(config)
    hardware.write([Region(x=9, y=9, width=64, height=64)] * 32)

    def driven(batches, settings, gaps, stalls, iterations, limit):
        waited.append(limit)
        raise TimeoutError

    for name, does in (("_drive", driven), ("write_tables", lambda settings: None), ("_patience", lambda *_: 0)):
        monkeypatch.setattr(hardware, name, does, raising=False)
    with pytest.raises(TimeoutError):
        hardware.results([np.zeros((3, 1), np.int64)], chosen := BatchSettings.from_config(config, roi=(0, 0)))
    iterations = len(chosen.cold) * config.buffer_events
    assert waited[0] > 32 * (iterations + 15 * config.slice_events)
