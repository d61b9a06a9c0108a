"""One-pass gradient: sums kept up to date vote by vote equal those over the finished images, bit for bit."""

import numpy as np
import pytest
from amaranth.hdl import Elaboratable, Module

from cmfpga.config import Config, preset
from cmfpga.reference.integer.accumulator import accumulator
from cmfpga.reference.integer.gradient import gradient_reader
from cmfpga.reference.integer.voter import voter
from cmfpga.rtl import payloads
from cmfpga.rtl.image.one_pass_gradient import OnePassGradient
from cmfpga.rtl.image.tagged_accumulator import TaggedAccumulator
from support.bench import AnyContent, play
from support.configs import LEVELS, NARROW
from support.values import random_values, tensor
from support.votes import cell_votes as any_votes
from support.votes import patterns, vote_payloads

SHAPES = {
    **{name: LEVELS[name] for name in ("fast odd", "fast tiny", "fast wide")},
    "narrow": Config(**NARROW, gradient="one_pass"),
    "uneven": preset("fast").replace(roi_width=7, roi_height=5, buffer_events=40),
}
PIXEL = ("i", "dx", "dy")


def roomy(config):
    """The random votes of :func:`cell_votes` do not sum to 1 per event, as real ones do: so many more may come."""
    return config.replace(buffer_events=4 * config.buffer_events)


def cell_votes(config, cells, rng):
    """Random votes whose derivatives are opposite where the voter's are: in a row along x, in a column along y."""
    votes = any_votes(config, cells, rng)
    dx, dy = votes.dx.clone(), votes.dy.clone()
    dx[:, 1::2], dy[:, 2:] = -dx[:, ::2], -dy[:, :2]
    return votes._replace(dx=dx, dy=dy)


def complete(banks, noise):
    """The banks of an event; those without a vote have the derivatives that their neighbours ask for."""
    banks = [vote or next(noise) | {"valid": 0} for vote in banks]
    for number, vote in enumerate(banks):
        for axis, neighbour in (("dx", banks[number ^ 1]), ("dy", banks[number ^ 2])):
            if not vote["valid"] and neighbour["valid"]:
                vote[axis] = -neighbour[axis]
    return banks


def steps_of(events):
    """What the accumulator's banks do for each :func:`complete` event: from images that start empty."""
    words = [{} for _ in range(4)]
    for banks in events:
        steps = []
        for bank, vote in zip(words, banks, strict=True):
            if not vote["valid"]:
                add = {name: vote[name] for name in PIXEL}
                steps.append({"valid": 0, "i": 0, "add": add, "total": add})
                continue
            before = bank.get(vote["address"], dict.fromkeys(PIXEL, 0))
            after = {name: before[name] + vote[name] for name in PIXEL}
            bank[vote["address"]] = after
            steps.append({"valid": 1, "i": before["i"], "add": {name: vote[name] for name in PIXEL}, "total": after})
        yield steps


def script_of(config, iterations, idle, rng, accumulator_latency):
    """(script, cycles of the last events): iterations of votes, the accumulator's steps so many cycles later.

    Whatever is not valid is random, but for the derivatives of banks without a vote: banks and steps without one, and
    everything between iterations.
    """
    votes, steps = payloads.votes(config), payloads.tagged_step(config)
    events_noise = random_values(votes, rng)
    vote_noise = random_values(votes["banks"].shape.elem_shape, rng)
    step_noise = random_values(steps, rng, count=8)
    script, lasts = [], []
    later = {}
    for events in iterations:
        events = [complete(banks, vote_noise) for banks in events]
        for number, (banks, done) in enumerate(zip(events, steps_of(events), strict=True)):
            last = int(number == len(events) - 1)
            later[len(script) + accumulator_latency] = done
            script.append({"votes.valid": 1, "votes.payload": {"banks": banks, "last": last}})
        lasts.append(len(script) - 1)
        script += [{"votes.payload": next(events_noise)} for _ in range(idle())]
    script += [{"votes.payload": next(events_noise)} for _ in range(accumulator_latency + 10)]
    for cycle, values in enumerate(script):
        done = later.get(cycle, [None] * 4)
        values["steps"] = [step or next(step_noise) | {"valid": 0} for step in done]
    return script, lasts


def check(config, phases, idle, *, accumulator_latency=3, seed=0):
    """``phases`` are {name: votes}; all of the sums are compared only where iterations are far enough apart."""
    rng = np.random.default_rng(seed)
    block = OnePassGradient(config, accumulator_latency=accumulator_latency)
    iterations = [vote_payloads(config, votes) for votes in phases.values()]
    script, lasts = script_of(config, iterations, idle, rng, accumulator_latency)
    recording = play(block, script, watch=("o.payload",))
    assert recording.cycles() == [last + block.latency for last in lasts]
    timeline = recording.watch["o.payload"]
    starts = [last - len(events) + 1 for last, events in zip(lasts, iterations, strict=True)]
    for name, votes, last, following in zip(
        phases, phases.values(), lasts, [*starts[1:], len(script) + block.latency], strict=True
    ):
        wanted = gradient_reader(accumulator(config, votes))._asdict()
        done = last + block.latency
        assert {axis: timeline[done][axis] for axis in ("sx", "sy")} == {axis: wanted[axis] for axis in ("sx", "sy")}
        if following > done:
            # They stay, whatever stands on invalid inputs.
            assert all(sums == wanted for sums in timeline[done : following + 1]), name
            # What the gradient multiplies while it waits for the rest.
            for cycle in range(done - block.lead, done):
                assert {n: timeline[cycle][n] for n in PIXEL} == {n: wanted[n] for n in PIXEL}, name


