"""Motions beyond translation in float64: by autograd, by votes one after the other; the integer model beside it."""

import numpy as np
import pytest
import torch

from cmfpga.config import preset
from cmfpga.config.schedule import ScheduleEntry
from cmfpga.imaging.camera import Camera
from cmfpga.protocol.confidence import confidence
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.settings import BatchSettings
from cmfpga.reference import flow
from cmfpga.reference.float_core import FloatCore
from cmfpga.reference.floating import bilinear_votes, float64
from cmfpga.reference.integer import core as model
from cmfpga.reference.integer import motion
from support.core_batches import CONFIGS

LENS = (70.0, 71.0, 31.3, 22.9, 0.0, 0.0, 0.0, 0.0, 0.0)
SIZE = {"roi_width": 48, "roi_height": 40, "sensor_width": 64, "sensor_height": 48, "buffer_events": 500}
SHAPES = {
    "similarity": preset("similarity").replace(**SIZE),
    "rotation": preset("rotation").replace(**SIZE, ram_style="auto", camera=",".join(map(repr, LENS))),
}
ROI = (7, 3)


def scene(config, rng, n=400):
    """Events of some points that move by v, and that v: x, y in the ROI (px), dt, v."""
    names = config.motion_model.names
    v = rng.uniform(-1, 1, len(names)) * [2 if name in "xy" else 1 for name in names]
    dt = torch.tensor(np.sort(rng.uniform(-1, 1, n)))
    point = rng.integers(0, 40, n)
    x, y = (float64(rng.uniform(3, size - 4, 40)[point]) for size in (config.roi_width, config.roi_height))
    b = flow.basis(config, x, y, roi=ROI, camera=LENS)
    u = torch.einsum("apn,p->an", b, float64(v))
    return x + dt * u[0], y + dt * u[1], dt, v


