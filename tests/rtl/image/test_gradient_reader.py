"""Gradient reader against its model: addresses of a sweep, and exact sums of what the banks return."""

import itertools

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.reference.integer.accumulator import Images, accumulator
from cmfpga.reference.integer.gradient import gradient_reader
from cmfpga.reference.integer.voter import voter
from cmfpga.rtl.image.gradient_reader import GradientReader
from support.bench import play
from support.configs import CONFIGS
from support.values import random_values, tensor
from support.votes import bank_pixels, sweep_addresses

CONFIGS = {name: CONFIGS[name] for name in ("default", "narrow", "odd", "tiny")} | {
    "uneven": Config(roi_width=6, roi_height=10, buffer_events=40),
    # Banks of a single row, and of a single column.
    "flat": Config(roi_width=16, roi_height=2, buffer_events=40),
    "tall": Config(roi_width=2, roi_height=16, buffer_events=40),
}
PLAIN, PRODUCTS = ("i", "dx", "dy"), ("sx", "sy")


def check(config, images, *, distances=None, accumulator_latency=3, seed=0):
    """Sweeps over a list of images; ``distances`` are the cycles from one sweep's result to the next start."""
    rng = np.random.default_rng(seed)
    block = GradientReader(config, accumulator_latency=accumulator_latency)
    addresses = sweep_addresses(config)
    noise = random_values(block.i.payload.shape(), rng)
    script, starts = [], []
    for image, distance in zip(images, distances or [1] * len(images), strict=True):
        script += [{"i.payload": next(noise)} for _ in range(distance)]
        starts.append(len(script))
        part = [{"i.payload": next(noise)} for _ in range(config.geometry.bank_words - 1 + block.latency + 1)]
        part[0]["start"] = 1
        for number, words in enumerate(bank_pixels(config, image)):
            part[number + accumulator_latency] = {"i.valid": 1, "i.payload": words}
        script += part
    script += [{"i.payload": next(noise)} for _ in range(6)]
    recording = play(block, script, flows=("o", "sweep"), watch=("o.payload",))

    wanted = [
        (start + number, {"address": address, "first": int(number == 0), "last": int(number == len(addresses) - 1)})
        for start in starts for number, (address, *_) in enumerate(addresses)
    ]  # fmt: skip
    assert recording.flows["sweep"] == wanted
    sums = [gradient_reader(image)._asdict() for image in images]
    ends = [start + config.geometry.bank_words - 1 + block.latency for start in starts]
    assert recording.flows["o"] == list(zip(ends, sums, strict=True))
    # The plain sums are there `lead` cycles earlier; all stay until the next sweep's first pixels come.
    payloads = recording.watch["o.payload"]
    for end, total, following in zip(ends, sums, [*starts[1:], len(script) - 1], strict=True):
        for payload in payloads[end - block.lead : following + 1]:
            assert [payload[name] for name in PLAIN] == [total[name] for name in PLAIN]
        for payload in payloads[end : following + 1]:
            assert payload == total
    return sums


def random_images(config, rng, events=None):
    """Images of random events, as the accumulator sums them."""
    count = config.buffer_events if events is None else events
    frac = config.position_frac
    x, y = (
        tensor(rng.integers(-2 << frac, (size + 1) << frac, count)) for size in (config.roi_width, config.roi_height)
    )
    dt = tensor(rng.integers(-1 << config.dt_frac, 1 << config.dt_frac, count, endpoint=True))
    return accumulator(config, voter(config, x, y, dt))


def point_images(config, points):
    """Images that are zero but for {(row, column): (i, dx, dy)}."""
    images = Images(*(tensor(np.zeros((config.roi_height, config.roi_width))) for _ in range(3)))
    for (row, column), values in points.items():
        for image, value in zip(images, values, strict=True):
            image[row, column] = value
    return images


@pytest.mark.parametrize("name", CONFIGS)
def test_matches_model(name, rng):
    config = CONFIGS[name]
    count = 1 if name == "default" else 5
    images = [random_images(config, rng, events) for events in [config.buffer_events, 1, 0, 7, 30][:count]]
    check(config, images, distances=rng.integers(1, 9, count).tolist())


@pytest.mark.parametrize("accumulator_latency", [1, 2, 5])
def test_any_accumulator_latency(accumulator_latency, rng):
    config = CONFIGS["uneven"]
    check(config, [random_images(config, rng) for _ in range(3)], accumulator_latency=accumulator_latency)


@pytest.mark.parametrize("name", ["narrow", "odd", "tiny", "flat", "tall"])
def test_each_bank_and_end_counts(name):
    """A single pixel in each corner of the ROI, all events on it: the largest words and products, both signs."""
    config = CONFIGS[name]
    top_i, top_d = config.widths.image_max, config.widths.derivative_image_max
    images = []
    for row, column in itertools.product((0, 1, config.roi_height - 1), (0, 1, config.roi_width - 1)):
        for sign in (-1, 1):
            images.append(point_images(config, {(row, column): (top_i, sign * top_d, -sign * top_d)}))
    sums = check(config, images)
    assert {total["sx"] for total in sums} == {-top_i * top_d, top_i * top_d}


def test_sums_reach_their_bounds():
    """|S| at its bound, ΣI·max|D|, and ΣI, ΣD at theirs: four words of one address at once, and over two addresses."""
    config = CONFIGS["flat"]
    quarter = config.widths.sum_i_max // 4
    top = config.widths.derivative_image_max
    spread = {(row, column): (quarter, top, -top) for row in (0, 1) for column in (2, 3)}
    rest = {(0, 0): (config.widths.sum_i_max - 4 * quarter, top, -top)}
    # ΣD beyond its bound is not possible in the core, so the surplus is balanced elsewhere.
    balance = {(0, 10 + n): (0, -top, top) for n in range(4)}
    (sums,) = check(config, [point_images(config, spread | rest | balance)])
    assert (sums["i"], sums["sx"], sums["sy"]) == (config.widths.sum_i_max, config.widths.s_max, -config.widths.s_max)
    half = config.widths.sum_d_max // 2
    for sign in (-1, 1):
        ends = {
            (0, 0): (0, sign * half, sign * half),
            (1, 15): (0, sign * (config.widths.sum_d_max - half), -sign * half),
        }
        (sums,) = check(config, [point_images(config, ends)])
        assert sums["dx"] == sign * config.widths.sum_d_max
