"""Errors beside a truth, on batches made by hand, computed here a second time."""

import csv
import math
from types import SimpleNamespace

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.errors import ConfigError, RecordingError
from cmfpga.events import Events
from cmfpga.imaging.camera import Camera
from cmfpga.protocol.confidence import is_sure
from cmfpga.protocol.flags import Flag
from cmfpga.truth import Accuracy, Known
from cmfpga.truth.pieces import Signal

FAST, SPAN, ROI, GOOD = preset("fast"), 40_000, (80, 60), Flag(0)
CAMERA = Camera(200.0, 210.0, 120.0, 90.0)
CENTRE = ((80 + 31.5 - 120) / 200, (60 + 31.5 - 90) / 210)  # of the ROI, as a ray


def batch(k, found, flags=GOOD, config=FAST, limit=1):
    """Batch ``k``; ``found`` in px/s, or rad/s of a rotation."""
    t, half = 100_000 + k * SPAN, SPAN / 2e6
    rotation = config.motion == "rotation"
    v = (0.0, 0.0, 0.0) if rotation else tuple(axis * half for axis in found)
    roi = (0, 0) if rotation else ROI
    events = Events([t, t + SPAN // 2, t + SPAN], [100, 101, 102], [80, 80, 81], [0, 1, 0])
    result = SimpleNamespace(flags=flags, roi=roi, span=SPAN, v=v, confidence_limit=limit)
    measured = {"v_px_per_s": found}
    if rotation:
        measured = {"rates": dict(zip(("wx_rad_per_s", "wy_rad_per_s", "wz_rad_per_s"), found, strict=True))}
    return SimpleNamespace(
        index=k, result=result, roi=roi, events=events, seen=events, which={}, trusted=is_sure(result), **measured
    )


def middle(k):
    return (100_000 + (k + 0.5) * SPAN) / 1e6


def wave(t):
    """px/s; its mean over a batch is that of a line to 0.1 %."""
    return np.stack([150 + 80 * np.sin(2 * t), 40 * np.cos(3 * t)], axis=-1)


def known(kind="velocity", values=wave, shift=0.0, until=4.0):
    t = np.arange(0, until, 0.002)
    return Known("truth.txt", kind, Signal((t + shift) * 1e6, values(t)), len(t))


def compared(truth, found, config=FAST, flags=lambda k: GOOD, **how):
    made = Accuracy(truth, config, **how)
    for k, one in enumerate(found):
        made.add(batch(k, one, flags(k), config))
    made.finish()
    return made


def test_figures(rng, tmp_path):
    true = wave(middle(np.arange(40)))
    noise = rng.normal(0, 20, (40, 2))
    bad = rng.random(40) < 0.3
    made = compared(known(), true + noise, flags=lambda k: Flag.DOUBTFUL if bad[k] else GOOD, delay=0.0)
    told = made.summary()
    px = np.hypot(*noise.T) * SPAN / 2e6
    peak = np.hypot(*true.T).max()
    for name, chosen in (("all", bad | True), ("trusted", ~bad)):
        numbers = told[name]
        assert numbers["count"] == chosen.sum()
        assert numbers["aee_px"] == pytest.approx(px[chosen].mean(), abs=0.01)
        assert numbers["aee_px_per_s"] == pytest.approx(np.hypot(*noise[chosen].T).mean(), abs=0.3)
        for k, axis in enumerate(("vx", "vy")):
            rms = math.sqrt((noise[chosen, k] ** 2).mean())
            assert numbers["rms"][axis] == pytest.approx(rms, abs=0.3)
            assert numbers["rms_percent_of_peak"][axis] == pytest.approx(100 * rms / peak, abs=0.3)
        for limit in (0.6, 1, 3):
            assert numbers["above"][f"{limit:g}"] == pytest.approx((px[chosen] > limit).mean(), abs=0.03)
    assert told["wrong"] == round(told["trusted"]["above"]["0.6"] * told["trusted"]["count"]) > 0
    made.save(tmp_path / "a.csv")
    rows = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    assert [float(row["error_px"]) for row in rows] == pytest.approx(px, abs=0.02)
    assert [row["trusted"] for row in rows] == ["01"[not one] for one in bad]


@pytest.mark.parametrize("shift", [-0.0632, 0.037])
def test_a_delay_is_found(rng, shift):
    true = wave(middle(np.arange(60))) + rng.normal(0, 3, (60, 2))
    made = compared(known(shift=shift), true)
    assert made.delay == pytest.approx(shift, abs=0.008) and made.summary()["delay_fitted"]
    assert made.summary()["trusted"]["aee_px"] < made.undelayed_px


@pytest.mark.parametrize("count, values", [(7, wave), (30, lambda t: np.full((len(t), 2), 90.0))])
def test_no_delay_is_made_up(rng, count, values):
    """Of few batches, or of a velocity that does not change."""
    found = values(middle(np.arange(count))) + rng.normal(0, 3, (count, 2))
    assert compared(known(values=values), found).summary()["delay_fitted"] is False


def test_a_wrong_truth_is_wrong():
    told = compared(known(values=lambda t: -wave(t)), wave(middle(np.arange(30)))).summary()
    assert told["wrong"] == told["trusted"]["count"] == 30 and told["trusted"]["relative"]["median"] > 1.5
    assert not told["delay_fitted"]


def test_a_gyroscope_gives_the_image_velocity():
    omega, (x, y) = (0.3, -0.5, 0.7), CENTRE
    true = np.array([
        200 * (x * y * omega[0] - (1 + x * x) * omega[1] + y * omega[2]),
        210 * ((1 + y * y) * omega[0] - x * y * omega[1] - x * omega[2]),
    ])  # fmt: skip
    truth = known("gyroscope", lambda t: np.tile(omega, (len(t), 1)))
    made = compared(truth, [true + np.array([3.0, 4.0])] * 5, camera=CAMERA)
    np.testing.assert_allclose(made.true, [true] * 5, rtol=1e-6)
    assert made.summary()["trusted"]["aee_px_per_s"] == pytest.approx(5)


def test_a_rail_tells_a_direction_and_with_a_depth_all():
    """The camera moves to the right by 0.3 m/s, what is seen 0.5 m away: 120 px/s to the left."""
    truth = known("poses", lambda t: np.tile([0, 0, 0, 0.3, 0, 0], (len(t), 1)))
    found = [(-80.0, 4.0), (-200.0, -4.0), (50.0, 0.0)]
    made = compared(truth, found, camera=CAMERA)
    np.testing.assert_allclose(made.px, np.array([4, 4, 50]) * SPAN / 2e6)
    told = made.summary()
    assert told["depth_unknown"] and [*told["all"]["rms"]] == ["across"] and told["wrong"] == 1
    assert told["all"]["peak"] is told["all"]["relative"] is None
    made = compared(truth, found, camera=CAMERA, depth=0.5)
    np.testing.assert_allclose(made.error, [(40, 4), (-80, -4), (170, 0)], atol=1e-6)
    still = known("poses", lambda t: np.tile([0, 0.1, 0, 1e-4, 0, 0], (len(t), 1)))
    assert compared(still, found, camera=CAMERA).axes == ("vx", "vy")


def test_a_rotation_is_compared_in_rad_per_s():
    config = preset("rotation").replace(camera=CAMERA.text)
    truth = known("gyroscope", lambda t: np.tile([0.3, -0.5, 0.7], (len(t), 1)))
    made = compared(truth, [(0.3, -0.4, 0.7)] * 3, config)
    told = made.summary()
    assert told["unit"] == "rad/s" and told["all"]["rms"] == pytest.approx({"wx": 0, "wy": 0.1, "wz": 0})
    assert made.px[0] == pytest.approx(0.1 * math.sqrt(200 * 210) * SPAN / 2e6, rel=0.3)


def test_what_cannot_be_compared():
    rotation = preset("rotation").replace(camera=CAMERA.text)
    for truth, config, message in (
        (known(), rotation, "velocity; a rotation is compared with a gyroscope or poses"),
        (known("gyroscope"), FAST, "a calibration is needed"),
    ):
        with pytest.raises(ConfigError, match=message):
            Accuracy(truth, config)
    with pytest.raises(RecordingError, match="nothing to compare it with"):
        compared(known(), [(1.0, 1.0)], flags=lambda k: Flag.DEGENERATE)


def test_batches_beyond_the_truth_do_not_count():
    told = compared(known(until=0.2), wave(middle(np.arange(5))), delay=0.0).summary()
    assert (told["compared"], told["not_covered"]) == (2, 3)
