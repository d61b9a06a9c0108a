"""Windows that slide: against plain lists and loops, event by event, and against the batches that they are without."""

import dataclasses
import itertools
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from cmfpga.config import preset
from cmfpga.config.schedule import Round
from cmfpga.errors import ConfigError
from cmfpga.fixed import round_half_up
from cmfpga.protocol.confidence import beside
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.results import fields_of
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.reference.integer.event_path import dither
from cmfpga.reference.integer.sliding import Sliding
from support.core_batches import settings

SMALL = {"roi_width": 16, "roi_height": 12, "sensor_width": 32, "sensor_height": 24, "confidence_limit": 1.0}
BATCHES = preset("quad").replace(**SMALL)
QUAD = preset("sliding").replace(**SMALL, buffer_events=2047)
SEARCH, JUDGE = (Round(1, 3, 1.0),), (Round(0, 3, 1 / 16),)
CORNER = (7, 5)
HELD = {"min_roi_events": 6, "roi_gain": 0}


def drawn(rng, count, *, outside=0.3, mean_us=40):
    """Events of a dot that moves, some of them elsewhere; with ties, bursts and gaps."""
    steps = rng.exponential(mean_us, count) * rng.choice([0, 0.1, 1, 3], count)
    steps[rng.random(count) < 0.004] += 30 * mean_us
    t = np.cumsum(steps).astype(np.int64) + 1000
    x, y = ((at + 3 + rng.normal(0, 2, count) + side * t / t[-1]).astype(np.int64) for at, side in ((7, 6), (5, 3)))
    x, y = x.clip(CORNER[0], CORNER[0] + 15), y.clip(CORNER[1], CORNER[1] + 11)
    away = rng.random(count) < outside
    x[away] = rng.integers(0, CORNER[0], away.sum())
    return t, x, y


def slid(config, hops, events, given, cuts=()):
    sliding = Sliding(config, dataclasses.replace(given, roi=CORNER, **hops))
    edges = [0, *sorted(cuts), len(events[0])]
    return [hop for a, b in itertools.pairwise(edges) for hop in sliding.run(*(axis[a:b] for axis in events))]


def numbered(found):
    """``(begin, end)`` of each hop's window, by the numbers of the stored events."""
    ends = np.cumsum([hop.fresh for hop in found]).tolist()
    return [(end - hop.roi_events, end) for hop, end in zip(found, ends, strict=True)]


def stored_times(found, events):
    """Times of the events that are stored: each lies in the ROI that the hop before the last one has found."""
    t, x, y = events
    position, times = 0, []
    for k, hop in enumerate(found):
        left, top = CORNER if k < 2 else found[k - 2].roi_next
        part = slice(position, position + hop.events)
        inside = (x[part] >= left) & (x[part] < left + 16) & (y[part] >= top) & (y[part] < top + 12)
        times.append(t[part][inside])
        assert len(times[-1]) == hop.fresh
        position += hop.events
    return np.concatenate(times)


def hops_of(window_events, hop_events, window_us=0, hop_us=0, follow=(), after=()):
    return {
        "window_events": window_events, "hop_events": hop_events, "window_us": window_us, "hop_us": hop_us,
        "follow": follow, "after": after,
    }  # fmt: skip


def listed(hops, events, least):
    """Windows by one event after the other, of an ROI that stands still: [(b, e, T, first event of the dither)]."""
    (t, x, y), hops = events, SimpleNamespace(**hops)
    closed, stored, begin, last, origin, latest, found = int(t[0]), [], 0, 0, 0, int(t[0]), []

    def close(now):
        nonlocal closed, begin, last, origin
        found.append((begin, len(stored), now, origin))
        begin = max(begin, len(stored) + hops.hop_events - hops.window_events)
        oldest = now + hops.hop_us - hops.window_us
        while hops.window_us and begin < len(stored) and (now - closed > hops.window_us or t[stored[begin]] < oldest):
            begin += 1
        closed, last = now, len(stored)
        origin = begin if begin == last else origin

    for k, now in enumerate(t.tolist()):
        if now < latest:
            continue
        latest = now
        if hops.hop_us and now - closed >= hops.hop_us:
            close(now)
        if 0 <= x[k] - CORNER[0] < QUAD.roi_width and 0 <= y[k] - CORNER[1] < QUAD.roi_height:
            stored.append(k)
            if len(stored) - last == hops.hop_events:
                close(now)
    return found, np.array(stored)


