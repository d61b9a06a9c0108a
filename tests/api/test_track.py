"""``cmfpga.Tracker``: events piece by piece give the track of all of them together; and ``roi="auto"``."""

import itertools
import threading

import numpy as np
import pytest

import cmfpga
from cmfpga.errors import ConfigError, RecordingError
from cmfpga.events import Events, generate
from cmfpga.events.units import TIME_UNITS
from support.designs import FAST

START = {"roi": (8, 9), "sensor": (32, 24), "engine": "model", **FAST}


def pieces(events, sizes):
    """``events`` cut into pieces of these sizes, over and over."""
    first = 0
    for size in itertools.cycle(sizes):
        if first >= len(events):
            return
        yield events[first : first + size]
        first += size


@pytest.mark.parametrize("size", [{"batch_events": 90}, {"batch_us": 900}, {"batch_roi_events": 30}], ids=str)
@pytest.mark.parametrize("sizes", [(1,), (7, 0, 200), (90,), (1000,)], ids=str)
def test_however_the_events_are_cut(dot_events, size, sizes):
    expected = cmfpga.track(dot_events, **START, **size)
    with cmfpga.Tracker(**START, **size) as tracker:
        found = [batch.row() for piece in pieces(dot_events, sizes) for batch in tracker.push(piece)]
    assert found == [tuple(row) for row in expected._kept.rows] and len(found) >= 5
    assert tracker.tracking.vx.tolist() == expected.vx.tolist() and "pushed events" in repr(tracker.tracking)
    assert tracker.leftover == 600 - tracker.tracking.events.sum() > 0


def test_a_batch_comes_with_its_last_event(dot_events):
    with cmfpga.Tracker(**START, batch_events=90, keep=False) as tracker:
        assert tracker.push(dot_events[:89]) == []
        (batch,) = tracker.push(dot_events[89:90])
        assert len(batch.events) == 90 and not tracker.push(dot_events[90:100]) and not len(tracker.tracking)


FIELDS = {
    "tonic": [("x", "<i2"), ("y", "<i2"), ("t", "<i8"), ("p", "<i2")],
    "metavision": {"names": ["x", "y", "p", "t"], "formats": ["<u2", "<u2", "<i2", "<i8"], "offsets": [0, 2, 4, 8]},
    "expelliarmus": [("t", "<i8"), ("x", "<i2"), ("y", "<i2"), ("p", "u1")],
    "faery": [("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")],
    "dv": [("timestamp", "<i8"), ("x", "<i2"), ("y", "<i2"), ("polarity", "i1")],
}


@pytest.mark.parametrize("name", FIELDS)
def test_arrays_of_other_programs(dot_events, name):
    array = np.zeros(600, FIELDS[name])
    for field in array.dtype.names:
        array[field] = getattr(dot_events, {"on": "p", "polarity": "p", "timestamp": "t"}.get(field, field))
    with cmfpga.Tracker(**START, batch_events=90) as tracker:
        tracker.push(array)
    assert tracker.tracking.vx.tolist() == cmfpga.track(dot_events, **START, batch_events=90).vx.tolist()


def test_units_of_time(dot_events):
    for unit, factor in zip(TIME_UNITS, (1e-6, 1e-3, 1, 1000), strict=True):
        with cmfpga.Tracker(**START, batch_events=90, time_unit=unit) as tracker:
            (batch,) = tracker.push((dot_events.t[:90] * factor, *(getattr(dot_events, name)[:90] for name in "xyp")))
        assert batch.t_ref == 50_445, unit


