"""Tagged accumulator against its model: no vote is lost, and no word of an earlier iteration is ever seen.

The RAMs start with random words in every test, as they may after a reset.
"""

import numpy as np
import pytest
from amaranth.hdl import Elaboratable, Module, ResetInserter, Signal

from cmfpga.config import Config, preset
from cmfpga.reference.integer.accumulator import accumulator
from cmfpga.reference.integer.voter import voter
from cmfpga.rtl import payloads
from cmfpga.rtl.image.tagged_accumulator import TaggedAccumulator
from support.bench import AnyContent, play
from support.configs import LEVELS
from support.values import random_values, tensor
from support.votes import cell_votes, patterns, vote_payloads


def small(width, height, tag_bits):
    """Few words, and few tags for them."""
    return preset("fast").replace(roi_width=width, roi_height=height, buffer_events=40, tag_bits=tag_bits)


SHAPES = {
    "fast odd": LEVELS["fast odd"],
    "fast tiny": LEVELS["fast tiny"],
    # Wide words; a bank of as many rows as the tags can say.
    "wide": Config(roi_width=12, roi_height=10, buffer_events=40, gradient="one_pass", tag_bits=2),
    "three tags": small(10, 7, 2),
    "seven tags": small(9, 8, 3),
}

PIXEL = ("i", "dx", "dy")


# ---------------------------------------------------------------- playing


class Script:
    """What is played, and what must come of it.

    Whatever is not valid is random: banks without a vote, votes in idle cycles.
    """

    def __init__(self, config, rng):
        self.config, self.rng = config, rng
        payload = payloads.votes(config)
        self.votes_noise = random_values(payload, rng)
        self.vote_noise = random_values(payload["banks"].shape.elem_shape, rng)
        self.cycles = []
        self.steps = {}  # cycle -> for each bank its step, or None
        self.swept = []  # cycles
        self.sweep = 0
        self.words = [{} for _ in range(4)]

    def idle(self, cycles, next_tag=None):
        """Cycles without an event, ``next_tag`` in one of them."""
        for number in range(cycles):
            if self.sweep == self.config.geometry.bank_depth - 1:
                self.swept.append(len(self.cycles))
            self.sweep = (self.sweep + 1) % self.config.geometry.bank_depth
            self.cycles.append({"i.payload": next(self.votes_noise), "next_tag": int(number == next_tag)})

    def first_pass(self):
        """The sweep's first pass, after which the first vote may come at once."""
        self.idle(self.config.geometry.bank_depth)

    def iteration(self, events, *, idle, next_tag=None):
        """Events without a gap, then ``idle`` cycles; the tag changes in any of them."""
        self.words = [{} for _ in range(4)]
        for banks in events:
            steps = []
            for words, vote in zip(self.words, banks, strict=True):
                if vote is None:
                    steps.append(None)
                    continue
                before = words.get(vote["address"], dict.fromkeys(PIXEL, 0))
                words[vote["address"]] = {name: before[name] + vote[name] for name in PIXEL}
                steps.append(
                    {
                        "valid": 1,
                        "i": before["i"],
                        "add": {name: vote[name] for name in PIXEL},
                        "total": words[vote["address"]],
                    }
                )
            self.steps[len(self.cycles) + TaggedAccumulator.latency] = steps
            payload = {"banks": [vote or next(self.vote_noise) | {"valid": 0} for vote in banks], "last": 0}
            self.cycles.append({"i.valid": 1, "i.payload": payload})
        self.idle(idle, int(self.rng.integers(idle)) if next_tag is None else next_tag)

    def play(self, *, top=None, cycles=None):
        cycles = self.cycles if cycles is None else cycles
        platform = AnyContent(self.rng)
        tail = [{"i.payload": next(self.votes_noise)} for _ in range(TaggedAccumulator.latency)]
        return play(
            top or TaggedAccumulator(self.config), [*cycles, *tail], flows=(), watch=("o", "swept"), platform=platform
        ).watch

    def differences(self, watch, start=0):
        """Cycles, from ``start`` on, in which a step is not the model's."""
        wrong = []
        for cycle, came in enumerate(watch["o"][start:]):
            came = [step if step["valid"] else None for step in came]
            if came != self.steps.get(cycle, [None] * 4):
                wrong.append(cycle)
        return wrong

    def check(self, watch, start=0):
        """Every step in its cycle and no other; the sweep in idle cycles only."""
        wrong = self.differences(watch, start)
        assert not wrong, f"{len(wrong)} of {len(self.steps)} cycles differ, first {wrong[0]}: " + (
            f"{watch['o'][start + wrong[0]]}, not {self.steps.get(wrong[0])}"
        )
        swept = [cycle for cycle, value in enumerate(watch["swept"][start:]) if value]
        # The tail that `play` adds is idle, too.
        assert [cycle for cycle in swept if cycle < len(self.cycles)] == self.swept


