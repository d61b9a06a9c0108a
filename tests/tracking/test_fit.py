"""How long batches are: the rule, the survey, the loop that follows them, and the verdict on the whole."""

import dataclasses
import itertools

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.engines import Engine, make_engine
from cmfpga.events import BatchCutter, generate
from cmfpga.protocol.confidence import is_short
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.results import BatchResult
from cmfpga.tracking.course import Course
from cmfpga.tracking.fit import FittedCutter, batch_cutter, fit
from cmfpga.tracking.loop import track
from cmfpga.tracking.verdict import Verdict
from support.tracks import recording
from support.values import required

CONFIG = preset("fast").replace(sensor_width=40, sensor_height=30, roi_width=12, roi_height=8)


@pytest.mark.parametrize("v, trusted, expected", [
    ((3.0, 0.0), True, 1000), ((0.0, -5.0), True, 1000), ((3.0, 4.0), True, 1000),  # 3 to 5 px: as they are
    ((2.0, 0.0), True, 2000), ((2.5, 0.0), True, 1600), ((0.1, 0.0), True, 2000), ((0.0, 0.0), True, 2000),
    ((6.0, 0.0), True, 667), ((-6.0, 8.0), True, 500), ((0.1, 0.0), False, 1000), ((9.0, 0.0), False, 1000),
])  # fmt: skip
def test_the_rule(v, trusted, expected):
    assert fit(1000, np.hypot(*v), trusted) == expected
    assert fit(1, np.hypot(*v), trusted) >= 1


class Moving(Engine):
    """An engine that sees a motion of ``speed(t_µs)`` px/s along x, and is in doubt where that is None."""

    def __init__(self, speed, config=CONFIG, confidence=40):
        super().__init__(config)
        self.speed, self.asked = speed, []
        self.still = (0.0,) * (len(config.motion_model.names) - 1)
        self.curvature = 0.75 * config.geometry.pixels * confidence

    def _run(self, events, settings):
        (roi,) = self.places
        first, span = int(events.t[0]), int(events.t[-1] - events.t[0])
        speed = self.speed(first + span / 2)
        self.asked.append((first, len(events), settings))
        v = (speed or 0) * span / 2e6, *self.still
        flags = Flag.DEGENERATE if not span else Flag(0) if speed else Flag.DOUBTFUL
        flags |= Flag.SHORT if span and is_short(v) else Flag(0)
        sharp = {"sums": (0,) * 5, "sum_squares": len(events), "curvature": (self.curvature, self.curvature, 0)}
        known = required(
            "batch", "region", events=len(events), roi_events=len(events), span=span, roi=roi, roi_next=roi,
            v=v, iterations=15, flags=flags, confidence_limit=90, thinning_used=1, restarted=0,
        )  # fmt: skip
        return [BatchResult(**known, **sharp)]


def followed(speed, count=20_000, roi=(4, 5), first=None, confidence=40, **size):
    engine = Moving(speed, confidence=confidence)
    cutter = batch_cutter(recording(np.arange(count) * 10), CONFIG, first=first, **size)
    batches = [*track(engine, cutter, roi=roi)]
    trials = len(engine.asked) - len(batches)
    return batches, engine.asked[:trials], engine.asked[trials:], cutter


def test_two_windows_grow_until_the_image_moves_far_enough():
    """200 px/s are 4 px in half of 40 ms: 4,000 events. The windows grow by 1.6, the last moves by 3 to 5 px."""
    batches, trials, asked, cutter = followed(lambda t: 200)
    lengths = [length for _, length, _ in trials]
    tried = {length: [first for first, one, _ in trials if one == length] for length in lengths}
    assert [*tried][:2] == [150, 241] and lengths[-1] in range(3000, 5001)
    # From 500 events on, half a pixel, the first two windows agree; before, those after them are tried.
    assert tried == {one: [10 * one * k for k in range(9 if one < 500 else 2)] for one in tried}
    assert {len(batch.events) for batch in batches} == {lengths[-1]}
    # Each event is tracked once, from the first on.
    assert [batch.events.first_event for batch in batches] == [lengths[-1] * k for k in range(len(batches))]
    assert sum(len(batch.events) for batch in batches) + cutter.leftover == 20_000
    assert all(settings.roi == (4, 5) and not settings.start_last for _, _, settings in trials)
    # The first batch starts cold where it was asked to; the others, as long as it, from its v.
    assert [settings.start_last for _, _, settings in asked] == [False] + [True] * (len(asked) - 1)
    assert [settings.roi for _, _, settings in asked] == [(4, 5)] + [None] * (len(asked) - 1)


