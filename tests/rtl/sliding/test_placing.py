"""Placer and ROI carrier against the model."""

import numpy as np
import pytest
import torch

from cmfpga.config import preset
from cmfpga.config.dither import DITHER_BITS, FACTORS
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.settings import BatchSettings
from cmfpga.reference.integer.event_path import dither, time_scaler
from cmfpga.reference.integer.sliding import Sliding
from cmfpga.rtl.sliding import roi_carrier
from cmfpga.rtl.sliding.placer import Placer
from support.bench import play, simulate
from support.mutation import break_blocks

QUAD = preset("sliding")
PLACED = {
    "quad": QUAD,
    "small sensor": QUAD.replace(sensor_width=100, sensor_height=70),
    "large sensor": QUAD.replace(sensor_width=640, sensor_height=480, span_bits=18),
    "undistorted": QUAD.replace(undistortion="on", sensor_width=320, sensor_height=240),
    "no dither": QUAD.replace(dither_frac=0),
}


@pytest.mark.parametrize("gap", [0.0, 0.4])
@pytest.mark.parametrize("name", PLACED)
def test_places_equal_the_model(name, gap, rng):
    config = PLACED[name]
    frac = config.formats.event_frac
    block = Placer(config)
    script, expected = [], []
    for _ in range(4):
        n, first = int(rng.integers(1, 60)), int(rng.integers(0, 1 << 20))
        sizes = config.geometry.roi_x_max, config.geometry.roi_y_max
        corner = [int(rng.integers(0, most + 1)) for most in sizes]
        last = config.sensor_width - 1, config.sensor_height - 1
        # As far from the image as the sensor goes: a fast object's corner moves by more than the ROI in one hop.
        x, y = (rng.integers(0, (most << frac) + 1, n) for most in last)
        begin = int(rng.integers(0, 1 << config.span_bits))
        t = np.sort(rng.integers(0, 1 << config.span_bits - 1, n))
        phases = {
            f"phase_{axis}": (f // 2 + first * f) % (1 << DITHER_BITS) for axis, f in zip("xy", FACTORS, strict=True)
        }
        script.append({"start": 1, "t_first": begin, "corner": dict(zip("xy", corner, strict=True)), **phases})
        relative = (torch.from_numpy(axis - (at << frac)) for axis, at in zip((x, y), corner, strict=True))
        more = (1 << frac) >> 1  # the hardware has half a pixel more, where it undistorts, until the warp takes it off
        placed = [at + (more << config.formats.dithered_frac - frac) for at in dither(config, *relative, first)]
        for k in range(n):
            script += [{}] * int(rng.random() < gap)
            event = {
                "t": (begin + int(t[k])) % (1 << config.span_bits),
                "x": int(x[k]) + more,
                "y": int(y[k]) + more,
                "last": int(k == n - 1),
            }
            script.append({"i.valid": 1, "i.payload": event})
            expected.append({"t": int(t[k]), "x": int(placed[0][k]), "y": int(placed[1][k]), "last": event["last"]})
    recording = play(block, [*script, *[{}] * block.latency])
    assert recording.values() == expected
    came = [cycle for cycle, inputs in enumerate(script) if inputs.get("i.valid")]
    assert recording.cycles() == [cycle + block.latency for cycle in came]


def carried(count, rng):
    """``(wanted, found)``: corners and flags after each of ``count`` moves, by the model and by the block."""
    sliding = Sliding(QUAD, BatchSettings.from_config(QUAD, (88, 58)))
    moves, wanted, t = [], [], 1_000_000
    for k in range(count):
        cold = bool(k == 0 or rng.random() < 0.1)
        unit = int(rng.integers(5_000, 60_000))
        t += int(rng.integers(0, unit))
        size = 2 ** rng.uniform(-1, 11)
        sliding.core.v = tuple(
            int(axis) for axis in rng.normal(0, size, 2).clip(QUAD.formats.v.min, QUAD.formats.v.max)
        )
        since = int(time_scaler(QUAD, sliding._t_ref - t, span=unit)) if k else -1
        crop = sliding.crop
        flags = sliding._move(t, unit, cold)
        moves.append((cold, sliding.core.v, since, crop))
        wanted.append((sliding._whole(sliding._corner)[0], sliding._next_crop, Flag.ROI_CLAMPED in flags))
        sliding.crop = sliding._next_crop
    block, found = roi_carrier.RoiCarrier(QUAD), []

    async def bench(ctx):
        ctx.set(block.crop, {"x": 88, "y": 58})
        ctx.set(block.load, 1)
        await ctx.tick()
        ctx.set(block.load, 0)
        for cold, v, since, crop in moves:
            ctx.set(block.v, dict(zip("xy", v, strict=True)))
            ctx.set(block.since, since)
            ctx.set(block.crop, dict(zip("xy", crop, strict=True)))
            ctx.set(block.cold, int(cold))
            ctx.set(block.move, 1)
            await ctx.tick()
            ctx.set(block.move, 0)
            await ctx.tick().repeat(block.latency - 1)
            corners = (ctx.get(block.image), ctx.get(block.next_crop))
            found.append((*((at.x, at.y) for at in corners), bool(ctx.get(block.clamped))))

    simulate(block, bench)
    return wanted, found


def test_the_roi_is_carried_as_in_the_model(rng):
    wanted, found = carried(400, rng)
    assert found == wanted
    clamped = sum(one[2] for one in wanted)
    assert 20 < clamped < 380 and len({one[0] for one in wanted}) > 60


MUTANTS = {
    "the sign counts as the other bits": ("(factor[-1], v, 0), ~running[0]", "(factor[-1], v, 0), ~running[1]"),
    "a cold window starts where the last one was": ("(self.move & self.cold)", "0"),
    "cropped at the middle of the window": ("place + ahead_v", "place"),
    "the sensor has no end": ("place.eq(saturate(target, 0, most))", "place.eq(target)"),
    "a crop that is limited tells nothing": ("moved | (ahead < 0) | (ahead > limit)", "moved"),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_mutants_are_noticed(name, monkeypatch, rng):
    break_blocks(monkeypatch, roi_carrier, *MUTANTS[name])
    wanted, found = carried(300, rng)
    assert found != wanted
