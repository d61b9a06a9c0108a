"""Regions that grow and turn: hardware against the integer model in every iteration, and a middle of each region's own."""

import dataclasses

import numpy as np
import pytest

from cmfpga.protocol.flags import Flag
from cmfpga.protocol.regions import Region
from cmfpga.protocol.results import decode
from cmfpga.reference.float_core import FloatCore
from cmfpga.reference.regions import RegionSequence
from cmfpga.rtl.image import basis, voter
from cmfpga.rtl.regions import collector, distributor, unit
from cmfpga.simulation.regions import VerilatedRegions
from support.core_batches import settings
from support.mutation import break_blocks
from support.regions import CONFIGS, model_of, run_amaranth, without_clock

CONFIG = CONFIGS["similarity"].replace(buffer_events=120, max_batch_events=400, tag_bits=4)
CENTRES = ((10, 9), (29, 20))


def turning(rng, count=300, zoom=0.0, roll=0.0):
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


def chosen(config, rng):
    """Settings with any start of every parameter, and a limit that some regions reach."""
    v = tuple(int(rng.integers(p.fmt.min, p.fmt.max + 1) * rng.integers(2) // 4)
              for p in config.motion_model.parameters)  # fmt: skip
    limit, judge = int(rng.choice([1, 10, 60])), int(rng.random() < 0.9)
    return dataclasses.replace(settings(config, v_start=v), confidence_limit=limit, judge=judge)


def test_any_motion_about_any_middle():
    """Every sum of every iteration, every verdict, every cycle."""
    hardware, rng, flags, known = VerilatedRegions(CONFIG), np.random.default_rng(5), set(), set()
    unit_of = hardware.core.units[0]
    for _ in range(12):
        hardware.reset()
        model = model_of(CONFIG)
        regions = [around(CONFIG, rng, number) for number in range(int(rng.integers(2, CONFIG.regions + 1)))]
        run = chosen(CONFIG, rng)
        for one in (hardware, model):
            one.write(regions)
        zoom, roll = rng.uniform(-2, 2, 2)
        windows = [turning(rng, int(rng.integers(150, 400)), zoom, roll) for _ in range(4)]
        for window, result in zip(windows, hardware.stream(windows, run), strict=True):
            assert without_clock(result) == model.run(*window, run)
            for one in result.regions:
                plans = [plan for plan in (run.cold, run.warm) if len(plan) == one.iterations]
                cycles = {
                    unit_of.cycles(roi_events=one.roi_events, iterations=p, judge=run.judge) for p in plans
                }  # fmt: skip
                assert one.cycles in cycles or Flag.DEGENERATE in one.flags
                flags |= {*one.flags} | {one.restarted}
                known.add(one.v)
    hardware.close()
    assert {Flag.SATURATED, Flag.DOUBTFUL, Flag.THINNED, 0, 1} <= flags and len({v[2:] for v in known}) > 50
    assert sum(Flag.DOUBTFUL in one for one in []) == 0
