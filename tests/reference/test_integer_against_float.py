"""The integer model against float64, stage by stage: each gets the raw values that the stage before it gave.

So a stage's error is its own, and its bound follows from the formats alone, in units of the last place of its result:
a floor takes 0 … 1 of one, a rounding at most a half, the reciprocal in dt a share of dt, and sums are exact. All
bounds are reached, so that a wrong rounding is found (see ``MUTANTS``).
"""

import inspect
from fractions import Fraction

import numpy as np
import pytest
import torch

from cmfpga.config import Config, preset
from cmfpga.config.schedule import ScheduleEntry
from cmfpga.events import BatchCutter, generate, open_recording
from cmfpga.fixed import floor_shift, round_half_up
from cmfpga.imaging.iwe import events_in_roi
from cmfpga.protocol.settings import BatchSettings
from cmfpga.reference import floating
from cmfpga.reference.integer import core as model
from support.mutation import mutated

SIZES = [(2, 2), (8, 4), (6, 10), (30, 22), (64, 64)]


class Errors(dict):
    """``{stage: largest error so far}``, as a share of its bound."""

    def note(self, stage, error, bound):
        error, bound = (torch.as_tensor(each, dtype=torch.float64) for each in (error, bound))
        assert bool((error.abs() <= bound * (1 + 1e-9) + 1e-12).all()), f"{stage}: {float(error.abs().max())}"
        share = torch.where(bound > 0, error.abs() / bound, 0.0)
        self[stage] = max(self.get(stage, 0.0), float(share.max()) if share.numel() else 0.0)


def check_dt(config, errors, t, raw, span):
    """Half a unit, and the floor of the reciprocal: less than 2^(1−r) of dt (r = reciprocal_bits)."""
    dt = floating.scaled_times(t, 0, span)
    bound = config.formats.dt.step / 2 + dt.abs() * 2.0 ** (1 - config.reciprocal_bits)
    errors.note("dt", config.formats.dt.real(raw.double()) - dt, bound)


def check_iteration(config, errors, x, y, raw_dt, done, *, level=0, eta=0):
    """An :class:`IntegerIteration` of raw ``x``, ``y`` and dt."""
    formats, v = config.formats, [config.formats.v.real(axis) for axis in done.v]
    dt = formats.dt.real(raw_dt.double())
    places = floating.warp(x.double() * 2.0**-config.dither_frac, y.double() * 2.0**-config.dither_frac, dt, v)
    raw = model.warp(config, x, y, raw_dt, done.v, level)
    for place, found, size in zip(places, raw, (config.roi_width, config.roi_height), strict=True):
        found, unit = found.double() * 2.0**-config.position_frac, 2.0**-config.position_frac
        # Floored; beyond these limits nothing votes at any level.
        wanted = floating.at_level(place, level).clamp(-2, size + 1 - unit)
        errors.note("position", wanted - found - unit / 2, unit / 2)
    width, height = (floating.level_size(size, level) for size in (config.roi_width, config.roi_height))
    real = [axis.double() * 2.0**-config.position_frac for axis in raw]
    votes = floating.bilinear_votes(*real, width, height)
    counts = floating.accumulate(votes.pixel, torch.ones_like(votes.weight), width, height)
    exact = floating.evaluate(*real, dt, (0.0, 0.0), width=width, height=height, border=config.border)
    weights, slopes = 2.0**-config.weight_frac, 2.0**-config.derivative_frac
    # Nothing is rounded where the exact product has no more bits than the format.
    half_weight = weights / 2 * (config.weight_frac < 2 * config.position_frac)
    half_slope = slopes / 2 * (config.derivative_frac < config.dt_frac + config.position_frac)
    for name, found, wanted, half in (
        ("image", done.images.i.double() * weights, exact.image, half_weight),
        ("derivative", done.images.dx.double() * slopes, exact.derivative_x, half_slope),
        ("derivative", done.images.dy.double() * slopes, exact.derivative_y, half_slope),
    ):
        errors.note(name, found[:height, :width] - wanted, counts * half)
        assert int(found.abs().sum() > 0) == int(found[:height, :width].abs().sum() > 0)
    # From the images on all is exact, up to ∂C/∂v, which is floored, its factor and the step.
    images = [image.double() * unit for image, unit in zip(done.images, (weights, slopes, slopes), strict=True)]
    gradient = floating.gradient(*images)
    pixels = config.geometry.pixels
    g = torch.tensor(done.g, dtype=torch.float64) * (2 * weights * slopes / pixels**2)
    scale = float(images[0].sum() * max(image.abs().max() for image in images[1:])) / pixels
    errors.note("gradient", gradient - g, 1e-12 + 1e-12 * scale)
    if config.ascent == "constant":
        rho = float(Fraction(pixels**2, 1 << ((pixels**2).bit_length() - 1)))  # of P² = ρ·2^q
        floored = formats.gradient.step / rho * (config.widths.gradient_shift > 0)
        for before, after, slope in zip(done.v, done.v_next, g.tolist(), strict=True):
            step = formats.v.real(after - before)
            if abs(slope) * rho < formats.gradient.real(formats.gradient.max) and formats.v.min < after < formats.v.max:
                real_eta = formats.eta.real(eta)
                # The factor η/ρ has 18 fraction bits, and ρ's inverse 16.
                factor = abs(slope) * (2.0**-19 * rho + real_eta * 2.0**-16)
                errors.note("step", step - real_eta * slope, formats.v.step / 2 + real_eta * floored + factor)


