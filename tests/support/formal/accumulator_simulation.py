"""Hazard-heavy traffic through a ``ReadAddWrite`` in Amaranth's simulator, beside a dictionary that adds."""

import random
from dataclasses import dataclass

from amaranth.hdl import Shape, signed
from amaranth.lib import data
from amaranth.sim import Simulator

# Small enough to wrap often; signed and unsigned, addends narrower than the words.
WORD = data.StructLayout({"i": 6, "dx": signed(5)})
ADD = data.StructLayout({"i": 4, "dx": signed(3)})
DEPTH = 16


@dataclass(frozen=True)
class Operation:
    """What is offered in one cycle. Without ``valid`` the rest is there to tempt."""

    valid: bool
    address: int
    clear: bool
    add: dict


def wrapped(value, shape):
    """``value`` in so many bits."""
    shape = Shape.cast(shape)
    value %= 1 << shape.width
    return value - (1 << shape.width) if shape.signed and value >> (shape.width - 1) else value


def traffic(seed, cycles=400):
    """Operations that meet each other at all distances up to five, then a sweep that reads and clears every word."""
    rng = random.Random(seed)

    def operation(address, *, valid=0.75, clear=0.15):
        add = {name: wrapped(rng.getrandbits(8), shape.shape) for name, shape in ADD}
        return Operation(rng.random() < valid, address, rng.random() < clear, add)

    operations = [operation(5, valid=1, clear=0) for _ in range(12)]
    for distance in range(1, 7):
        operations += [operation(n % distance, valid=1, clear=0) for n in range(4 * distance)]
    recent = [0] * 6
    for _ in range(cycles):
        address = rng.choice(recent) if rng.random() < 0.7 else rng.randrange(DEPTH)
        recent = [address, *recent[:-1]]
        operations.append(operation(address))
    return operations + [operation(address, valid=1, clear=1) for address in range(DEPTH)]


def model(operations, latency):
    """Per cycle the answer, or ``None``."""
    words = [dict.fromkeys(WORD.members, 0) for _ in range(DEPTH)]
    answers = [None] * latency
    for operation in operations:
        word = words[operation.address]
        answers.append(dict(word) if operation.valid else None)
        if operation.valid:
            for name, shape in WORD.members.items():
                word[name] = 0 if operation.clear else wrapped(word[name] + operation.add[name], shape)
    return answers


def simulate(dut, operations):
    """Per cycle the answer, or ``None``; :attr:`latency` cycles longer than the operations."""
    answers = []

    async def bench(ctx):
        idle = Operation(False, 0, False, dict.fromkeys(ADD.members, 0))
        for operation in [*operations, *[idle] * dut.latency]:
            ctx.set(dut.i.valid, operation.valid)
            ctx.set(
                dut.i.payload,
                {"address": operation.address, "clear": operation.clear, "add": operation.add},
            )
            _, _, valid, payload = await ctx.tick().sample(dut.o.valid, dut.o.payload)
            answers.append({name: payload[name] for name in WORD.members} if valid else None)

    simulator = Simulator(dut)
    simulator.add_clock(1e-6)
    simulator.add_testbench(bench)
    simulator.run()
    return answers
