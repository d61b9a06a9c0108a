"""The suite of moving scenes: what it measures, prints and refuses."""

import dataclasses

import numpy as np
import pytest

from cmfpga.config import preset
from studies.accuracy import moving

QUAD = preset("quad")


def test_scenes_move_as_they_say():
    wanted = {
        "constant": (120, 0), "sinusoid": (143.3, -11.8), "fast sinusoid": (-288, 0), "circle": (0, 150),
        "corner": (120, 0), "reversal": (150, 0), "ramp": (140, 0), "stop and go": (120, 0),
    }  # fmt: skip
    assert [scene.name for scene in moving.SCENES] == [*wanted]
    for scene in moving.SCENES:
        made = dataclasses.replace(scene, seconds=0.21).made(1)
        assert made.motion.velocity(200_000) == pytest.approx(wanted[scene.name], abs=4), scene.name
        assert tuple(made.motion.position(0)) == scene.start
    stop = moving.SCENES[-1]
    assert [stop.velocity(s) for s in (0.29, 0.31, 0.59, 0.61)] == [(120, 0), (0, 0), (0, 0), (120, 0)]


def test_the_newest_v_counts_once_it_is_published():
    course = moving.Course(
        np.array([1000.0, 3000.0]), np.array([[3.0, 4.0], [0.0, 0.0]]), np.zeros((2, 2)), np.zeros((0, 3))
    )
    truth = np.zeros(2)
    assert course.rms(np.array([999]), truth) == 0
    assert course.rms(np.array([1000, 2999]), truth) == 5
    assert course.rms(np.array([2999, 3000]), truth) == pytest.approx(5 / np.sqrt(2))


def test_windows_are_as_long_as_their_motion_asks():
    scene = dataclasses.replace(moving.SCENES[0], seconds=0.3)
    made = scene.made(1)
    count, span_us = moving.usual(made)
    assert span_us == pytest.approx(6 / 120 * 1e6)
    assert count == pytest.approx(len(made.events) / 6, rel=0.15), "nearly all events are the object's"
    hops = moving.windows_of(QUAD, count, span_us, moving.BUILT)
    assert (hops.hop_events, hops.window_us, hops.hop_us) == (round(count / 16), 87_500, 4000)
    assert moving.windows_of(QUAD, count, 1000, moving.BUILT).window_us == 60_000


@pytest.mark.usefixtures("long_tools")
def test_hops_follow_a_reversal_that_batches_lose(written, capsys, monkeypatch):
    short = dataclasses.replace(
        moving.SCENES[5], velocity=lambda s: (150 if s < 0.2 else -150, 0), seconds=0.32, start=(110, 90)
    )
    monkeypatch.setattr(moving, "SCENES", (short,))
    monkeypatch.setattr(moving, "LONG", dataclasses.replace(moving.SCENES[0], name="long", seconds=0.2))
    told = written("--moving", "plans")
    shown = capsys.readouterr().out
    assert "Moving scenes" in shown and f"| {moving.BUILT}" in shown
    assert told["config"] == QUAD.to_dict()
    found = {name.split(", ", 2)[2]: one for name, one in told["results"].items() if "reversal" in name}
    assert [*found] == ["batches", *moving.PLANS]
    rms = {who: one["scores"]["rms_px_per_s"] for who, one in found.items()}
    assert rms[moving.BUILT] < 0.75 * rms["batches"]
    assert rms[moving.BUILT] == rms["a search"], "what judges after the result moves nothing"
    ((_, end, farthest),) = found[moving.BUILT]["values"]
    assert farthest < 5 and end <= farthest
    assert found[moving.BUILT]["scores"]["results"] > 10 * found["batches"]["scores"]["results"]
