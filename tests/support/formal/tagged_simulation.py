"""Hazard-heavy traffic through a ``TaggedBank`` in Amaranth's simulator, beside a dictionary of {tag, pixel}."""

import random
from dataclasses import dataclass

from amaranth.sim import Simulator

from cmfpga.rtl import payloads
from support.formal.accumulator_simulation import wrapped
from support.formal.tagged_proof import tiny

CONFIG = tiny(12, 6)  # 3 rows of 8 words
PIXEL = payloads.pixel(CONFIG)
ADD = payloads.tagged_operation(CONFIG)["add"].shape


@dataclass(frozen=True)
class Operation:
    """What is offered in one cycle. Without ``valid`` the rest is there to tempt."""

    valid: bool
    address: int
    tag: int
    add: dict


def traffic(seed, cycles=600):
    """Operations that meet each other at all distances up to six, then one on every word with every tag."""
    rng = random.Random(seed)
    depth, tags = CONFIG.geometry.bank_depth, 1 << CONFIG.tag_bits

    def operation(address, *, valid=0.8, tag=None):
        add = {name: wrapped(rng.getrandbits(8), shape.shape) for name, shape in ADD}
        return Operation(rng.random() < valid, address, rng.randrange(tags) if tag is None else tag, add)

    operations = [operation(address, valid=1, tag=0) for address in range(depth)]
    operations += [operation(5, valid=1, tag=n // 4 % tags) for n in range(24)]
    for distance in range(1, 7):
        operations += [operation(n % distance, valid=1, tag=1 + n // 9 % 2) for n in range(6 * distance)]
    recent, tag = [0] * 6, 1
    for _ in range(cycles):
        address = rng.choice(recent) if rng.random() < 0.7 else rng.randrange(depth)
        recent = [address, *recent[:-1]]
        tag = tag if rng.random() < 0.7 else rng.randrange(tags)
        operations.append(operation(address, tag=tag))
    return operations + [operation(address, valid=1, tag=tag) for tag in range(tags) for address in range(depth)]


def model(operations, latency):
    """Per cycle the answer (I before, what was added, the pixel after), or ``None``."""
    words = {}
    answers = [None] * latency
    for operation in operations:
        if not operation.valid:
            answers.append(None)
            continue
        tag, pixel = words.get(operation.address, (0, dict.fromkeys(PIXEL.members, 0)))
        before = pixel if tag == operation.tag else dict.fromkeys(PIXEL.members, 0)
        after = {name: wrapped(before[name] + operation.add[name], shape) for name, shape in PIXEL.members.items()}
        words[operation.address] = operation.tag, after
        answers.append((before["i"], operation.add, after))
    return answers


def simulate(dut, operations):
    """Per cycle the answer, or ``None``; :attr:`latency` cycles longer than the operations."""
    answers = []

    async def bench(ctx):
        idle = Operation(False, 0, 0, dict.fromkeys(ADD.members, 0))
        for operation in [*operations, *[idle] * dut.latency]:
            ctx.set(dut.i.valid, operation.valid)
            ctx.set(dut.i.payload, {"address": operation.address, "tag": operation.tag, "add": operation.add})
            valid, step = ctx.get(dut.o.valid), ctx.get(dut.o.payload)
            words = [{name: word[name] for name in PIXEL.members} for word in (step.add, step.total)]
            answers.append((step.i, *words) if valid else None)
            await ctx.tick()

    simulator = Simulator(dut)
    simulator.add_clock(1e-6)
    simulator.add_testbench(bench)
    simulator.run()
    return answers