def by_both(config, settings, x, y, dt):
    """What the integer model and the float reference make of a scene as a sensor's events, in 40 ms."""
    t = ((dt + 1) * 20_000).round().long()
    t[0], t[-1] = 0, 40_000
    column, row = (axis.round().long().clamp(0, side - 1) + at
                   for axis, side, at in zip((x, y), (48, 40), ROI, strict=True))  # fmt: skip
    cores = model.IntegerCore(config), FloatCore(config)
    return [core.run(t.numpy(), column.numpy(), row.numpy(), settings) for core in cores]


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize("name", SHAPES)
def test_slopes_are_the_derivative_by_autograd(name, level, rng):
    """Of Σ I² of the events whose cells are whole, in px of the level."""
    config = SHAPES[name]
    x, y, dt, v = scene(config, rng)
    b = flow.basis(config, x, y, roi=ROI, camera=LENS)
    size = {"width": config.roi_width, "height": config.roi_height}
    width, height = (-(-side // (1 << level)) for side in size.values())
    v = torch.tensor(v + 0.3, requires_grad=True)
    place = flow.warped(x, y, dt, v, b, level)
    votes = bilinear_votes(*(axis.detach() for axis in place), width, height)
    whole = (votes.pixel < width * height).all(0)
    moving = bilinear_votes(*place, width, height)
    weight = torch.where(whole, moving.weight, moving.weight.detach())
    image = torch.zeros(width * height + 1, dtype=torch.float64).index_add(0, votes.pixel.flatten(), weight.flatten())
    (image[:-1].square().sum() / 2).backward()
    found = flow.slopes(x, y, dt, v.detach(), b, **size, level=level)
    assert torch.allclose(found / (1 << level), v.grad, rtol=1e-9, atol=1e-9) and bool((found.abs() > 1).all())


@pytest.mark.parametrize("name", SHAPES)
def test_sums_are_those_of_votes_one_by_one(name, rng):
    """And differ from the slopes by no more than the basis does between an event and what it is taken at, by votes."""
    config = SHAPES[name]
    x, y, dt, v = scene(config, rng, 200)
    b, size = flow.basis(config, x, y, roi=ROI, camera=LENS), (config.roi_width, config.roi_height)
    votes, moved, _ = flow._votes(x, y, dt, v, b, width=size[0], height=size[1], level=0)
    pixels, s, bound = {}, np.zeros(len(v)), np.zeros(len(v))
    at_pixels = flow.pixel_basis(config, 0) if config.motion_model.of_pixels else None
    for k in range(len(dt)):
        for corner, pixel in enumerate(votes.pixel[:, k].tolist()):
            w = float(votes.weight[corner, k])
            d = -float(moved[k]) * np.array([float(votes.by_x[corner, k]), float(votes.by_y[corner, k])])
            if pixel == size[0] * size[1]:
                continue
            before = pixels.setdefault(pixel, [])
            there = sum(each[0] for each in before)
            taken = b[:, :, k] if at_pixels is None else at_pixels[:, :, pixel]
            s += taken.numpy().T @ (there * d + w * (sum(each[1] for each in before) + d))
            off = np.abs((taken - b[:, :, k]).numpy())
            bound += (there + w) * np.abs(d) @ off
            bound += sum(w * np.abs(each[1]) @ np.abs((taken - each[2]).numpy()) for each in before)
            before.append((w, d, b[:, :, k]))
    total, found = flow.sums(x, y, dt, v, b, width=size[0], height=size[1], at_pixels=at_pixels)
    assert float(total) == pytest.approx(sum(each[0] for before in pixels.values() for each in before))
    assert np.allclose(found, s, rtol=1e-9, atol=1e-9)
    apart = (found - flow.slopes(x, y, dt, v, b, width=size[0], height=size[1])).numpy()
    assert (np.abs(apart) <= bound + 1e-9).all() and np.abs(apart).max() > 1e-6


@pytest.mark.parametrize("name", SHAPES)
def test_every_stage_of_the_integer_model_is_within_its_bound(name, rng):
    """Basis and flow are rounded; from the votes on all is exact."""
    config = SHAPES[name]
    motions, unit = config.motion_model, 2.0**-config.motion_model.frac
    raw = [torch.tensor(rng.integers(0, size << config.formats.dithered_frac, 300)) for size in (48, 40)]
    real = [axis.double() * 2.0**-config.formats.dithered_frac for axis in raw]
    b = motion.basis(config, *raw, roi=ROI, camera=LENS)
    found = {name: values.double() * unit for name, values in b.items()}
    exact = flow.basis(config, *real, roi=ROI, camera=LENS)
    arm, focus = 1 << motions.lever, (LENS[0] * LENS[1]) ** 0.5
    roll = motions.names.index("roll")
    # Positions are floored to quarters of a pixel, the centre is rounded to one.
    place = (0.25 + 0.125) / arm
    p, q = exact[1, roll], -exact[0, roll]
    assert float((found["p"] - p).abs().max()) <= place and float((found["q"] - q).abs().max()) <= place
    if name == "rotation":
        # Floored to a whole pixel behind that; the curve is rounded, and so is the product.
        off = 1 + 0.125
        for member, want, first, second in (
            ("xx", exact[0, 0] - 1, p, p), ("xy", exact[0, 1], p, q), ("yy", exact[1, 1] - 1, q, q)
        ):  # fmt: skip
            slack = off * (first.abs() + second.abs()) * arm + off**2
            curve = (first.abs() * arm + off) * (second.abs() * arm + off) * 2.0**-28
            assert bool(((found[member] - want).abs() <= slack / focus**2 + curve + unit / 2).all()), member
    v = [int(rng.integers(p.fmt.min, p.fmt.max)) for p in motions.parameters]
    u = motion.flow(config, v, b)
    rounded = torch.zeros_like(exact)
    for row, (axis, terms) in enumerate(motions.terms.items()):
        rounded[row, motions.names.index(axis)] = 1
        for parameter, member, sign in terms:
            rounded[row, motions.names.index(parameter)] += sign * found[member]
    wanted = torch.einsum("apn,p->an", rounded, float64(v)) * config.formats.v.step
    for each, want in zip(u, wanted, strict=True):
        error = float((each.double() * config.formats.v.step - want).abs().max())
        assert config.formats.v.step / 3 < error <= config.formats.v.step / 2


@pytest.mark.parametrize("name", SHAPES)
def test_model_and_float_find_the_motion(name, rng):
    """The same scene by both: within a step or two of each other and of the truth, coarse to fine."""
    config = SHAPES[name].replace(cold="1:0*2 1:-1*3 0:-2*3 0:-3*3 0:-4*2")
    x, y, dt, v = scene(config, rng, 480)
    found = by_both(config, BatchSettings.from_config(config, roi=ROI), x, y, dt)
    assert found[0].roi_events == found[1].roi_events > 300
    for result in found:
        assert np.abs(np.array(result.v) - v).max() < 0.5, result.v
    assert np.abs(np.subtract(found[0].v, found[1].v)).max() < 0.3
    kappa = [confidence(config, result) for result in found]
    assert kappa[0] == pytest.approx(kappa[1], rel=0.3)


@pytest.mark.parametrize("name", SHAPES)
def test_model_and_float_are_as_sure(name, rng):
    """At the same v, which stands: no step is taken. A sharp peak and none, and a batch that is not judged."""
    config, sure = SHAPES[name].replace(cold="0:-6", warm="0:-6"), []
    x, y, dt, v = scene(config, rng, 480)
    raw = tuple(p.fmt.raw(axis) for p, axis in zip(config.motion_model.parameters, v, strict=True))
    away = tuple(one + 4 * (1 << config.v_frac) for one in raw)
    for start, judge in ((raw, 1), (away, 1), (raw, 0)):
        settings = BatchSettings(**vars(BatchSettings.from_config(config, roi=ROI)) | {
            "v_start": start, "judge": judge, "start_last": False, "confidence_limit": 60,
        })  # fmt: skip
        found = by_both(config, settings, x, y, dt)
        kappa = [confidence(config, result) for result in found]
        if not judge:
            assert kappa == [None, None] and not any(Flag.DOUBTFUL in result.flags for result in found)
            continue
        assert kappa[0] == pytest.approx(kappa[1], rel=0.15) or max(kappa) < 0
        assert [Flag.DOUBTFUL in result.flags for result in found] == [one < 20 for one in kappa]
        sure.append(kappa[0] > 20)
    assert sure == [True, False]


def test_a_rotation_turns_as_the_camera_says(rng):
    """u at any pixel is the flow of the camera's rotation: v_x = −f·ω_y, v_y = f·ω_x, roll = −2^lever·ω_z."""
    config = SHAPES["rotation"]
    x, y = float64(rng.uniform(0, 47, 50)), float64(rng.uniform(0, 39, 50))
    lens = (70.0, 70.0, *LENS[2:])
    b = flow.basis(config, x, y, roi=ROI, camera=lens).numpy()
    omega = rng.uniform(-0.1, 0.1, 3)
    v = np.array([-70 * omega[1], 70 * omega[0], -(1 << config.motion_model.lever) * omega[2]])
    camera = Camera(*lens)
    turned = np.einsum("akn,k->an", camera.rotation(*camera.rays(x.numpy() + ROI[0], y.numpy() + ROI[1])), omega) * 70
    assert np.allclose(np.einsum("apn,p->an", b, v), turned)


def test_an_iteration_says_what_it_summed(rng):
    """ΣD is 0 in every iteration, and G is S."""
    config = CONFIGS["similarity"]
    x, y, dt = (torch.tensor(rng.integers(0, 100, 30)) for _ in range(3))
    b = motion.basis(config, x, y, roi=(0, 0), camera=())
    done, _ = model.IntegerCore(config).iterate(x, y, dt, [3, -5, 9, 2], entry=ScheduleEntry(0, 0), b=b)
    assert (done.sums.dx, done.sums.dy) == (0, 0) and done.g == done.sums.s and any(done.g)
