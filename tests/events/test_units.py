"""The rule that finds the unit of time, and the conversion to µs."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cmfpga.errors import RecordingError
from cmfpga.events import open_recording
from cmfpga.events.units import TIME_UNITS, guess_unit, parse_unit, to_us
from support.recordings import assert_reads


def clock(rng, rate, count=20_000, start=0):
    """Times in whole µs of events at a mean rate (events/s)."""
    return start + np.cumsum(rng.exponential(1e6 / rate, count)).astype(np.int64)


@pytest.mark.parametrize("start", [0, 10**9, 1_500_000_000_000_000])
@pytest.mark.parametrize("rate", [1e3, 3e4, 1e6, 2e7])
def test_rates_of_event_cameras(rng, rate, start):
    us = clock(rng, rate, start=start)
    assert guess_unit(us) == "us"
    assert guess_unit(us.astype(np.float64)) == "us"
    assert guess_unit(us * 1000) == "ns"  # a clock of 1 µs written in ns
    assert guess_unit(us * 1e-6) == "s"
    assert guess_unit(us / 1000) == "ms"


@pytest.mark.parametrize("rate, unit", [(1e3, "us"), (5e4, "us"), (1e6, "ms")])
def test_fractions_that_no_clock_of_1_us_gives(rng, rate, unit):
    """A simulator's: told apart by the rate alone. Above 100,000 events/s fractions of µs, or of ms, look like the next
    larger unit, unless they count from 1970."""
    t = np.cumsum(rng.exponential(1e6 / rate, 20_000))
    assert [guess_unit(t * 1e-6), guess_unit(t / 1000), guess_unit(t)] == ["s", "ms" if unit == "us" else "s", unit]
    epoch = t + 1.5e15
    assert [guess_unit(epoch * 1e-6), guess_unit(epoch / 1000), guess_unit(epoch + 0.25)] == ["s", "ms", "us"]


@pytest.mark.parametrize("unit, digits, power", [("ms", 3, -3), ("us", 2, 0), ("s", 6, -6), ("us", 0, 0), ("ns", 0, 3)])
def test_fractions_and_whole_numbers_in_text(tmp_path, rng, unit, digits, power):
    us = clock(rng, 6e4, 6000, start=5000)
    path = tmp_path / "a.csv"
    rest = 0.25 if digits == 2 else 0
    path.write_text("".join(f"{(t + rest) * 10.0**power:.{digits}f},1,1,1\n" for t in us))
    recording = assert_reads(path, {"t": us.tolist()})
    assert (recording.time_unit, recording.time_unit_source) == (unit, "assumed")


@pytest.mark.parametrize("rate, unit", [(2e4, "ns"), (8e4, "ns"), (1e6, "us")])
def test_true_nanosecond_clock_by_its_rate(rng, rate, unit):
    """Below 100 events/s if read as µs; faster ones are not told apart, unless the times say so."""
    ns = clock(rng, rate) * 1000 + rng.integers(0, 1000, 20_000)
    ns.sort()
    assert guess_unit(ns) == unit
    assert guess_unit(ns + 1_500_000_000 * 10**9) == "ns"


@pytest.mark.parametrize("rate, unit", [(2e5, "ms"), (1e6, "ms"), (5e4, "us")])
def test_milliseconds_by_their_rate(rng, rate, unit):
    assert guess_unit(clock(rng, rate) // 1000) == unit


@pytest.mark.parametrize("unit, factor", [("us", 1), ("ns", 1000)])
def test_a_jump_or_a_pause_changes_nothing(rng, unit, factor):
    us = clock(rng, 2e4, 5_000, start=7)
    late = np.concatenate([[0], us + 5_000_000_000])  # the first event at 0
    pause = np.concatenate([us[:2_000], us[2_000:] + 3_600_000_000])
    bursts = us + np.repeat(np.arange(50) * 1_400_000, 100)  # 70 events/s on average
    assert [guess_unit(t * factor) for t in (late, pause, bursts)] == [unit] * 3


def test_few_events_are_no_evidence():
    assert guess_unit([0, 1_000_000, 2_000_000]) == "us"
    assert guess_unit([5, 5, 5]) == "us"
    assert guess_unit(np.zeros(9_999, int)) == "us"
    assert guess_unit(np.zeros(10_000, int)) == "ms"
    assert guess_unit([]) == "us"
    assert guess_unit([0.0, np.nan, 0.5]) == "s"
    assert guess_unit([0.0, np.inf, 5.0]) == "us"


@pytest.mark.parametrize("ticks, unit", [(99, "us"), (100, "ns")])
def test_multiples_of_1000_need_many_ticks(ticks, unit):
    """2,000 events in groups of one time stamp, 1,000 apart: by chance only if they are few."""
    assert guess_unit(np.arange(2000) * ticks // 2000 * 1000) == unit


def test_coarse_clock_in_microseconds_is_not_taken_for_nanoseconds(rng):
    assert guess_unit(clock(rng, 2e5, 65_536) // 1000 * 1000) == "us"


def test_in_files(write, rng):
    us = clock(rng, 1e5, 2000, start=7)
    x, p = us % 200, us % 2
    if (write_ns := write(us * 1000, x, x, p)).suffix not in (".txt", ".zip", ".gz"):  # the text is in seconds
        recording, unit = assert_reads(write_ns, {"t": us.tolist()}), "ns"
    else:
        recording, unit = open_recording(write(us, x, x, p)), "s"
    with recording:
        assert (recording.time_unit, recording.time_unit_source) == (unit, "assumed")


@pytest.mark.parametrize(
    "text, unit", [("s", "s"), (" Seconds", "s"), ("µs", "us"), (b"ns", "ns"), (np.str_("ms"), "ms"), ("usec", "us")]
)
def test_spellings(text, unit):
    assert parse_unit(text, "file") == unit


@pytest.mark.parametrize("text", ["", "minutes", 3, None, "u"])
def test_not_a_unit(text):
    with pytest.raises(RecordingError, match=r"^file: time unit .* is not known; one of s, ms, us, ns is needed$"):
        parse_unit(text, "file")


@settings(deadline=None)
@given(t=st.integers(-(10**12), 10**12), unit=st.sampled_from(TIME_UNITS))
def test_integers_are_exact(t, unit):
    exact = Fraction(t) * {"s": 10**6, "ms": 1000, "us": 1, "ns": Fraction(1, 1000)}[unit]
    assert to_us(np.array([t]), unit, "file").tolist() == [(exact + Fraction(1, 2)).__floor__()]


@pytest.mark.parametrize("dtype", [np.int64, np.uint64, np.int32, np.float64, np.float32])
def test_types(dtype):
    assert to_us(np.array([0, 1500, 2499], dtype), "ns", "file").tolist() == [0, 2, 2]
    assert to_us(np.array([0, 3], dtype), "s", "file").tolist() == [0, 3_000_000]


@pytest.mark.parametrize("t", [np.uint64(2**63), 2**62 // 10**6 + 1, -(2**62), 1e20])
def test_out_of_range(t):
    with pytest.raises(RecordingError, match=r"^file: time stamp of event 8 is .* s; less than 2\^62 µs is allowed$"):
        to_us(np.array([0, t], np.array(t).dtype), "s", "file", first_event=7)
