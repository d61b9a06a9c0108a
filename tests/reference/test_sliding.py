"""Windows that slide: against plain lists and loops, event by event, and against the batches that they are without."""

import dataclasses
import itertools

import numpy as np
import pytest
import torch

from cmfpga.config import preset
from cmfpga.config.schedule import Round
from cmfpga.errors import ConfigError
from cmfpga.fixed import round_half_up
from cmfpga.protocol.confidence import beside
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.settings import BatchSettings
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.reference.integer.dither import dither
from cmfpga.reference.integer.sliding import HopSettings, Sliding

QUAD = preset("quad").replace(roi_width=16, roi_height=12, sensor_width=32, sensor_height=24, confidence_limit=1.0)
SEARCH, JUDGE = (Round(1, 3, 1.0),), (Round(0, 3, 1 / 16),)
CORNER = (7, 5)
HELD = {"min_roi_events": 6, "roi_gain": 0, "cold_after_doubtful": 0}


def settings(config, **changes):
    return dataclasses.replace(BatchSettings.from_config(config), **changes)


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
    sliding = Sliding(config, CORNER, hops)
    edges = [0, *sorted(cuts), len(events[0])]
    return [hop for a, b in itertools.pairwise(edges) for hop in sliding.run(*(axis[a:b] for axis in events), given)]


def listed(hops, events, least):
    """Windows by one event after the other, of an ROI that stands still: [(b, e, T, first event of the dither)]."""
    t, x, y = events
    closed, stored, begin, last, origin, latest, found = int(t[0]), [], 0, 0, 0, int(t[0]), []

    def close(now):
        nonlocal closed, begin, last, origin
        found.append((begin, len(stored), now, origin))
        begin = max(begin, len(stored) + hops.hop_events - hops.window_events)
        while (
            hops.window_us
            and begin < len(stored)
            and (now - closed > hops.window_us or t[stored[begin]] < now + hops.hop_us - hops.window_us)
        ):
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
    HopSettings(window_events=120, hop_events=10, follow=SEARCH, after=JUDGE, judges=True),
    HopSettings(window_events=120, hop_events=9, window_us=4000, hop_us=300, follow=JUDGE, after=SEARCH),
    HopSettings(window_events=60, hop_events=60, window_us=2000, hop_us=900, follow=SEARCH),
    HopSettings(window_events=50, hop_events=1, window_us=900, hop_us=40, follow=SEARCH),
]


@pytest.mark.parametrize("hops", WINDOWS, ids=["by count", "both", "disjoint", "one event a hop"])
def test_windows_are_those_of_a_plain_list(hops, rng):
    events = drawn(rng, 900)
    events[0][300:303] -= 200  # back in time
    given = settings(QUAD, **HELD)
    found, (wanted, stored) = slid(QUAD, hops, events, given), listed(hops, events, 6)
    assert [(hop.begin, hop.end, hop.t_us) for hop in found] == [one[:3] for one in wanted]
    assert sum(hop.late for hop in found) > 5 or hops.hop_events == hops.window_events
    assert len(found) > 20 and len({Flag.DEGENERATE in hop.outcome.flags for hop in found}) == 2
    t, x, y = events
    closed = [int(t[0]), *(hop.t_us for hop in found)]  # the hop before the last
    for hop, last, last_closed, (begin, end, _, origin) in zip(found[1:], found, closed, wanted[1:], strict=False):
        if Flag.DEGENERATE in hop.outcome.flags or Flag.DEGENERATE in last.outcome.flags:
            continue
        which = stored[begin:end]
        assert (hop.t_first, hop.t_last) == tuple(t[which[[0, -1]]])
        step, before = last.t_us - last_closed, last.end > hop.begin
        assert hop.unit == min(max(1, step + (last.t_us - hop.t_first) * before), (1 << QUAD.span_bits) - 1)
        # The follow round's four evaluations, from the numbers of events alone.
        core = IntegerCore(QUAD)
        at = dither(QUAD, torch.from_numpy(x[:end] * 0), torch.from_numpy(y[:end] * 0))
        at = [
            (torch.from_numpy(axis[which] - corner) << 4) + offset[begin - origin : end - origin]
            for axis, offset, corner in zip((x, y), at, CORNER, strict=True)
        ]
        shift = QUAD.span_bits - int(hop.unit).bit_length()
        mantissa = (1 << (QUAD.span_bits - 1 + QUAD.reciprocal_bits)) // (hop.unit << shift)
        doubled = torch.from_numpy(2 * (t[which] - hop.t_first) - hop.unit)
        dt = round_half_up((doubled << shift) * mantissa, QUAD.span_bits - 1 + QUAD.reciprocal_bits - QUAD.dt_frac)
        assert hop.late == int((t[which] - hop.t_first > hop.unit).sum())
        (entry,) = hops.follow
        centre = tuple(hop.outcome.trace.v[0].tolist())
        sums = [
            core.evaluate(*at, dt.clip(-512, 256), v, entry.level)[1]
            for v in beside(centre, entry.distance << (QUAD.v_frac - 2))
        ]
        trace = hop.outcome.trace
        assert [(one.i, one.dx, one.dy, *one.s) for one in sums] == [
            (i, *d, *s) for i, d, s in zip(trace.sum_i[0], trace.sum_d[0].tolist(), trace.s[0].tolist(), strict=True)
        ]


