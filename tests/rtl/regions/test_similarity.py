"""Regions that grow and turn: hardware against the integer model in every iteration; each has a middle of its own."""

import dataclasses
import functools

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.events import generate
from cmfpga.imaging.camera import parameters
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.regions import Region
from cmfpga.protocol.settings import BatchSettings
from cmfpga.reference.float_core import FloatCore
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.reference.regions import RegionSequence
from cmfpga.rtl.image import basis, voter
from cmfpga.rtl.regions import collector, distributor, unit
from cmfpga.verilog.simulation import VerilatedCore
from support.core_batches import settings
from support.mutation import break_blocks
from support.regions import CONFIGS, check_amaranth, model_of, random_settings, without_clock

CONFIG = CONFIGS["similarity"]
CENTRES = ((10, 9), (29, 20))


def turning(rng, count, zoom, roll):
    """A window: specks around :data:`CENTRES` that move, grow and turn by so much per half batch, and noise."""
    t = np.sort(rng.integers(0, 4000, count))
    t[0], t[-1] = 0, 4000
    phase, which = t / 2000 - 1, np.arange(count) % 2
    centre, specks = np.array(CENTRES), rng.integers(-5, 6, (2, 7, 2))
    p, q = specks[which, rng.integers(0, 7, count)].T
    v = rng.uniform(-1.5, 1.5, (2, 2))[which].T
    x, y = (
        centre[which, axis] + at + phase * (v[axis] + (zoom * at + sign * roll * other) / 8)
        for axis, at, other, sign in ((0, p, q, -1), (1, q, p, 1))
    )
    noise = rng.random(count) < 0.1
    x, y = np.where(noise, rng.integers(0, 40, count), x), np.where(noise, rng.integers(0, 30, count), y)
    return t, np.round(x).clip(0, 39).astype(int), np.round(y).clip(0, 29).astype(int)