def random_config(rng):
    """The article's formats, those of ``fast`` with levels and dither, or any others."""
    width, height = SIZES[rng.integers(len(SIZES))]
    size = {"roi_width": width, "roi_height": height, "buffer_events": 64}
    kind = rng.integers(3)
    if kind == 0:
        return Config(**size)
    if kind == 1:
        return preset("fast").replace(**size, tag_bits=11)
    ranges = {
        "dt_frac": (3, 14), "v_frac": (1, 14), "position_frac": (1, 10), "weight_frac": (1, 14), "span_bits": (18, 24),
        "derivative_frac": (1, 14), "reciprocal_bits": (5, 17), "gradient_frac": (8, 26),
    }  # fmt: skip
    return Config(**size, **{name: int(rng.integers(low, high + 1)) for name, (low, high) in ranges.items()})


def check_random(rng, batches):
    """Largest errors over random configurations, batches and velocities, round ones (grid lines!) among them."""
    errors = Errors()
    for _ in range(batches):
        config = random_config(rng)
        n = int(rng.choice([1, 1, 1, 2, 5, 40]))
        span = int(rng.choice([1, 2, 7, 1000, 33_333, 200_001]))
        t = torch.tensor(np.sort(rng.integers(0, span + 1, n)))
        x, y = (torch.tensor(rng.integers(size, size=n)) for size in (config.roi_width, config.roi_height))
        if rng.random() < 0.3:  # structure: few places, so that images are high
            x, y = x // 3, y // 3
        v = [config.formats.v.raw(value) for value in rng.uniform(-1, 1, 2) * rng.choice([0.3, 3, 12])]
        if rng.random() < 0.3:
            v = [round(value * config.formats.v.step) << config.v_frac for value in v]
        raw_dt = model.time_scaler(config, t, span=span)
        check_dt(config, errors, t, raw_dt, span)
        x, y = model.dither(config, x, y)
        level, eta = int(rng.integers(config.max_level + 1)), int(rng.integers(1, config.formats.eta.max))
        done, _ = model.IntegerCore(config).iterate(x, y, raw_dt, v, entry=ScheduleEntry(level, 0), eta=eta)
        check_iteration(config, errors, x, y, raw_dt, done, level=level, eta=eta)
    return errors


def test_every_stage_is_within_its_bound_and_reaches_it(rng):
    errors = check_random(rng, 400)
    print({name: round(share, 3) for name, share in errors.items()})
    assert all(errors[name] > 0.9 for name in ("dt", "position", "image", "derivative", "step"))


MUTANTS = {
    "dt floored": ("time_scaler", "round_half_up(numerator * mantissa, ", "floor_shift(numerator * mantissa, "),
    "position rounded": ("warp", "floor_shift(position + half", "round_half_up(position + half"),
    "coarse pixels not centred": ("warp", "position + half", "position"),
    "weights floored": ("voter", "round_half_up(a * b, ", "floor_shift(a * b, "),
    "derivatives floored": ("voter", "round_half_up(dt * a, ", "floor_shift(dt * a, "),
    "a border that drops corners": ("voter", "(column < width)", "(column < width - 1)"),
    "a derivative's sign": ("voter", "derivative(gx), derivative(fx), -", "derivative(gx), -derivative(fx), -"),
    "G without its second term": ("gradient", "* s - sums.i * d for", "* s for"),
    "step floored": ("constant", "v + round_half_up(limited_slope * gain, ", "v + floor_shift(limited_slope * gain, "),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_a_wrong_stage_is_noticed(name, rng, monkeypatch):
    stage, old, new = MUTANTS[name]
    function = {"constant": "updater"}.get(stage, stage)
    mutant = mutated(inspect.getmodule(getattr(model, function)), old, new)
    vars(mutant).update(floor_shift=floor_shift, round_half_up=round_half_up)
    monkeypatch.setattr(model, function, getattr(mutant, function))
    with pytest.raises(AssertionError):
        check_random(rng, 200)


def check_batch(config, events, roi):
    core, errors = model.IntegerCore(config), Errors()
    core.run(events.t, events.x, events.y, settings := BatchSettings.from_config(config, roi), keep=True)
    index, x, y = (torch.tensor(each) for each in events_in_roi(events, roi, config.roi_width, config.roi_height))
    x, y, index = x[: config.buffer_events], y[: config.buffer_events], index[: config.buffer_events]
    check_dt(config, errors, torch.tensor(events.t - events.t[0])[index], core.dt, int(events.t[-1] - events.t[0]))
    assert len(core.iterations) == config.iterations and len(x) > 100
    for done in core.iterations:
        check_iteration(config, errors, x, y, core.dt, done, eta=settings.eta)
    assert {*errors} == {"dt", "position", "image", "derivative", "gradient", "step"}


@pytest.mark.parametrize("texture", ["lines", "dense"])
@pytest.mark.parametrize("speed", [(60.0, 20.0), (-150.0, 120.0)])
def test_synthetic_batches(texture, speed):
    scene = generate(seed=5, texture=texture, size=(24, 24), velocity=speed, duration_us=25_000, noise=0.1)
    check_batch(Config(iterations=12), scene.events[:1500], scene.roi_start(64, 64))


def test_a_start_far_off_and_a_size_that_is_no_power_of_two():
    config = Config(roi_width=50, roi_height=36, iterations=6, start="given", v_start_x=5.3, v_start_y=-7.1)
    scene = generate(seed=6, texture="lines", size=(24, 20), velocity=(100.0, 0.0), duration_us=25_000)
    check_batch(config, scene.events[:1200], scene.roi_start(50, 36))


@pytest.mark.parametrize("start", [15_000, 60_000])
def test_real_batches(data_dir, start):
    with open_recording(data_dir / "davis240c_shapes_rotation_0.0s.h5") as recording:
        batch = BatchCutter(recording, start_event=start, events=3000, max_events=65_535).next()
    check_batch(Config(iterations=12), batch, (100, 30))