ARTICLE = preset("paper").replace(
    roi_width=16, roi_height=12, sensor_width=32, sensor_height=24, start="last", iterations=6, eta=0.5
)


@pytest.mark.parametrize("config", [ARTICLE, QUAD], ids=["paper", "quad"])
def test_a_batch_is_a_window_that_shares_no_event(config, rng):
    """Hops as long as windows, by count: every sum, flag and judgement of the batches that ``run`` takes."""
    given = settings(config, **HELD)
    t, x, y = drawn(rng, 800, outside=0.0)
    hops = HopSettings(window_events=100, hop_events=100)
    found = slid(config, hops, (t, x, y), given)
    core = IntegerCore(config)
    assert len(found) == 8
    for k, hop in enumerate(found):
        part = slice(100 * k, 100 * k + 100)
        roi = CORNER if k == 0 else None
        batch = core.run(t[part], x[part], y[part], dataclasses.replace(given, roi=roi))
        assert batch.trace == hop.outcome.trace and batch.iterations
        assert (hop.t_first, hop.unit) == (batch.t_first, batch.span)
        same = {field.name for field in dataclasses.fields(hop.outcome)} - {"trace", "thinning_used", "roi_next"}
        assert {key: getattr(hop.outcome, key) for key in same} == {key: getattr(batch, key) for key in same}
    assert len({hop.outcome.v for hop in found}) > 4


@pytest.mark.parametrize("hops", WINDOWS[:2], ids=["by count", "both"])
def test_how_events_are_handed_over_changes_nothing(hops, rng):
    """A hop follows from the sequence of events: in one piece, in many, and with times that wrap."""
    events, given = drawn(rng, 1200, mean_us=20), settings(QUAD, min_roi_events=6, thinning=2)
    whole = slid(QUAD, hops, events, given)
    assert len({hop.outcome.roi for hop in whole}) > 3, "the ROI moves"
    assert slid(QUAD, hops, events, given, cuts=rng.integers(0, 1200, 60)) == whole
    narrow, later = QUAD.replace(time_bits=17, span_bits=16), (1 << 17) - 12_000
    wrapped = slid(narrow, hops, ((events[0] + later) % (1 << 17), *events[1:]), given, cuts=range(50, 1200, 50))
    assert [hop.outcome for hop in wrapped] == [hop.outcome for hop in whole]
    assert [hop.t_us for hop in wrapped] == [hop.t_us + later for hop in whole] and whole[-1].t_us > 12_000