def check_phases(config, phases, idle, seed=0):
    """Iterations ``{name: votes}`` after a first pass, ``idle()`` cycles apart."""
    script = Script(config, np.random.default_rng(seed))
    script.first_pass()
    for votes in phases.values():
        script.iteration(vote_payloads(config, votes), idle=idle())
        # The model's own words, summed in another way.
        images = accumulator(config, votes)
        for number, words in enumerate(script.words):
            for address, pixel in words.items():
                row = 2 * (address >> config.geometry.bank_column_bits) + (number >> 1)
                column = 2 * (address & ((1 << config.geometry.bank_column_bits) - 1)) + (number & 1)
                assert [int(image[row, column]) for image in images] == [pixel[name] for name in PIXEL]
    script.check(script.play())


@pytest.mark.parametrize("idle", ["fewest", "random"])
@pytest.mark.parametrize("name", SHAPES)
def test_hazards(name, idle, rng):
    """All patterns back to back; iterations without any event among them."""
    config = SHAPES[name]
    fewest = config.one_pass.fewest_idle_cycles
    phases = {name: cell_votes(config, cells, rng) for name, cells in patterns(config, rng).items()}
    check_phases(config, phases, (lambda: fewest) if idle == "fewest" else lambda: fewest + int(rng.integers(9)))


@pytest.mark.parametrize("name", ["fast odd", "fast tiny", "wide"])
def test_votes_of_the_voter_at_every_level(name, rng):
    """What the voter really gives, the level changing from iteration to iteration."""
    config = SHAPES[name]
    phases = {}
    for number in range(8):
        level = number % (config.max_level + 1)
        events = 30
        frac = config.position_frac
        x, y = (rng.integers(-2 << frac, (size + 1) << frac, events) for size in config.geometry.level_size(level))
        dt = rng.integers(-1 << config.dt_frac, 1 << config.dt_frac, events, endpoint=True)
        phases[number] = voter(config, tensor(x), tensor(y), tensor(dt), level)
    check_phases(config, phases, lambda: config.one_pass.fewest_idle_cycles)


@pytest.mark.parametrize("sign", [-1, 1])
def test_words_hold_every_event_on_one_pixel(sign):
    """The largest words that can be, and none of them in the next iteration."""
    config = SHAPES["three tags"]
    rng = np.random.default_rng(0)
    votes = cell_votes(config, [(1, 1)] * config.buffer_events, rng)
    top = sign * config.widths.derivative_max
    votes = votes._replace(w=votes.w * 0 + config.widths.weight_max, dx=votes.dx * 0 + top, dy=votes.dy * 0 - top)
    again = cell_votes(config, [(1, 1)], rng)
    check_phases(config, {"full": votes, "one": again, "full again": votes}, lambda: config.one_pass.fewest_idle_cycles)
    largest = accumulator(config, votes)
    assert int(largest.i.max()) == config.widths.image_max
    assert int((sign * largest.dx).max()) == int((-sign * largest.dy).max()) == config.widths.derivative_image_max


# ---------------------------------------------------------------- tags that come back


