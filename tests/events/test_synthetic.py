"""Synthetic scenes: the events fit the motion that is stated."""

import numpy as np
import pytest

from cmfpga.errors import ConfigError, RecordingError
from cmfpga.events import Motion, Scene, generate, synthetic
from support.recordings import assert_same, read_all


def image(x, y, shape=(180, 240)):
    """Events per pixel at the rounded positions."""
    x, y = np.floor(x + 0.5).astype(int), np.floor(y + 0.5).astype(int)
    inside = (x >= 0) & (x < shape[1]) & (y >= 0) & (y < shape[0])
    return np.bincount(y[inside] * shape[1] + x[inside], minlength=shape[0] * shape[1]).reshape(shape)


def contrast(events, motion, scale=1.0):
    """Variance of the image of the events, moved back along ``scale`` times the true path."""
    shift = scale * (motion.position(events.t) - motion.position(events.t[0]))
    return image(events.x - shift[:, 0], events.y - shift[:, 1]).var()


SCENES = [
    dict(texture="lines", velocity=(120.0, -60.0), position=(80, 100)),
    dict(texture="dense", velocity=(-90.0, 30.0), size=(50, 30)),
    dict(texture="dense", velocity=[(100_000, 150.0, 0.0), (150_000, 0.0, 200.0), (100_000, -80.0, -80.0)]),
]


@pytest.mark.parametrize("fields", SCENES)
@pytest.mark.parametrize("seed", [0, 1])
def test_events_are_those_of_a_camera(fields, seed):
    made = generate(seed=seed, noise=0.1, hot_pixels=3, t_start_us=10**6, duration_us=400_000, **fields)
    events = made.events
    assert len(events) == len(made.from_object) > 1000
    assert (np.diff(events.t) >= 0).all()
    assert events.t[0] >= 10**6 and events.t[-1] < 1_400_000
    assert events.x.max() < 240 and events.y.max() < 180
    assert set(events.p.tolist()) == {0, 1}


@pytest.mark.parametrize("fields", SCENES)
def test_seed(fields):
    a, b, c = (generate(seed=seed, noise=0.1, hot_pixels=2, **fields).events for seed in (5, 5, 6))
    assert_same(a, b)
    assert len(a) != len(c) or (a.x != c.x).any()


@pytest.mark.parametrize("fields", SCENES)
@pytest.mark.parametrize("seed", range(3))
def test_true_motion_is_the_sharpest(fields, seed):
    made = generate(seed=seed, duration_us=350_000, **fields)
    sharp = contrast(made.events, made.motion)
    for scale in (-1, 0, 0.7, 1.3, 2):
        assert sharp > 1.1 * contrast(made.events, made.motion, scale), scale


@pytest.mark.parametrize("fields", SCENES)
def test_events_lie_on_the_object(fields):
    """Relative to the stated centre no event is farther than half the size, the bars and a rounded pixel."""
    made = generate(seed=2, duration_us=350_000, **fields)
    centre = made.motion.position(made.events.t)
    size = np.array(made.scene.size) / 2
    off = np.abs(np.stack([made.events.x, made.events.y], axis=1) - centre)
    assert (off <= size + 2.1).all()
    assert (off.max(axis=0) > size - 4).all()  # and they reach its borders


def test_polarity_and_rate_follow_the_normal(monkeypatch):
    """One vertical edge, dark on its left: +v brings the dark side, and events only come from motion across it."""
    edge = np.stack([np.zeros(60), np.arange(60) - 30], axis=1)
    monkeypatch.setattr(synthetic, "_lines", lambda scene, rng: (edge, np.broadcast_to([1.0, 0.0], edge.shape)))
    moved = dict(duration_us=200_000, seed=4)
    right, left = (generate(velocity=(v, 0.0), **moved).events for v in (200.0, -200.0))
    assert not right.p.any() and left.p.all()
    assert len(right) == 60 * 40  # 40 px, an event each
    assert len(generate(velocity=(0.0, 200.0), **moved).events) == 0
    assert abs(len(generate(velocity=(100.0, 170.0), **moved).events) - 60 * 20) <= 60
    assert len(generate(velocity=(200.0, 0.0), contrast=2.5, **moved).events) == 60 * 100
    # each point emits once while the edge moves by a pixel, in either direction
    for events in (right, left):
        assert np.histogram(events.t, 40, (0, 200_000))[0].tolist() == [60] * 40
    # every event is where the edge is at its time
    x = 119.5 + right.t * 200e-6
    assert (np.abs(right.x - x) <= 0.5 + 200e-6).all()


def test_contrast_sets_the_rate_of_the_dense_texture():
    a, b = (len(generate(texture="dense", contrast=c, seed=1).events) for c in (1.0, 3.0))
    assert abs(b / a - 3) < 0.02


def test_reversal_retraces_the_events():
    """Back along the same way the same thresholds are crossed, with the other polarity."""
    made = generate(texture="dense", velocity=[(100_000, 150.0, 40.0), (100_000, -150.0, -40.0)], duration_us=200_000)
    first = made.events.t < 100_000
    assert abs(int(first.sum()) - int((~first).sum())) <= 0.001 * len(first)
    assert made.events.p[first].sum() == pytest.approx((1 - made.events.p[~first].astype(int)).sum(), rel=0.001)