@pytest.mark.parametrize(
    "wrong", [{"window_events": 4000}, {"hop_events": 0}, {"hop_events": 101}, {"window_us": 1 << 24}, {"hop_us": 90}]
)
def test_lengths_that_are_refused(wrong):
    fine = HopSettings(window_events=100, hop_events=10, window_us=80, hop_us=8)
    Sliding(QUAD, CORNER, fine)
    with pytest.raises(ConfigError, match=f"{next(iter(wrong))} = .* is needed"):
        Sliding(QUAD, CORNER, dataclasses.replace(fine, **wrong))


def test_a_stop_holds_v_and_the_roi_and_ends_cold():
    rng = np.random.default_rng(1)
    t, x, y = drawn(rng, 600, outside=0.0, mean_us=30)
    gap = 300
    t[gap:] += 50_000
    hops = HopSettings(window_events=100, hop_events=10, window_us=5000, hop_us=500, follow=SEARCH)
    found = slid(QUAD, hops, (t, x, y), settings(QUAD, min_roi_events=20, v_start=(3, -2)))
    at = next(k for k, hop in enumerate(found) if hop.t_us >= t[gap])
    before, stop = found[at - 1].outcome, found[at].outcome
    assert Flag.DEGENERATE not in before.flags and Flag.DEGENERATE in stop.flags and not found[at].unit
    assert found[at].v_px_per_s is None and found[at + 1].begin == found[at].end, "the window is empty after the gap"
    after = next(k for k, hop in enumerate(found) if k > at and Flag.DEGENERATE not in hop.outcome.flags)
    assert {hop.outcome.v for hop in found[at:after]} == {before.v}
    assert {hop.outcome.roi_next for hop in found[at:after]} == {before.roi_next}
    cold = found[after]
    assert cold.end - cold.begin > 90 or cold.t_us - t[gap] >= 4500, "a full window"
    assert cold.outcome.iterations == len(QUAD.schedules.cold) and cold.outcome.trace.v[0].tolist() == [3, -2]
    assert cold.unit == cold.t_last - cold.t_first
    assert cold.outcome.roi == before.roi_next
    assert found[after + 1].outcome.iterations == 1


def test_the_roi_is_carried_on_from_reference_time_to_reference_time():
    """c of the last hop is the sum of all steps of the reference time, each times v; events are cropped at c + v."""
    rng = np.random.default_rng(2)
    events = drawn(rng, 900, outside=0.0, mean_us=30)
    hops = HopSettings(window_events=100, hop_events=10, follow=SEARCH)
    found = [hop for hop in slid(QUAD, hops, events, settings(QUAD)) if hop.unit]
    place, last = None, None
    for hop in found:
        v, t_ref = np.array(hop.outcome.v), hop.t_first + hop.unit / 2
        place = hop.outcome.roi + v if place is None else place + v * (t_ref - last) / (hop.unit / 2)
        last = t_ref
        assert np.abs(hop.outcome.roi_next - np.clip(place + v, 0, (16, 12))).max() <= 0.75
    assert len(found) > 50 and np.ptp([hop.outcome.roi_next[0] for hop in found]) > 2
    # The image lies where the last hop had c; the crop comes into use a hop later than it is known.
    assert found[3].outcome.roi != found[3].outcome.roi_next


def test_judging_rounds_change_the_verdict_alone():
    rng = np.random.default_rng(3)
    events, given = drawn(rng, 700, mean_us=30), settings(QUAD, min_roi_events=6)
    plain = slid(QUAD, dataclasses.replace(WINDOWS[0], after=()), events, given)
    judged = slid(QUAD, WINDOWS[0], events, given)
    assert [hop.outcome.v for hop in plain] == [hop.outcome.v for hop in judged]
    assert [hop.outcome.trace for hop in plain] == [hop.outcome.trace for hop in judged]
    first = next(k for k, hop in enumerate(judged) if hop.unit)
    assert judged[first].outcome == plain[first].outcome, "a cold window judges itself"
    assert all(
        a.outcome.sum_squares != b.outcome.sum_squares
        for a, b in zip(judged[first + 1 :], plain[first + 1 :], strict=True)
    )
    assert judged[first + 1].outcome.confidence_limit == given.confidence_limit
