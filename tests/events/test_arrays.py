"""Events in memory: what callers may give, and what is refused before it is cast."""

import warnings

import numpy as np
import pytest

from cmfpga import track
from cmfpga.errors import RecordingError
from cmfpga.events import Events

GOOD = {"t": [1_000, 2_000], "x": [3, 65_535], "y": [0, 5], "p": [0, 1]}


@pytest.mark.parametrize("p", [[-1, 1], [0, 1], [False, True], [-1.0, 1.0], np.array([-1, 1], np.int8)])
def test_polarities(p):
    events = Events(**{**GOOD, "p": p})
    assert events.p.tolist() == [0, 1] and events.p.dtype == np.uint8


@pytest.mark.parametrize("t, unit", [
    ([0.001, 0.002], "s"), ([1.0, 2.0], "ms"), ([1, 2], "ms"), ([1_000, 2_000], "us"), ([1_000, 2_000], None),
    (np.array([1_000, 2_000], ">u4"), None), (np.array([1_000, 2_000], ">M8[us]"), None),
    ([1_000_000, 1_999_500], "ns"),  # to the nearest, halves up
    (np.array([1_000_000, 2_000_000], "timedelta64[ns]"), None),
    (np.array([1_000_000, 2_000_000], "timedelta64[ns]"), "ns"),
    (np.array([1, 2], "timedelta64[ms]"), None),
    (np.array(["1970-01-01T00:00:00.001", "1970-01-01T00:00:00.002"], "datetime64[ms]"), None),
])  # fmt: skip
def test_times(t, unit):
    events = Events(**{**GOOD, "t": t}, time_unit=unit)
    assert events.t.tolist() == GOOD["t"] and events.t.dtype == np.int64


def test_whole_floats_are_pixels():
    events = Events(**{**GOOD, "x": [3.0, 65_535.0]})
    assert events.x.tolist() == [3, 65_535] and events.x.dtype == events.y.dtype == np.uint16


def test_what_fits_is_not_copied():
    t, x, p = np.arange(3), np.arange(3, dtype=np.uint16), np.zeros(3, np.uint8)
    events = Events(t, x, x, p)
    assert events.t is t and events.x is x and events.p is p


@pytest.mark.parametrize("wrong, message", [
    ({"t": [0.1, 0.2]}, "t holds float64, of no known unit; time_unit = s, ms, us, ns says which"),
    ({"t": [1.0, 2.0]}, "t holds float64, of no known unit; time_unit = s, ms, us, ns says which"),
    ({"t": [0.1, np.nan], "time_unit": "s"}, "time stamp of event 1 is nan; a finite number is needed"),
    ({"time_unit": "min"}, "time unit 'min' is not known; one of s, ms, us, ns is needed"),
    ({"t": np.array([1, 2], "m8[D]")}, "t holds timedelta64[D]; the unit s, ms, us, ns is needed"),
    ({"t": np.array([1, 2], "m8[10us]")}, "t holds timedelta64[10us]; the unit s, ms, us, ns is needed"),
    ({"t": np.array([1, 2], "m8[ns]"), "time_unit": "us"}, "t holds timedelta64[ns]; the unit us is needed"),
    ({"t": np.array([1, "nat"], "m8[ns]")}, "time stamp of event 1 is NaT; a time is needed"),
    ({"t": [True, False]}, "t holds bool; real numbers are needed"),
    ({"t": np.array([1, 2**64 - 1], np.uint64)}, f"time stamp of event 1 is {2**64 - 1} us; less than 2^62 µs"),
    ({"x": [3, 65_536 + 3]}, "x of event 1 is 65539; 0 to 65535 is allowed"),
    ({"y": [-1, 3]}, "y of event 0 is -1; 0 to 65535 is allowed"),
    ({"x": [3.5, 3]}, "x of event 0 is 3.5; a whole number of pixels is needed"),
    ({"y": [3, np.nan]}, "y of event 1 is nan; a whole number of pixels is needed"),
    ({"x": ["3", "4"]}, "x holds <U1; real numbers are needed"),
    ({"x": [[3, 4]]}, "x has 2 dimensions; 1 is needed"), ({"x": [3]}, "t, x, y and p must have one length"),
    ({"p": [0, 16]}, "polarity of event 1 is 16; 0 and 1, or -1 and 1, are usual; 2 to 15 and 255 go"),
    ({"p": np.array([0, 254], np.uint8)}, "polarity of event 1 is 254; 0 and 1, or -1 and 1, are usual"),
    ({"p": [0.5, 1]}, "polarity of event 0 is 0.5; 0 and 1, or -1 and 1, are usual"),
    ({"p": [np.nan, 1]}, "polarity of event 0 is nan; 0 and 1, or -1 and 1, are usual"),
])  # fmt: skip
def test_refused(wrong, message):
    with warnings.catch_warnings(), pytest.raises(RecordingError) as error:
        warnings.simplefilter("error")
        Events(**{**GOOD, **wrong})
    assert str(error.value).startswith(f"Events: {message}") and "\n" not in str(error.value)


def test_no_events():
    for events in (Events.empty(), Events([], [], [], []), Events.concatenate([])):
        assert len(events) == 0
        assert [getattr(events, name).dtype for name in "txyp"] == [np.int64, np.uint16, np.uint16, np.uint8]


def test_a_track_in_another_unit(rng):
    """Nanoseconds in memory, named as such: the same track as in µs, which are the default."""
    t = np.arange(3000) * 10
    x, y, p = rng.integers(240, size=3000), rng.integers(180, size=3000), rng.integers(2, size=3000)
    options = {"roi": (80, 60), "sensor": (240, 180), "engine": "model", "batch_events": 1500}
    expected = track(Events(t, x, y, p), **options)
    for factor, unit in ((1000, "ns"), (1, "us")):
        found = track(Events(t * factor, x, y, p), time_unit=unit, **options)
        assert found.vx_px_per_s.tolist() == expected.vx_px_per_s.tolist()
        assert found.t_ref_us.tolist() == expected.t_ref_us.tolist()
    with pytest.raises(RecordingError, match=r"^Events: time unit 'min' is not known"):
        track(Events(t, x, y, p), time_unit="min", **options)