def test_object_leaves_the_sensor():
    assert generate(position=(230, 170), velocity=(400.0, 0.0), noise=0.0, duration_us=400_000).events.t[-1] < 200_000


def test_noise_and_hot_pixels():
    made = generate(seed=1, noise=0.3, hot_pixels=4, hot_rate=20_000.0, duration_us=500_000)
    others = ~made.from_object
    counts = image(made.events.x[others].astype(float), made.events.y[others].astype(float))
    hot = counts > 1000
    assert hot.sum() == 4
    assert (np.abs(counts[hot] - 10_000) < 500).all()
    background = counts[~hot].sum()
    assert background / (background + made.from_object.sum()) == pytest.approx(0.3, abs=0.02)
    # spread evenly over the sensor and time
    assert counts[~hot].max() < 8
    halves = np.histogram(made.events.t[others], 2)[0]
    assert halves[0] / halves[1] == pytest.approx(1, abs=0.05)


def test_still_object_emits_nothing():
    made = generate(velocity=(0.0, 0.0))
    assert len(made.events) == 0
    with pytest.raises(RecordingError, match="no events"):
        made.recording()
    assert len(generate(velocity=(0.0, 0.0), hot_pixels=1).events) > 100


def test_short_and_zero_pieces():
    made = generate(velocity=[(1, 9.0, 9.0), (7, 0.0, 0.0), (10, 100.0, 0.0)], duration_us=300_000)
    assert made.motion.velocity(299_999).tolist() == [100, 0]  # the last piece goes on
    assert len(made.events) > 1000
    assert generate(velocity=[(10**6, 100.0, 0.0), (10**6, 0.0, 9.0)], duration_us=300_000).events.t[-1] < 300_000


def test_motion():
    motion = Motion([1000, 501_000, 601_000], [(100, 0), (0, -50), (10, 10)], (20, 30))
    t = np.array([1000, 251_000, 501_000, 601_000, 701_000, 0])
    np.testing.assert_allclose(motion.position(t), [[20, 30], [45, 30], [70, 30], [70, 25], [71, 26], [19.9, 30]])
    assert motion.velocity(t).tolist() == [[100, 0], [100, 0], [0, -50], [10, 10], [10, 10], [100, 0]]
    np.testing.assert_allclose(motion.mean_velocity(1000, 601_000), [50 / 0.6, -5 / 0.6])
    np.testing.assert_allclose(motion.mean_velocity(501_000, 501_000), [0, -50])
    np.testing.assert_allclose(motion.per_half_batch(1000, 501_000), [25, 0])


@pytest.mark.parametrize("position, roi, expected", [
    (None, (64, 64), (88, 58)), ((100, 90), (63, 63), (69, 59)), ((0, 0), (64, 64), (0, 0)),
    ((239, 179), (64, 32), (176, 148)), ((50, 50), (240, 180), (0, 0)),
])  # fmt: skip
def test_roi_start(position, roi, expected):
    assert generate(position=position, duration_us=1000).roi_start(*roi) == expected


def test_roi_start_too_large():
    with pytest.raises(ConfigError, match="ROI of 241×64"):
        generate(duration_us=1000).roi_start(241, 64)


def test_a_scene_as_a_recording():
    made = generate(Scene(seed=3, texture="dense"))
    with made.recording() as recording:
        assert (recording.width, recording.height) == (240, 180)
        assert "dense, seed 3" in recording.name
        assert_same(read_all(recording), made.events)


@pytest.mark.parametrize("fields, message", [
    (dict(texture="wood"), "texture = 'wood': one of lines, dense"),
    (dict(noise=1.0), "noise = 1.0: 0 to 0.95"), (dict(noise=float("nan")), "noise = nan"),
    (dict(duration_us=0), "duration_us = 0: 1 or more"), (dict(duration_us=0.5), "duration_us = 0.5: an integer"),
    (dict(size=(0, 10)), "size = 0: 1 to"), (dict(size=10), "size = 10: 2 numbers"),
    (dict(position=(1, 2, 3)), "position = "), (dict(velocity=(1.0, float("inf"))), "velocity = inf: a finite number"),
    (dict(velocity=[]), "velocity: no pieces"), (dict(velocity=[(1000, 3.0)]), "velocity = .*: 3 numbers"),
    (dict(velocity=[(0, 3.0, 4.0)]), "velocity: duration = 0"),
    (dict(hot_pixels=240 * 180 + 1), "hot_pixels = 43201: 0 to 43200"),
    *((wrong, "the scene has .* events or more") for wrong in
      (dict(velocity=(1e9, 0.0)), dict(hot_pixels=1, hot_rate=1e12))),
])  # fmt: skip
def test_fields_not_allowed(fields, message):
    with pytest.raises(ConfigError, match=message):
        generate(**fields)


def test_scene_or_fields():
    with pytest.raises(ConfigError, match="seed given beside a scene"):
        generate(Scene(), seed=3)