WINDOWS = [
    hops_of(120, 10, follow=SEARCH, after=JUDGE),
    hops_of(120, 9, 4000, 300, follow=JUDGE),
    hops_of(60, 60, 2000, 900, follow=SEARCH),
    hops_of(50, 1, 900, 40, follow=SEARCH),
]


@pytest.mark.parametrize("hops", WINDOWS, ids=["by count", "both", "disjoint", "one event a hop"])
def test_windows_are_those_of_a_plain_list(hops, rng):
    events = drawn(rng, 900)
    events[0][300:303] -= 200  # back in time
    found, (wanted, stored) = slid(QUAD, hops, events, settings(QUAD, **HELD)), listed(hops, events, 6)
    places = numbered(found)
    assert [(*place, hop.t_us) for place, hop in zip(places, found, strict=True)] == [one[:3] for one in wanted]
    assert sum(hop.late for hop in found) > 5 or hops["hop_events"] == hops["window_events"]
    assert len(found) > 20 and len({Flag.DEGENERATE in hop.flags for hop in found}) == 2
    t, x, y = events
    closed = [int(t[0]), *(hop.t_us for hop in found)]  # the hop before the last
    for k, (hop, last, last_closed) in enumerate(zip(found[1:], found, closed, strict=False), 1):
        begin, end, _, origin = wanted[k]
        if Flag.DEGENERATE in hop.flags or Flag.DEGENERATE in last.flags:
            continue
        which = stored[begin:end]
        assert hop.t_first == t[which[0]]
        step, before = last.t_us - last_closed, places[k - 1][1] > begin
        assert hop.span == min(max(1, step + (last.t_us - hop.t_first) * before), (1 << QUAD.span_bits) - 1)
        # The follow round's four evaluations, from the numbers of events alone.
        core = IntegerCore(QUAD)
        at = dither(QUAD, torch.from_numpy(x[:end] * 0), torch.from_numpy(y[:end] * 0))
        at = [
            (torch.from_numpy(axis[which] - corner) << 4) + offset[begin - origin : end - origin]
            for axis, offset, corner in zip((x, y), at, CORNER, strict=True)
        ]
        shift = QUAD.span_bits - int(hop.span).bit_length()
        mantissa = (1 << (QUAD.span_bits - 1 + QUAD.reciprocal_bits)) // (hop.span << shift)
        doubled = torch.from_numpy(2 * (t[which] - hop.t_first) - hop.span)
        dt = round_half_up((doubled << shift) * mantissa, QUAD.span_bits - 1 + QUAD.reciprocal_bits - QUAD.dt_frac)
        assert hop.late == int((t[which] - hop.t_first > hop.span).sum())
        (entry,) = hops["follow"]
        centre = tuple(hop.trace.v[0].tolist())
        sums = [
            core.evaluate(*at, dt.clip(-512, 256), v, entry.level)[1]
            for v in beside(centre, entry.distance << (QUAD.v_frac - 2))
        ]
        trace = hop.trace
        assert [(one.i, one.dx, one.dy, *one.s) for one in sums] == [
            (i, *d, *s) for i, d, s in zip(trace.sum_i[0], trace.sum_d[0].tolist(), trace.s[0].tolist(), strict=True)
        ]