@pytest.mark.parametrize(
    "speed, length", [(lambda t: None, 375), (lambda t: 20, 375), (lambda t: 3e6 / t, 150), (lambda t: 100, 3000)]
)
def test_where_the_survey_does_not_agree(speed, length):
    """In doubt, or at rest: an eighth of the events. Ever slower: what moves far enough. Slow: all events."""
    batches, trials, _, _ = followed(speed, count=3000)
    assert trials[-1][1] == 1500 and (len(batches[0].events), batches[0].events.first_event) == (length, 0)


@pytest.mark.parametrize("rest_us", [20_000, 60_000, 150_000])
def test_an_object_that_rests_first(rest_us):
    """Windows after the first two find the length; 200 px/s are 3 to 5 px in half of 3,000 to 5,000 events."""
    batches, trials, _, _ = followed(lambda t: 200 if t > rest_us else None, count=40_000)
    assert 3000 <= len(batches[0].events) <= 5000 and trials[-1][0] >= rest_us - 10 * trials[-1][1] / 2


def test_trusted_windows_none_of_which_agree():
    """No batch has a large part of the events, as one had of an object that swings; the image moves by 3 to 5 px."""
    batches, *_ = followed(lambda t: 200, count=40_000, confidence=14)  # below half of what is trusted, but no flag
    assert {3000 <= len(batch.events) <= 5000 for batch in batches} == {True}


@pytest.mark.parametrize("count, expected", [(1, 1), (3, 3), (200, 150)])
def test_a_recording_that_is_shorter_than_two_windows(count, expected):
    assert [len(batch.events) for batch in followed(lambda t: 200, count=count)[0]] == [expected]


def test_hardware_that_holds_fewer_events_than_the_survey_begins_with():
    scattered = recording(np.arange(900) * 10, np.tile([1, 10], 450))
    engine, cutter = Moving(lambda t: 200), batch_cutter(scattered, CONFIG, most=120)
    batches = [*track(engine, cutter, roi=(4, 5))]
    assert len(batches) == 7 and {length for _, length, _ in engine.asked} == {120}


def test_the_length_follows_the_motion():
    """It becomes three times as fast: then batches become shorter, each that has another length starts cold."""
    batches, _, asked, _ = followed(lambda t: 200 if t < 100_000 else 600, count=30_000, first=4000)
    lengths = [len(batch.events) for batch in batches]
    assert lengths[:3] == [4000, 4000, 4000] and 1300 <= lengths[-1] <= 1400
    starts = [settings.start_last for _, _, settings in asked]
    assert starts == [False] + [one == other for one, other in itertools.pairwise(lengths)]


@pytest.mark.parametrize("speed, first, after", [
    (360, 2250, 1945),  # 2,250 of a buffer of 2,047 would leave 1,125: less gives 1,945
    (180, 4500, 3889),  # a quarter of them
    (275, 2250, 2250),  # that would move by less than 2.8 px
    (300, 2900, 1945),  # 1,450 are fewer, too
    (300, None, 1945),  # as the survey chooses: 4 px would be 2,670 events
    (450, 1900, 1900),  # all of them are kept
])  # fmt: skip
def test_a_buffer_is_filled_rather_than_half_empty(speed, first, after):
    """It holds so many events that more are thinned by halves; κ counts pairs."""
    batches, *_ = followed(lambda t: speed, first=first)
    assert len(batches[0].events) == (first or after) and {len(batch.events) for batch in batches[1:]} == {after}