def random_phases(config, rng):
    """All patterns in which votes can follow one another; an iteration has an event at least."""
    cells = patterns(config, rng)
    del cells["no vote"]
    return {name: cell_votes(config, places, rng) for name, places in cells.items()}


@pytest.mark.parametrize("idle", ["back to back", "random", "apart"])
@pytest.mark.parametrize("name", SHAPES)
def test_hazards(name, idle, rng):
    """Back to back only S can be compared: the plain sums of the next iteration come before this one's S."""
    config = SHAPES[name]
    cycles = {"back to back": lambda: 0, "random": lambda: int(rng.integers(10)), "apart": lambda: 7}[idle]
    check(roomy(config), random_phases(config, rng), cycles)


@pytest.mark.parametrize("accumulator_latency", [1, 2, 3, 5])
def test_any_latency_of_the_accumulator(accumulator_latency, rng):
    config = SHAPES["uneven"]
    check(
        roomy(config),
        random_phases(config, rng),
        lambda: int(rng.integers(12)),
        accumulator_latency=accumulator_latency,
    )


def test_iterations_of_one_event(rng):
    """First and last at once, in every cycle."""
    config = SHAPES["uneven"]
    phases = {n: cell_votes(config, [(n % 3 + 1, 1)], rng) for n in range(30)}
    check(roomy(config), phases, lambda: 0)
    check(roomy(config), phases, lambda: int(rng.integers(3)))


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("name", ["fast odd", "narrow", "fast wide"])
def test_sums_hold_a_full_buffer(name, sign):
    """Every event of the buffer on one pixel with the largest votes; and along the border, where ΣD is largest."""
    config = SHAPES[name]
    count, frac = config.buffer_events, config.position_frac
    dt = tensor([sign << config.dt_frac] * count)
    inside = tensor([4 << frac] * count)
    border = tensor([(-1 << frac)] * count)
    phases = {
        "one pixel": voter(config, inside, inside, dt),
        "left": voter(config, border, inside, dt),
        "top": voter(config, inside, border, dt),
        "half a pixel": voter(config, inside + (1 << (frac - 1)), inside + (1 << (frac - 1)), dt),
    }
    check(config, phases, lambda: 8)
    sums = gradient_reader(accumulator(config, phases["one pixel"]))
    assert (
        sums.i == config.widths.image_max
        and abs(sums.sx) == config.widths.image_max * config.widths.derivative_image_max
    )
    sums = gradient_reader(accumulator(config, phases["left"]))
    assert abs(sums.dx) == config.widths.derivative_image_max


# ---------------------------------------------------------------- with the accumulator in front


class Pair(Elaboratable):
    """Tagged accumulator and one-pass gradient as the core joins them."""

    def __init__(self, config):
        self.accumulator = TaggedAccumulator(config)
        self.sums = OnePassGradient(config, accumulator_latency=self.accumulator.latency)
        self.i, self.next_tag, self.o = self.accumulator.i, self.accumulator.next_tag, self.sums.o
        self.latency = self.sums.latency

    def elaborate(self, platform):
        m = Module()
        m.submodules.accumulator, m.submodules.sums = self.accumulator, self.sums
        m.d.comb += [
            self.sums.votes.valid.eq(self.i.valid),
            self.sums.votes.payload.eq(self.i.payload),
            self.sums.steps.eq(self.accumulator.o),
        ]
        return m


@pytest.mark.parametrize("name", SHAPES)
def test_behind_the_accumulator(name, rng):
    """Tags that come back, RAMs that start with garbage, iterations as close as the sums may follow."""
    config = SHAPES[name].replace(tag_bits=4)
    wide = roomy(config)
    pair = Pair(wide)
    idle = max(pair.latency, config.one_pass.fewest_idle_cycles)
    noise = random_values(pair.i.payload.shape(), rng)
    script = [{"i.payload": next(noise)} for _ in range(config.geometry.bank_depth)]
    expected = []
    for votes in random_phases(config, rng).values():
        events = vote_payloads(wide, votes)
        for number, banks in enumerate(events):
            banks = complete(banks, (vote for any_event in noise for vote in any_event["banks"]))
            script.append({"i.valid": 1, "i.payload": {"banks": banks, "last": int(number == len(events) - 1)}})
        expected.append((len(script) - 1 + pair.latency, gradient_reader(accumulator(wide, votes))._asdict()))
        tag = int(rng.integers(idle))
        script += [{"i.payload": next(noise), "next_tag": int(n == tag)} for n in range(idle)]
    recording = play(pair, script, platform=AnyContent(rng))
    assert recording.flows["o"] == expected