def test_a_batch_is_a_window_that_shares_no_event(rng):
    """Hops as long as windows, by count: every sum, flag and judgement of the batches that ``run`` takes."""
    given, (t, x, y) = settings(QUAD, **HELD), drawn(rng, 800, outside=0.0)
    found = slid(QUAD, hops_of(100, 100), (t, x, y), given)
    core, usual = IntegerCore(BATCHES), settings(BATCHES, **HELD, cold_after_doubtful=0)
    assert len(found) == 8
    for k, hop in enumerate(found):
        part = slice(100 * k, 100 * k + 100)
        batch = core.run(t[part], x[part], y[part], dataclasses.replace(usual, roi=CORNER if k == 0 else None))
        assert batch.trace == hop.trace and batch.iterations and hop.fresh == 100
        both = ({field.name for field in fields_of("batch", "region", config=one)} for one in (QUAD, BATCHES))
        for name in set.intersection(*both) - {"cycles", "thinning_used", "roi_next"}:
            assert getattr(hop, name) == getattr(batch, name), name
    assert len({hop.v for hop in found}) > 4


@pytest.mark.parametrize("hops", WINDOWS[:2], ids=["by count", "both"])
def test_how_events_are_handed_over_changes_nothing(hops, rng):
    """A hop follows from the sequence of events: in one piece, in many, and with times that wrap."""
    events, given = drawn(rng, 1200, mean_us=20), settings(QUAD, min_roi_events=6, thinning=2)
    whole = slid(QUAD, hops, events, given)
    assert len({hop.roi for hop in whole}) > 3, "the ROI moves"
    assert slid(QUAD, hops, events, given, cuts=rng.integers(0, 1200, 60)) == whole
    narrow, later = QUAD.replace(time_bits=17, span_bits=16), (1 << 17) - 12_000
    wrapped = slid(narrow, hops, ((events[0] + later) % (1 << 17), *events[1:]), given, cuts=range(50, 1200, 50))
    assert [hop.regions for hop in wrapped] == [hop.regions for hop in whole]
    assert [hop.t_us for hop in wrapped] == [(hop.t_us + later) % (1 << 17) for hop in whole]
    assert whole[-1].t_us > 12_000


@pytest.mark.parametrize(
    "wrong", [{"window_events": 4000}, {"hop_events": 0}, {"hop_events": 101}, {"window_us": 1 << 24}, {"hop_us": 90}]
)
def test_lengths_that_are_refused(wrong):
    fine = settings(QUAD, **hops_of(100, 10, 80, 8))
    Sliding(QUAD, fine)
    with pytest.raises(ConfigError, match=f"{next(iter(wrong))} = .* is needed"):
        Sliding(QUAD, dataclasses.replace(fine, **wrong))


def test_a_stop_holds_v_and_the_roi_and_ends_cold():
    rng = np.random.default_rng(1)
    t, x, y = drawn(rng, 600, outside=0.0, mean_us=30)
    gap = 300
    t[gap:] += 50_000
    hops = hops_of(100, 10, 5000, 500, follow=SEARCH)
    found = slid(QUAD, hops, (t, x, y), settings(QUAD, min_roi_events=20, v_start=(3, -2)))
    at = next(k for k, hop in enumerate(found) if hop.t_us >= t[gap])
    before, stop, places = found[at - 1], found[at], numbered(found)
    assert Flag.DEGENERATE not in before.flags and Flag.DEGENERATE in stop.flags and not stop.span
    assert places[at + 1][0] == places[at][1], "the window is empty after the gap"
    after = next(k for k, hop in enumerate(found) if k > at and Flag.DEGENERATE not in hop.flags)
    assert {hop.v for hop in found[at:after]} == {before.v}
    assert {hop.roi_next for hop in found[at:after]} == {before.roi_next}
    cold = found[after]
    assert cold.roi_events > 90 or cold.t_us - t[gap] >= 4500, "a full window"
    assert cold.iterations == len(QUAD.schedules.cold) and cold.trace.v[0].tolist() == [3, -2]
    (begin, end), times = places[after], stored_times(found, (t, x, y))
    assert cold.span == times[end - 1] - times[begin] and cold.t_first == times[begin]
    assert cold.roi == before.roi_next
    assert found[after + 1].iterations == 1


