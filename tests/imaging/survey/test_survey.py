"""Statistics of recordings, and proposals of ROI and batches: on scenes whose motion is known."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.errors import ConfigError
from cmfpga.events import Events, MemoryRecording, generate, open_recording
from cmfpga.imaging.survey import ALLOWED_PX, Survey, estimate, propose, require, survey_all
from cmfpga.imaging.survey.proposal import _apart, _measure

FAST = preset("fast")


@pytest.mark.parametrize("size", [1, 137, 5000])
@pytest.mark.parametrize("sensor", [(240, 180), (None, None)])
def test_statistics_are_those_of_the_events(rng, size, sensor):
    count = 3000 if size > 1 else 300
    t = -500 + np.cumsum(rng.integers(0, 2000, count) * rng.integers(0, 2, count))
    events = Events(t, rng.integers(240, size=count), rng.integers(180, size=count), rng.integers(2, size=count))
    survey = Survey(*sensor)
    for k in range(0, count, size):
        survey.add(events[k : k + size])
    assert (survey.events, survey.on_events) == (count, events.p.sum())
    assert (survey.t_first, survey.t_last, survey.span_us) == (t[0], t[-1], t[-1] - t[0])
    rows, columns = survey.counts.shape
    assert (columns, rows) == (sensor if sensor[0] else (events.x.max() + 1, events.y.max() + 1))
    expected = np.zeros((180, 240), int)
    np.add.at(expected, (events.y, events.x), 1)
    np.testing.assert_array_equal(survey.counts, expected[:rows, :columns])
    for bins in (7, 60):
        width, rate = survey.rate(bins)
        assert 1 <= len(rate) <= bins
        edges = t[0] + np.arange(len(rate) + 1) * width
        counts = np.histogram(t, [*edges[:-1], t[-1] + 1])[0]
        widths = np.diff([*edges[:-1], t[-1] + 1])
        np.testing.assert_allclose(rate, counts / widths * 1e6)


def test_all_events_at_one_time():
    survey = Survey(8, 8)
    survey.add(Events([5, 5], [1, 2], [3, 4], [0, 1]))
    width, rate = survey.rate()
    assert survey.span_us == 0 and (width, rate.tolist()) == (1, [2e6])


def test_hot_pixels(rng):
    scene = generate(seed=3, velocity=(100.0, 30.0), duration_us=300_000, noise=0.2, hot_pixels=5, hot_rate=1500.0)
    events = scene.events
    others = np.unique(
        events.y[~scene.from_object].astype(int) * 240 + events.x[~scene.from_object], return_counts=True
    )
    hot = {(int(where % 240), int(where // 240)) for where, n in zip(*others, strict=True) if n > 200}
    assert len(hot) == 5
    found = survey_all(scene.recording())[0].hot_pixels()
    assert {(x, y) for x, y, _ in found} == hot
    assert [n for *_, n in found] == sorted((n for *_, n in found), reverse=True)


def test_two_hot_pixels_side_by_side():
    events = Events(np.arange(100), [7, 8] * 50, [5] * 100, [0] * 100)
    survey = Survey(20, 20)
    survey.add(events)
    assert survey.hot_pixels() == [(7, 5, 50), (8, 5, 50)]


def test_a_real_hot_pixel(data_dir):
    """Named in the README of the recordings."""
    with open_recording(data_dir / "davis240b_evbench_seq0002.h5") as recording:
        assert (27, 70) in [(x, y) for x, y, _ in survey_all(recording)[0].hot_pixels()]


@pytest.mark.parametrize("texture", ["lines", "dense"])
@pytest.mark.parametrize("px", [(4.0, 0.0), (-2.5, 3.0), (0.0, -6.0), (0.0, 0.0)])
def test_estimate(texture, px):
    speed = [axis / 0.02 for axis in px]  # a window of 40 ms
    scene = generate(seed=8, texture=texture, velocity=speed, duration_us=40_000, contrast=2.0, noise=0.1)
    if not any(px):
        scene = generate(seed=8, texture=texture, velocity=(1.0, 1.0), duration_us=40_000, contrast=40.0, noise=0.1)
    events = scene.events
    span = int(events.t[-1] - events.t[0])
    x, y = events.x - 88.0, events.y - 58.0
    index = np.flatnonzero((x >= 0) & (x < 64) & (y >= 0) & (y < 64))
    dt = (2.0 * (events.t[index] - events.t[0]) - span) / span
    v, gain, clarity = estimate(x[index], y[index], dt, 64, 64)
    np.testing.assert_allclose(v, px, atol=0.5)
    assert gain > 1.1 if any(px) else gain < 1.1
    assert clarity > 0.03


def test_an_edge_has_no_clear_motion():
    """Of a long straight edge only the motion across it can be seen."""
    rng = np.random.default_rng(4)
    t = np.sort(rng.integers(0, 40_000, 1500))
    x = 20 + np.floor(t / 5000).astype(int)
    y = rng.integers(0, 64, 1500)
    dt = (2.0 * t - t[-1]) / t[-1]
    v, _, clarity = estimate(x.astype(float), y.astype(float), dt, 64, 64)
    assert abs(v[0] - 4) < 0.5 and clarity < 0.03


SCENES = [
    # velocity in px/s, duration in µs, other fields of the scene
    ((100.0, 0.0), 400_000, {}),
    ((-60.0, 45.0), 600_000, {"position": (150.0, 70.0)}),
    ((0.0, -30.0), 1_500_000, {"position": (100.0, 130.0)}),
    ((15.0, 10.0), 3_000_000, {"position": (60.0, 60.0)}),
    ((900.0, -300.0), 60_000, {"position": (60.0, 120.0), "contrast": 2.0}),
    ((5000.0, 4000.0), 40_000, {"width": 640, "height": 480, "position": (150.0, 150.0), "contrast": 3.0}),
    ((120.0, -80.0), 400_000, {"texture": "dense"}),
    ((-40.0, -40.0), 900_000, {"texture": "dense", "noise": 0.3}),
    ((80.0, 60.0), 500_000, {"noise": 0.4, "hot_pixels": 10}),
    ((200.0, 0.0), 300_000, {"size": (25, 25), "position": (70.0, 40.0)}),
    ((90.0, 90.0), 400_000, {"t_start_us": 1_600_000_000_000_000, "size": (60, 60), "contrast": 4.0}),
]


@pytest.mark.usefixtures("long_tools")
@pytest.mark.parametrize("velocity, duration, fields", SCENES, ids=[str(row[0]) + str(row[2]) for row in SCENES])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_image_moves_by_3_to_5_px(velocity, duration, fields, seed):
    """By the true motion, in the proposed batches; and the object is in the ROI."""
    scene = generate(seed=seed, velocity=velocity, duration_us=duration, **fields)
    config = FAST.replace(sensor_width=scene.scene.width, sensor_height=scene.scene.height)
    recording = scene.recording()
    (found,) = propose(recording, survey_all(recording)[0], config)
    events = scene.events
    for k in range(2):
        batch = events[found.start_event + k * found.batch_events :][: found.batch_events]
        assert len(batch) == found.batch_events
        moved = math.hypot(*scene.motion.per_half_batch(int(batch.t[0]), int(batch.t[-1])))
        assert ALLOWED_PX[0] <= moved <= ALLOWED_PX[1]
        assert abs(found.batch_us / (batch.t[-1] - batch.t[0]) - 1) < 0.1
    np.testing.assert_allclose(found.px_per_s, velocity, atol=0.12 * math.hypot(*velocity))
    assert abs(found.px - math.hypot(*found.px_per_s) * found.batch_us / 2e6) < 0.1
    centre = scene.motion.position(int(events.t[found.start_event]))
    middle = np.add(found.roi, (config.roi_width / 2, config.roi_height / 2))
    assert np.abs(centre - middle).max() < 24
    # What is stored fits into the buffer, with a reserve.
    assert found.roi_events / found.fields.get("thinning", 1) <= config.buffer_events / 1.2
    x, y = batch.x.astype(int) - found.roi[0], batch.y.astype(int) - found.roi[1]
    inside = ((x >= -8) & (x < 72) & (y >= -8) & (y < 72)).sum()
    assert 0.6 * inside < found.roi_events < 1.5 * inside


def test_where_it_begins_to_move_later():
    """At rest for the first half of the events, which are noise."""
    scene = generate(seed=1, velocity=((400_000, 0.0, 0.0), (400_000, 120.0, 0.0)), duration_us=800_000)
    rng = np.random.default_rng(1)
    count = len(scene.events)
    t = np.sort(rng.integers(0, 400_000, count))
    noise = Events(t, rng.integers(240, size=count), rng.integers(180, size=count), rng.integers(2, size=count))
    events = Events.concatenate([noise, scene.events])
    recording = MemoryRecording(events, 240, 180)
    (found,) = propose(recording, survey_all(recording)[0], FAST)
    assert events.t[found.start_event] >= 300_000
    batch = events[found.start_event :][: found.batch_events]
    np.testing.assert_allclose(found.px_per_s, (120, 0), atol=20)
    assert len(batch) == found.batch_events
    assert propose(recording, survey_all(recording)[0], FAST, start_event=0) == []


def noise(count=60_000):
    rng = np.random.default_rng(7)
    return Events(np.arange(count) * 10, rng.integers(240, size=count), rng.integers(180, size=count), np.zeros(count))


def flicker(count=60_000):
    """An L that flickers, at rest."""
    rng = np.random.default_rng(8)
    x, y = rng.integers(100, 130, count), np.full(count, 90)
    turned = rng.random(count) < 0.5
    return Events(np.arange(count) * 10, np.where(turned, 100, x), np.where(turned, x - 40, y), np.zeros(count))


@pytest.mark.parametrize("events", [noise(), flicker(), Events([1, 2, 30], [1, 2, 3], [1, 2, 3], [0, 1, 0])])
def test_nothing_is_made_up(events):
    recording = MemoryRecording(events, 240, 180, name="mine")
    proposals = propose(recording, survey_all(recording)[0], FAST)
    assert proposals == []
    far = r"clearly and far enough \(4 px in half of a batch\)"
    with pytest.raises(ConfigError, match=rf"^mine: --roi auto: nothing moves {far}; --roi X,Y is needed$"):
        require(proposals, 1, recording)


def test_large_batches_say_what_the_hardware_needs():
    recording = generate(seed=1, velocity=(60.0, 0.0), duration_us=600_000, contrast=30.0).recording()
    config = FAST.replace(max_batch_events=20_000)
    (found,) = propose(recording, survey_all(recording)[0], config)
    assert found.batch_events > 20_000
    assert found.batch_events <= found.fields["max_batch_events"] < 2 * found.batch_events
    assert found.fields["thinning"] == math.ceil(1.3 * found.roi_events / config.buffer_events)
    config.replace(**found.fields)


@pytest.mark.parametrize("slope, alike", [(0.0, True), (0.15, False)])
def test_depths_are_seen(rng, slope, alike):
    """Points move along x by 4 px per half window, and by so much more for each row."""
    config, count = preset("fast"), 60
    t = np.sort(rng.integers(0, 20_001, 6000))
    t[[0, -1]] = 0, 20_000
    point = rng.integers(count, size=len(t))
    x, y = rng.uniform(12, 52, count), rng.integers(4, 60, count)
    moved = (4 + slope * (y - 32))[point] * (t - 10_000) / 10_000
    events = Events(t, np.round(x[point] + moved), y[point], t % 2)
    window = SimpleNamespace(during=lambda begin, duration: events)
    v, *_, inside = _measure(window, (0, 0), 0, 20_000, config)
    assert (_apart(*inside, v, config) <= 0.6) == alike