def test_mistakes(dot_events):
    with pytest.raises(RecordingError, match="Tracker: sensor 32; \\(width, height\\)"):
        cmfpga.Tracker(**{**START, "sensor": 32})
    with pytest.raises(ConfigError, match="--roi auto: its events come only once"):
        cmfpga.Tracker(**{**START, "roi": "auto"})
    tracker = cmfpga.Tracker(**START, batch_events=90)
    tracker.push(dot_events[:80])
    for wrong, message in (
        (dot_events[70:90], "pushed events: time stamp of event 80 is "),
        (Events(dot_events.t[80:82], [3, 32], [4, 4], [0, 1]), "x of event 81 is 32; 0 to 31 is allowed"),
        (np.zeros((3, 5)), "events: ndarray of 3×5; \\(t, x, y, p\\)"),
        (np.zeros(3, [("t", int), ("x", int)]), "events: y and p missing"),
        ([[50_800, 1, 1, 0], [50_801, 1, 1, 7]], "events: polarity of event 1 is 7; 0 and 1, -1 and 1, or 1 and 2 are"),
        ([[50_800, 1, 1, 1], [50_801, -2, 1, 1]], "Events: x of event 1 is -2; 0 to 65535 is allowed"),
        ([[np.nan, 1, 1, 1]], "Events: time stamp of event 0 is nan; a finite number is needed"),
        ([[50_800.5, 1, 1, 1]], "Events: t holds float64, of no known unit; time_unit = s, ms, us, ns says which"),
    ):
        with pytest.raises(RecordingError, match=message):
            tracker.push(wrong)
    # Nothing of what was refused is in the batch. Whole floats are whole numbers.
    (batch,) = tracker.push(np.stack([getattr(dot_events, name)[80:90] for name in "txyp"], axis=1).astype(float))
    np.testing.assert_array_equal(batch.events.t, dot_events.t[:90])
    tracker.close()
    tracker.close()
    with pytest.raises(ConfigError, match="Tracker: it is closed"):
        tracker.push(dot_events[90:])


def test_two_threads(dot_events):
    """Each event is taken once, or refused for its time; the track is that of all that were taken, in their order."""
    taken, refused = [], []
    with cmfpga.Tracker(**START, batch_events=90) as tracker:
        push = tracker._feed.push
        tracker._feed.push = lambda events: (push(events), taken.append(events))

        def run(first):
            for k in range(first, 600, 20):
                try:
                    tracker.push(dot_events[k : k + 10])
                except RecordingError:
                    refused.append(k)

        threads = [threading.Thread(target=run, args=(first,)) for first in (0, 10)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    together = Events.concatenate(taken)
    assert len(together) + 10 * len(refused) == 600 and len(together) >= 300
    assert tracker.tracking.events.sum() + tracker.leftover == len(together)
    assert tracker.tracking.vx.tolist() == cmfpga.track(together, **START, batch_events=90).vx.tolist()


def test_what_fails_closes_the_tracker(dot_events, monkeypatch):
    tracker = cmfpga.Tracker(**START, batch_events=90)
    monkeypatch.setattr("cmfpga.engines.model.ModelEngine._run", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        tracker.push(dot_events)
    with pytest.raises(ConfigError, match="Tracker: it is closed"):
        tracker.push(dot_events)


def test_roi_auto_finds_what_moves():
    """The command's choice: the object, and batches in which its image moves by about 4 px per half batch."""
    scene = generate(seed=2, position=(132.0, 62.0), velocity=(90.0, 20.0), duration_us=300_000, noise=0.3)
    tracking = cmfpga.track(scene, roi="auto", engine="model", batches=3)
    assert np.abs(np.median(tracking.vx_px_per_s) - 90) < 10 and np.abs(np.median(tracking.vy_px_per_s) - 20) < 10
    assert 2.5 <= np.median(np.hypot(tracking.vx, tracking.vy)) <= 3.5 and tracking.config.slides
    batches = cmfpga.track(scene, preset="fast", roi="auto", engine="model", batches=3)
    assert 3 <= np.median(np.hypot(batches.vx, batches.vy)) <= 5 and not batches.config.slides
    assert cmfpga.track(scene, roi="auto", engine="model", batches=1, batch_events=800).events.tolist() == [800]
    with pytest.raises(ConfigError, match="nothing moves clearly and far enough"):
        cmfpga.track(Events(range(100), [3] * 100, [4] * 100, [0] * 100), roi="auto", sensor=(64, 64), hot_pixels=0)