def words_of(config, numbers, rng):
    """One event per word of the banks in ``numbers``, with a vote in each bank."""
    columns = config.geometry.bank_columns
    cells = [(2 * (n % columns), 2 * (n // columns)) for n in numbers]
    return vote_payloads(config, cell_votes(config, cells, rng))


def every_word_when_its_tag_is_back(config, idle, rng):
    """Every word gets a vote when its tag is in use again, and none before: all of them depend on the sweep."""
    tags = (1 << config.tag_bits) - 1
    script = Script(config, rng)
    script.first_pass()
    # The sweep gets ahead by idle cycles, so in so many iterations it has stood everywhere when a tag came back.
    for number in range(tags * (config.geometry.bank_depth + 2)):
        words = range(number % tags, config.geometry.bank_words, tags)
        script.iteration(words_of(config, words, rng), idle=idle)
    return script


RETURNING = {
    "exactly enough": small(6, 6, 2),  # 3 · 4 = 12 words
    "nearly": small(6, 4, 2),  # 3 · 3 > 8
    "seven tags": small(14, 4, 3),  # 7 · 3 > 16
}


@pytest.mark.parametrize("name", RETURNING)
def test_tags_come_back_after_the_fewest_idle_cycles(name, rng):
    config = RETURNING[name]
    script = every_word_when_its_tag_is_back(config, config.one_pass.fewest_idle_cycles, rng)
    script.check(script.play())


@pytest.mark.parametrize("name", RETURNING)
def test_one_idle_cycle_fewer_is_refused_and_goes_wrong(name, rng):
    config = RETURNING[name]
    idle = config.one_pass.fewest_idle_cycles - 1
    script = every_word_when_its_tag_is_back(config, idle, rng)
    wrong = script.differences(script.play())
    assert wrong and wrong[0] >= ((1 << config.tag_bits) - 1) * idle, "goes wrong for another reason"


def test_the_rule_is_exact():
    """(2^tag_bits − 1) · idle ≥ words: refused at one word more, or one idle cycle fewer."""
    for config in RETURNING.values():
        tags = (1 << config.tag_bits) - 1
        for idle in range(1, 20):
            assert (idle >= config.one_pass.fewest_idle_cycles) == (tags * idle >= config.geometry.bank_depth)
    assert (
        RETURNING["exactly enough"].one_pass.fewest_idle_cycles * 3 == RETURNING["exactly enough"].geometry.bank_depth
    )


# ---------------------------------------------------------------- after a reset


def test_without_the_first_pass_there_is_garbage(rng):
    """That the tests above start from garbage is not idle talk: votes before the sweep's first pass meet it."""
    config = RETURNING["exactly enough"]
    script = Script(config, rng)
    script.iteration(words_of(config, range(config.geometry.bank_words), rng), idle=1)
    assert len(script.differences(script.play())) > 1


@pytest.mark.parametrize("name", ["three tags", "fast tiny"])
def test_reset_at_any_moment(name, rng):
    """Whatever is under way: after one more pass everything is as new, though the RAMs keep what they had."""
    config = SHAPES[name]
    idle = config.one_pass.fewest_idle_cycles
    for _ in range(6):
        top = Resettable(TaggedAccumulator(config))
        before, after = Script(config, rng), Script(config, rng)
        for script in (before, after):
            script.first_pass()
            for number in range(7):
                words = words_of(config, rng.integers(0, config.geometry.bank_words, number).tolist(), rng)
                script.iteration(words, idle=idle)
        cut = before.cycles[: int(rng.integers(config.geometry.bank_depth, len(before.cycles)))]
        start = len(cut) + 1
        watch = after.play(top=top, cycles=[*cut, {"reset": 1}, *after.cycles])
        after.check(watch, start)


class Resettable(Elaboratable):
    """The block with a reset of its own."""

    def __init__(self, block):
        self.block = block
        self.reset = Signal()

    def __getattr__(self, name):
        return getattr(self.block, name)

    def elaborate(self, platform):
        m = Module()
        m.submodules.block = ResetInserter(self.reset)(self.block)
        return m