@pytest.mark.parametrize(
    "confidence, differ, agree",
    [(40, 0.2, True), (59.9, 0.3, False), (60.1, 0.3, True), (60.1, 0.5, True), (1000, 0.6, False)],
)
def test_how_far_two_windows_may_differ(confidence, differ, agree):
    """By a quarter of the faster; by 55 % where both have twice the confidence that is trusted."""
    power = -np.log(1 - differ) / np.log(3)  # the second window's middle is three times as late
    _, trials, _, _ = followed(lambda t: 200 * (t / 20_000) ** power, confidence=confidence)
    assert (sum(length == trials[-1][1] for _, length, _ in trials) == 2) == agree


def test_without_a_trusted_batch_none_becomes_long():
    """At most 16 times the survey's first window, or the last trusted batch; then from the first window on again."""
    batches, _, _, _ = followed(lambda t: None)
    lengths = [len(batch.events) for batch in batches]
    assert lengths[:7] == [2400, 2400, 2400, 150, 150, 150, 300] and max(lengths) == 2400
    batches, _, _, _ = followed(lambda t: 200 if t < 5000 else None, first=200, count=40_000)
    lengths = [len(batch.events) for batch in batches]
    assert lengths[:2] == [200, 400] and max(lengths) == 16 * lengths[1] and 200 in lengths[2:]


def test_a_lost_object():
    """The ROI goes on for two batches, then stays; after three in doubt batches are twice as long."""
    batches, _, asked, _ = followed(lambda t: 200 if t < 70_000 else None, first=2000, count=40_000)
    assert [len(batch.events) for batch in batches] == [2000, 4000, 4000, 4000, 4000, 8000, 8000]
    lost = [k for k, batch in enumerate(batches) if Flag.DOUBTFUL in batch.flags]
    rois = [asked[k][2].roi for k in range(len(asked))]
    moved = round(200 * (4000 - 1) * 1e-5)
    assert rois[lost[0]] is None
    assert rois[lost[0] + 1] == (4 + moved, 5) and rois[lost[0] + 2] == (4 + 2 * moved, 5)
    assert set(rois[lost[0] + 3 :]) == {(4 + 2 * moved, 5)}
    verdict = Verdict.of([batch.values for batch in batches])
    assert verdict.lost == [(lost[0], lost[-1])] and verdict.trusted.sum() == lost[0]
    assert "was lost in batches" in verdict.warnings()[0] and "after 3 of them the ROI stayed" in verdict.warnings()[0]
    told = str(verdict).split(". ")
    assert told[0] == verdict.share and told[1].startswith("Velocity ") and str(verdict).endswith("the ROI stayed.")
    assert verdict.title.splitlines()[0] == verdict.share and verdict.title.splitlines()[1] == verdict.velocity
    assert verdict.title.splitlines()[2].startswith(f"lost in batches {lost[0]} to {lost[-1]} (")
    following = Verdict.of([batch.values for batch in batches], CONFIG.replace(cold_after_doubtful=0))
    assert following.warnings()[0].endswith("the ROI followed them all the same")


def test_a_lost_object_with_empty_batches_between():
    """They are not to be trusted either: after three of both kinds the ROI stays."""
    (batch,), *_ = followed(lambda t: 200, count=4000, events=4000)
    course, result = Course(CONFIG, (4, 5)), batch.result
    found = []
    for flags in (0, Flag.DOUBTFUL, Flag.DEGENERATE, Flag.DOUBTFUL, Flag.DEGENERATE, Flag.DOUBTFUL):
        result = dataclasses.replace(result, flags=Flag(flags), roi=course.start or result.roi)
        found.append(course.go_on(result))
    assert found[1] is not None and found[1] != (4, 5)
    assert found == [None, found[1], None, found[1], None, found[1]]


