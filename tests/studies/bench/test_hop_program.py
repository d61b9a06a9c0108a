"""The program of ``bench --hops`` does a hop's search round: when the hop has ended, and following its events."""

import contextlib
import dataclasses

import numpy as np
import pytest
import torch
from studies.bench.cases import MOTION_PX, make_workload
from studies.bench.opponents import Job
from studies.bench.opponents.c_program import HopProgram

from cmfpga.events import Events
from cmfpga.protocol.confidence import beside
from cmfpga.reference import float_core, floating
from studies.bench import hops
from support.opponents import broken, made

#: The round 1:3/4:1.
LEVEL, BESIDE, LIMIT = 1, 0.75, 1
#: Of a step, px: sums are float32 there.
STEP = 1e-5
#: From near the motion; from where v is limited; from where there is no peak.
STARTS = {"near": (2.7, -1.6), "far": (1.2, -0.4), "at rest": (0.0, 0.0), "on the other side": (-2.0, 3.0)}


def window(start=(2.7, -1.6), n=800, seed=1):
    made = make_workload("window", events=n, roi_events=n, seed=seed)
    size = {"width": made.width, "height": made.height}
    return Job(events=made.events, roi=made.roi, **size, iterations=0, schedule=(), dither=True, v_start=start)


@pytest.fixture(scope="module")
def program():
    return made(HopProgram)


def edge(n=400):
    """A window of an upright edge, which moves to the right: hardly any curvature along y."""
    t, rng = np.arange(n) * 20, np.random.default_rng(1)
    events = Events(t, 110 + 6 * t // t[-1], rng.integers(60, 120, n), np.zeros(n))
    return dataclasses.replace(window(), events=events)


def right_v(job):
    """By the float64 reference, from the positions and times of int16.c: 8 and 15 fraction bits.

    An event of which a corner lies outside does not vote.
    """
    t, x, y = (torch.from_numpy(axis.astype("int64")) for axis in (job.events.t, job.events.x, job.events.y))
    offsets = (torch.floor(256 * by) / 256 for by in floating.dither(len(t)))
    x, y = (p - at + by for p, at, by in zip((x, y), job.roi, offsets, strict=True))
    dt = torch.clamp(
        torch.floor(32768 * (floating.scaled_times(t, int(t[0]), int(t[-1])) + 1)) / 32768 - 1, max=32767 / 32768
    )

    def gradient(v):
        i, j = ((at + 0.5) / 2 - 0.5 for at in floating.warp(x, y, dt, v))
        inside = (i >= 0) & (j >= 0) & (i < job.width / 2 - 1) & (j < job.height / 2 - 1)
        kept = x[inside], y[inside], dt[inside]
        return floating.evaluate(*kept, v, width=job.width, height=job.height, level=LEVEL, border="whole").s.tolist()

    found = [gradient(one) for one in beside(job.v_start, BESIDE)]
    return [v + step for v, step in zip(job.v_start, float_core.newton_step(found, BESIDE, LIMIT), strict=True)]


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("n", [2, 17, 400, 800, 2000])
def test_following_gives_the_references_step(program, start, n):
    job = window(STARTS[start], n)
    with contextlib.closing(program.load(job)) as loaded:
        assert loaded.tail() == pytest.approx(right_v(job), abs=STEP)


def test_a_flat_peak_is_damped(program):
    with contextlib.closing(program.load(edge())) as loaded:
        assert loaded.tail() == pytest.approx(right_v(edge()), abs=STEP)


@pytest.mark.parametrize("start", STARTS)
def test_a_round_is_a_newton_step_of_four_gradients(program, start):
    job = window(STARTS[start])
    with contextlib.closing(program.load(job)) as loaded:
        v = loaded.round()
        step = float_core.newton_step([loaded.gradient(v, LEVEL) for v in beside(job.v_start, BESIDE)], BESIDE, LIMIT)
        assert v == pytest.approx([at + by for at, by in zip(job.v_start, step, strict=True)], abs=1e-9)


def test_both_find_the_motion(program):
    with contextlib.closing(program.load(window())) as loaded:
        assert loaded.round() == pytest.approx(MOTION_PX, abs=0.4)
        assert loaded.tail() == pytest.approx(MOTION_PX, abs=0.4)


def test_once_more_is_the_same(program):
    """Pixels are put back: the second of a thousand tails is as the first."""
    with contextlib.closing(program.load(window())) as loaded:
        once = loaded.tail()
        assert loaded.tail(1000) == pytest.approx(once, abs=1e-4)
        loaded.follow(2)
        assert loaded.tail() == once
        assert loaded.round(2) == loaded.round()


MUTANTS = {
    "only the new vote's square": ("(*at + add[corner])[0] * add[corner]", "add[corner][0] * add[corner]"),
    "a derivative's sign": ("{a * (1 - b), -dt * (1 - b)", "{a * (1 - b), dt * (1 - b)"),
    "no damping": ("8 * det < trace * trace", "0"),
    "another level": ("/ 2 - 0.5f;\n    const int i", "/ 1 - 0.5f;\n    const int i"),
    "nothing mixed": ("- half * other", "- 0 * other"),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_a_broken_program_is_noticed(name, tmp_path):
    old, new = MUTANTS[name]
    program, apart = made(HopProgram, broken(tmp_path, ("program.h", "int16.c", "hop.c"), old, new)), []
    for job in (edge(), *(window(start, 400) for start in STARTS.values())):
        with contextlib.closing(program.load(job)) as loaded:
            apart += [abs(a - b) for a, b in zip(loaded.tail(), right_v(job), strict=True)]
    assert max(apart) > STEP


def test_the_table_has_a_line_for_each_length():
    rows = [
        {"recording": name, "window": n, "round": 1e-8 * n, "follow": 4e-8 * n, "tail": 1e-7}
        for name in "ab" for n in (400, 800)
    ]  # fmt: skip
    lines = hops.text_of_programs(rows, 100, "cc", "a processor")
    assert "91 cycles at 100 MHz" in lines[0] and len(lines) == 3
    said = "800 events, 2 recordings: after the hop 8.00 (8.8 ×); following 0.10 (0.11 ×), and 40 ns an event"
    assert said in lines[2]
