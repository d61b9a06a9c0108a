"""Accumulator against its model: no vote is lost however close two of them come, and a sweep leaves zeros."""

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.reference.integer.accumulator import accumulator
from cmfpga.reference.integer.voter import voter
from cmfpga.rtl.image.accumulator import Accumulator
from support.bench import play
from support.configs import CONFIGS, NARROW
from support.values import random_gaps, random_values, tensor
from support.votes import bank_pixels, cell_votes, patterns, sweep_addresses, vote_payloads

CONFIGS = {name: CONFIGS[name] for name in ("narrow", "odd", "tiny", "sensor")} | {
    # Odd numbers of columns and rows in a bank.
    "uneven": Config(roi_width=6, roi_height=10, buffer_events=40),
}


# ---------------------------------------------------------------- playing


def script_of(config, phases, rng, probability=0.0):
    """Votes of a phase, then a sweep, then the next phase: no cycle between them, but for random gaps.

    Whatever is not valid has random values: banks without a vote, votes in a gap or during a sweep.
    """
    block = Accumulator(config)
    votes_noise = random_values(block.i.payload.shape(), rng)
    vote_noise = random_values(block.i.payload.shape()["banks"].shape.elem_shape, rng)
    sweep_noise = random_values(block.sweep.payload.shape(), rng)
    script, starts = [], []

    def idle(cycles):
        script.extend({"i.payload": next(votes_noise)} for _ in range(cycles))

    for votes in phases:
        events = vote_payloads(config, votes)
        for banks, gap in zip(events, random_gaps(rng, len(events), probability), strict=True):
            idle(gap)
            banks = [bank or next(vote_noise) | {"valid": 0} for bank in banks]
            script.append({"i.valid": 1, "i.payload": {"banks": banks, "last": int(rng.integers(2))}})
        addresses = [address for address, *_ in sweep_addresses(config)]
        starts.append([])
        for address, gap in zip(addresses, random_gaps(rng, len(addresses), probability / 2), strict=True):
            idle(gap)
            starts[-1].append(len(script))
            sweep = next(sweep_noise) | {"address": address}
            script.append({"sweep.valid": 1, "sweep.payload": sweep})
    idle(8)
    return block, script, starts


def check(config, phases, probability=0.0, seed=0):
    """``phases`` is a dictionary {name: votes}."""
    rng = np.random.default_rng(seed)
    block, script, starts = script_of(config, phases.values(), rng, probability)
    recording = play(block, script)
    expected = {name: bank_pixels(config, accumulator(config, votes)) for name, votes in phases.items()}
    values = iter(recording.values())
    for name, pixels in expected.items():
        for place, wanted in zip(sweep_addresses(config), pixels, strict=True):
            assert next(values, "nothing more") == wanted, f"{name!r} at address, row, column {place}"
    assert next(values, None) is None, "more items than were swept"
    swept = [cycle for cycles in starts for cycle in cycles]
    assert recording.cycles() == [cycle + block.latency for cycle in swept]
    return expected


@pytest.mark.parametrize("probability", [0.0, 0.5], ids=["free", "gaps"])
@pytest.mark.parametrize("name", ["narrow", "odd", "tiny", "uneven"])
def test_hazards(name, probability, rng):
    """All patterns, back to back, each followed at once by its sweep; in between, sweeps that must read zeros."""
    config = CONFIGS[name]
    nothing = cell_votes(config, [], rng)
    phases = {}
    for pattern, cells in patterns(config, rng).items():
        phases[pattern] = cell_votes(config, cells, rng)
        if len(phases) % 8 == 0:
            phases[f"zeros after {pattern!r}"] = nothing
    check(config, phases, probability)


@pytest.mark.parametrize("name", ["narrow", "odd"])
def test_votes_of_the_voter(name, rng):
    """What the voter really gives, events along a moving edge."""
    config = CONFIGS[name]
    phases = {}
    for batch in range(3):
        count = config.buffer_events
        frac = config.position_frac
        x = (rng.integers(-1, 4, count) + config.roi_width // 2 << frac) + rng.integers(0, 1 << frac, count)
        y = rng.integers(-2 << frac, (config.roi_height + 1) << frac, count)
        dt = rng.integers(-1 << config.dt_frac, 1 << config.dt_frac, count, endpoint=True)
        phases[f"batch {batch}"] = voter(config, tensor(x), tensor(y), tensor(dt))
    check(config, phases)


def test_whole_sensor(rng):
    """240×180: votes at the far ends of the address range."""
    config = CONFIGS["sensor"]
    far = [(239, 179), (238, 178), (239, 0), (0, 179), (-1, -1), (127, 127), (128, 128)] * 5
    check(config, {"far": cell_votes(config, far, rng)})


@pytest.mark.parametrize("sign", [-1, 1])
def test_words_hold_every_event_on_one_pixel(sign):
    """As many events as the buffer holds, with the largest votes, on one pixel: the largest words that can be."""
    config = Config(**NARROW).replace(buffer_events=64, roi_width=4, roi_height=4)
    votes = cell_votes(config, [(1, 1)] * config.buffer_events, np.random.default_rng(0))
    top = sign * config.widths.derivative_max
    votes = votes._replace(w=votes.w * 0 + config.widths.weight_max, dx=votes.dx * 0 + top, dy=votes.dy * 0 - top)
    largest = {
        "i": config.widths.image_max,
        "dx": sign * config.widths.derivative_image_max,
        "dy": -sign * config.widths.derivative_image_max,
    }
    expected = check(config, {"full": votes, "zeros": cell_votes(config, [], np.random.default_rng(0))})
    assert largest in expected["full"][0]