def test_what_stands_still_is_told():
    """It may be hot pixels: they are sharp at v = 0, and trusted."""
    batches, *_ = followed(lambda t: 20, events=4000)
    (slow, still, option) = Verdict.of([batch.values for batch in batches]).notes()
    assert "by up to 25 %" in slow and "--hot-pixels auto" in still and "without a batch option" in option
    batches, *_ = followed(lambda t: 30, events=4000)
    assert len(Verdict.of([batch.values for batch in batches]).notes()) == 2


@pytest.mark.parametrize("motion, follows", [("similarity", True), ("rotation", False)])
def test_a_lost_motion(motion, follows):
    """The first batch is tried by how far the image moves; a ROI that does not follow the motion stays where it is."""
    size = {"sensor_width": 40, "sensor_height": 30, "roi_width": 16, "roi_height": 12, "buffer_events": 1000}
    size |= {} if follows else {"camera": "40,40,20,15"}
    config = preset(motion).replace(**size, ram_style="auto")
    engine = Moving(lambda t: 100 if t < 150_000 else None, config)
    batches = [*track(engine, batch_cutter(recording(np.arange(60_000) * 10), config), roi=(4, 5))]
    lost = [k for k, batch in enumerate(batches) if Flag.DOUBTFUL in batch.flags]
    first, rois = lost[0], [settings.roi for *_, settings in engine.asked[-len(batches) :]]
    assert 3.0 <= batches[0].result.v[0] <= 5.0 and lost == [*range(first, len(batches))] and len(lost) > 3
    moved = 2 * round(batches[first - 1].result.v[0]) if follows else 0
    assert rois[1 : first + 1] == [None] * first and rois[first + 1] == (min(4 + moved, 24), 5)
    assert set(rois[first + 3 :]) == {rois[first + 2]}


def test_where_lengths_are_chosen():
    """Not where the user gives one, nor without confidence."""
    for size, config, fitted in (
        ({}, CONFIG, True),
        ({}, CONFIG.replace(judge=0), False),
        ({"events": 9}, CONFIG, False),
    ):
        cutter = batch_cutter(recording([0]), config, most=700, **size)
        assert isinstance(cutter, FittedCutter) == fitted
        assert fitted or (type(cutter), cutter.size) == (BatchCutter, size.get("events", 5000))
        assert cutter.max_events == (700 if fitted else CONFIG.max_batch_events)


def modelled(scene, cutter=None, **how):
    config = preset("fast")
    cutter = cutter or batch_cutter(scene.recording(), config)
    return [*track(make_engine("model", config), cutter, roi=scene.roi_start(64, 64), **how)]


def test_an_object_is_tracked_in_batches_that_suit_it():
    """With the integer model: without an option, and twice the same."""
    scene = generate(seed=3, texture="dense", velocity=(160.0, 60.0), position=(50.0, 60.0), duration_us=300_000)
    found, again = ([batch.values for batch in modelled(scene)] for _ in range(2))
    assert found == again and len(found) >= 5
    verdict = Verdict.of(found)
    assert 3 <= verdict.px <= 5 and verdict.trusted.mean() > 0.8 and not verdict.lost and not verdict.notes()
    np.testing.assert_allclose(np.median(verdict.speeds, axis=0), (160, 60), atol=12)
    short = modelled(scene, BatchCutter(scene.recording(), events=1500, max_events=9999), batches=4)
    assert "batches move by less than 1.5 px per half batch" in Verdict.of([one.values for one in short]).notes()[0]


def test_an_object_that_rests_first_is_tracked():
    """With the integer model: at rest for 0.3 s, among noise, then at (120, 40) px/s."""
    scene = generate(
        seed=7, texture="dense", size=(44, 44), position=(80.0, 70.0), noise=0.1, duration_us=800_000,
        velocity=((300_000, 0.0, 0.0), (500_000, 120.0, 40.0)),
    )  # fmt: skip
    verdict = Verdict.of([batch.values for batch in modelled(scene) if batch.events.t[0] > 300_000])
    assert len(verdict.trusted) >= 8 and verdict.trusted.mean() > 0.8
    np.testing.assert_allclose(np.median(verdict.speeds, axis=0), (120, 40), atol=6)
