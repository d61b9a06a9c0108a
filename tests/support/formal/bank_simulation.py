"""Hazard-heavy traffic through a bank of either accumulator in Amaranth's simulator, beside a dictionary that adds."""

import random
from dataclasses import dataclass

from amaranth.hdl import Shape, signed
from amaranth.lib import data

from cmfpga.rtl import payloads
from support.bench import play
from support.formal.accumulator_proof import tiny

# Small enough to wrap often; signed and unsigned, addends narrower than the words.
WORD = data.StructLayout({"i": 6, "dx": signed(5)})
ADD = data.StructLayout({"i": 4, "dx": signed(3)})
DEPTH = 16
CONFIG = tiny(12, 6)  # 3 rows of 8 words
PIXEL = payloads.pixel(CONFIG)


def wrapped(value, shape):
    """``value`` in so many bits."""
    shape = Shape.cast(shape)
    value %= 1 << shape.width
    return value - (1 << shape.width) if shape.signed and value >> (shape.width - 1) else value


def added(word, add, layout):
    return {name: wrapped(word[name] + add[name], shape) for name, shape in layout.members.items()}


@dataclass(frozen=True)
class ReadAddWriteTraffic:
    """Of :class:`ReadAddWrite`: what is offered, and what a dictionary of words answers."""

    arguments: tuple = (WORD, ADD, DEPTH)
    depth: int = DEPTH
    add: data.Layout = ADD

    def kinds(self, rng, number):
        """The rest of operation ``number`` of a series, or of one among many."""
        return {"clear": int(number is None and rng.random() < 0.15)}

    def last(self):
        """The rest of the operations that end it all on every word."""
        return [{"clear": 1}]

    def answer(self, words, operation):
        before = words.get(operation["address"], dict.fromkeys(WORD.members, 0))
        cleared = dict.fromkeys(WORD.members, 0)
        words[operation["address"]] = cleared if operation["clear"] else added(before, operation["add"], WORD)
        return before


@dataclass(frozen=True)
class TaggedTraffic:
    """Of :class:`TaggedBank`: the answer is I before, what was added, and the pixel after."""

    arguments: tuple = (CONFIG,)
    depth: int = CONFIG.geometry.bank_depth
    add: data.Layout = payloads.tagged_operation(CONFIG)["add"].shape

    def kinds(self, rng, number):
        """A tag that stays for a while."""
        return {"tag": rng.choice([1, 1, 1, 2, 0, 3]) if number is None else number // 5 % (1 << CONFIG.tag_bits)}

    def last(self):
        return [{"tag": tag} for tag in range(1 << CONFIG.tag_bits)]

    def answer(self, words, operation):
        tag, pixel = words.get(operation["address"], (0, None))
        before = pixel if pixel and tag == operation["tag"] else dict.fromkeys(PIXEL.members, 0)
        after = added(before, operation["add"], PIXEL)
        words[operation["address"]] = operation["tag"], after
        return {"i": before["i"], "add": operation["add"], "total": after}


def differences(dut, kind, seed, cycles=200):
    """Cycles in which the answer is not the model's.

    Operations meet each other at all distances up to six; then comes one on every word. What is not valid tempts.
    """
    rng = random.Random(seed)
    script, answers, words = [], [None] * dut.latency, {}

    def offer(address, kinds, valid=1):
        add = {name: wrapped(rng.getrandbits(8), shape.shape) for name, shape in kind.add}
        operation = {"address": address, "add": add, **kinds}
        script.append({"i.valid": valid, "i.payload": operation})
        answers.append(kind.answer(words, operation) if valid else None)

    for number in range(24):
        offer(5, kind.kinds(rng, number))
    for distance in range(1, 7):
        for number in range(6 * distance):
            offer(number % distance, kind.kinds(rng, number))
    recent = [0] * 6
    for _ in range(cycles):
        address = rng.choice(recent) if rng.random() < 0.7 else rng.randrange(kind.depth)
        recent = [address, *recent[:-1]]
        offer(address, kind.kinds(rng, None), int(rng.random() < 0.8))
    for kinds in kind.last():
        for address in range(kind.depth):
            offer(address, kinds)
    recording = play(dut, [*script, *[{}] * dut.latency])
    came = dict(recording.flows["o"])

    def right(cycle, wanted):
        return (cycle in came) == bool(wanted) and (not wanted or came[cycle] | wanted == came[cycle])

    return [cycle for cycle, wanted in enumerate(answers) if not right(cycle, wanted)]