def around(config, rng, number):
    """A region about one of the objects, anywhere in the image, at least 6 px large."""
    size = [int(rng.integers(6, most + 1)) for most in (config.roi_width, config.roi_height)]
    x, y = (max(0, at - side // 2) for at, side in zip(CENTRES[number % 2], size, strict=True))
    margin = tuple(int(rng.integers(most - side + 1)) for most, side in zip((16, 12), size, strict=True))
    start = str(rng.choice(["given", "last", "parent"] if number > 1 else ["given", "last"]))
    return Region(x=x, y=y, width=size[0], height=size[1], margin=margin, start=start, parent=max(0, number - 2),
                  moves=bool(rng.integers(2)))  # fmt: skip


def test_any_motion_about_any_middle():
    hardware, rng, flags, known = VerilatedCore(CONFIG), np.random.default_rng(5), set(), set()
    unit_of = hardware.core.units[0]
    for _ in range(20):
        hardware.reset()
        model = model_of(CONFIG)
        regions = [around(CONFIG, rng, number) for number in range(int(rng.integers(2, CONFIG.regions + 1)))]
        run = dataclasses.replace(random_settings(CONFIG, rng), confidence_limit=int(rng.choice([1, 10, 60])))
        for one in (hardware, model):
            one.write(regions)
        zoom, roll = rng.uniform(-2, 2, 2)
        windows = [turning(rng, int(rng.integers(60, 150)), zoom, roll) for _ in range(4)]
        for window, result in zip(windows, hardware.results(windows, run), strict=True):
            assert without_clock(result) == model.run(*window, run)
            for one in result.regions:
                plans = [plan for plan in (run.cold, run.warm) if len(plan) == one.iterations]
                cycles = {unit_of.cycles(roi_events=one.roi_events, iterations=p, judge=run.judge) for p in plans}
                assert one.cycles in cycles or Flag.DEGENERATE in one.flags
                flags |= {*one.flags} | {one.restarted}
                known.add(one.v)
    hardware.close()
    assert {Flag.SATURATED, Flag.DOUBTFUL, Flag.THINNED, 0, 1} <= flags and len({v[2:] for v in known}) > 50


def test_the_middle_is_the_regions_own():
    """Where the image begins makes no difference, in whole pixels of the coarsest level; v holds at that middle."""
    config = preset("objects").replace(motion="similarity", ascent="sign", schedule_entries=64)
    scene = {"position": (100.0, 90.0), "size": (44, 44), "bars": 8, "contrast": 2.0, "duration_us": 50_000}
    moved = {"velocity": (20.0, 10.0), "roll": 3.0, "zoom": 1.0}
    events = generate(seed=1, **scene, **moved).events
    for core in (IntegerCore(config), FloatCore(config)):
        model = RegionSequence(core)
        model.write([Region(x=77, y=67, width=48, height=48, margin=m) for m in (None, (0, 0), (16, 4))])
        middle, *others = model.run(events.t, events.x, events.y, BatchSettings.from_config(config)).regions
        v = parameters(config, (20.0, 10.0, 1.0, 3.0), 50_000)
        assert np.abs(np.array(middle.v) - v).max() < 0.35 and v[3] > 2
        for other in others:
            if isinstance(core, IntegerCore):
                assert (other.v, other.sums, other.curvature) == (middle.v, middle.sums, middle.curvature)
            assert np.abs(np.array(other.v) - v).max() < 0.35


BROKEN = CONFIG.replace(units=1, regions=3, buffer_events=60, max_batch_events=150, bin_bits=5)
TABLE = [
    Region(x=4, y=3, width=11, height=12, margin=(1, 0), start="last"),
    Region(x=24, y=15, width=12, height=9, margin=(4, 1)),
    Region(x=5, y=4, width=10, height=9, margin=(6, 3), start="parent", parent=0),
]
MUTANTS = {  # module, old, new
    "p and q from the image's middle": (basis, "self.middle[axis] << 1", "Const(2 * (size - 1))"),
    "pixels from the image's middle": (voter, "((self.middle[axis] + 1) << 1)", "Const(2 * size)"),
    "pixels half a pixel aside": (voter, "(self.middle[axis] + 1) << 1", "self.middle[axis] << 1"),
    "the end for the middle": (distributor, "row.begin[axis] + row.end[axis] - 1", "row.end[axis] - 1"),
    "the middle of the region that is loaded": (unit, "path.look_from(m, self._job)", "path.look_from(m, self.job)"),
    "never doubtful": (unit, "flags[Flag.DOUBTFUL] = self.judge.doubtful", "flags[Flag.DOUBTFUL] = 0"),
    "doubt is not kept": (collector, "outcome.flags[Flag.DOUBTFUL.bit_length() - 1]", "Const(0, 1)"),
}  # fmt: skip
NAMES = ("v", "flags", "sums", "sum_squares", "curvature", "restarted")
RUN = dataclasses.replace(settings(BROKEN, v_start=(20, -10, 30, -40)), confidence_limit=2)


@functools.cache
def wanted():
    """The windows, and what the model says of each region of each."""
    rng, model = np.random.default_rng(11), model_of(BROKEN)
    model.write(TABLE)
    windows = [turning(rng, 120, 1.0, -1.5) for _ in range(2)]
    return windows, [model.run(*window, RUN).regions for window in windows]


def run_broken():
    windows, results = wanted()
    check_amaranth(BROKEN, TABLE, windows, RUN, results, names=NAMES, limit=6_000)


def test_without_a_mutant():
    run_broken()
    assert {Flag.DOUBTFUL in one.flags for result in wanted()[1] for one in result} == {False, True}
    assert any(one.restarted for one in wanted()[1][1])


@pytest.mark.parametrize("name", MUTANTS)
def test_a_broken_block_is_noticed(name, monkeypatch):
    break_blocks(monkeypatch, *MUTANTS[name])
    with pytest.raises(AssertionError):
        run_broken()