def test_the_roi_is_carried_on_from_reference_time_to_reference_time():
    """c of the last hop is the sum of all steps of the reference time, each times v; events are cropped at c + v."""
    rng = np.random.default_rng(2)
    events = drawn(rng, 900, outside=0.0, mean_us=30)
    hops = hops_of(100, 10, follow=SEARCH)
    found = [hop for hop in slid(QUAD, hops, events, settings(QUAD)) if hop.span]
    place, last = None, None
    for hop in found:
        v, t_ref = np.array(hop.v), hop.t_first + hop.span / 2
        place = hop.roi + v if place is None else place + v * (t_ref - last) / (hop.span / 2)
        last = t_ref
        assert np.abs(hop.roi_next - np.clip(place + v, 0, (16, 12))).max() <= 0.75
    assert len(found) > 50 and np.ptp([hop.roi_next[0] for hop in found]) > 2
    # The image lies where the last hop had c; the crop comes into use a hop later than it is known.
    assert found[3].roi != found[3].roi_next


def test_judging_rounds_change_the_verdict_alone():
    rng = np.random.default_rng(3)
    events, given = drawn(rng, 700, mean_us=30), settings(QUAD, min_roi_events=6)
    plain = slid(QUAD, WINDOWS[0] | {"after": ()}, events, given)
    judged = slid(QUAD, WINDOWS[0], events, given)
    assert [hop.v for hop in plain] == [hop.v for hop in judged]
    assert [hop.trace for hop in plain] == [hop.trace for hop in judged]
    first = next(k for k, hop in enumerate(judged) if hop.span)
    assert judged[first] == plain[first], "a cold window judges itself"
    assert all(a.sum_squares != b.sum_squares for a, b in zip(judged[first + 1 :], plain[first + 1 :], strict=True))
    assert judged[first + 1].confidence_limit == given.confidence_limit
    unjudged = slid(QUAD, WINDOWS[0], events, dataclasses.replace(given, judge=0))
    assert {hop.confidence_limit for hop in unjudged} == {0} and unjudged[9].sum_squares == plain[9].sum_squares


def test_every_event_is_counted_in_its_hop(rng):
    """A hop ends at ``max_batch_events`` of the sensor, too; what is dropped belongs to the hop in which it comes."""
    config = QUAD.replace(max_batch_events=40)
    t, x, y = drawn(rng, 2000)
    t[rng.random(2000) < 0.02] -= 500
    given = settings(config, **HELD | {"thinning": 3})
    found = slid(config, hops_of(60, 30, 4000, 900, follow=SEARCH), (t, x, y), given)
    position, latest = 0, np.maximum.accumulate(t)
    for hop in found:
        part = slice(position, position + hop.events)
        back = t[part] < latest[part]
        column, row = x[part] - CORNER[0], y[part] - CORNER[1]
        inside = (column >= 0) & (column < 16) & (row >= 0) & (row < 12) & ~back
        assert (hop.time_back, hop.hot, hop.noise) == (back.sum(), 0, 0)
        assert (hop.fresh + hop.thinned, hop.outside) == (inside.sum(), (~inside & ~back).sum())
        assert hop.events <= 40 and (Flag.TIME_BACK in hop.flags) == bool(hop.time_back)
        position += hop.events
    assert max(hop.events for hop in found) == 40 and sum(hop.thinned for hop in found)
    assert len(t) - position <= 40


def test_times_of_any_length_are_unwrapped(rng):
    """A recording longer than the counter, in one piece; and an event that is further back than half of it."""
    config = QUAD.replace(time_bits=14, span_bits=12, hop_us=0)
    events, given = drawn(rng, 1500, mean_us=30), settings(config, **HELD)
    hops = hops_of(60, 10, 2000, 300, follow=SEARCH)
    narrow = (events[0] % (1 << 14), *events[1:])
    whole = slid(config, hops, narrow, given)
    assert np.ptp(events[0]) > 2 << 14 and len(whole) > 50
    assert slid(config, hops, narrow, given, cuts=range(1, 1500)) == whole
    far = events[0].copy()
    far[700:702] -= (3000, 8100)  # each less than half a round behind the one before, both together more
    far = (far % (1 << 14), *events[1:])
    assert slid(config, hops, far, given) == slid(config, hops, far, given, cuts=range(1, 1500))
