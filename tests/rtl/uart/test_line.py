"""The serial line: every byte, at clocks that differ by what a line may, and what is no byte."""

import pytest
from amaranth.hdl import Module

from cmfpga.rtl.uart.line import Receiver, Transmitter
from support.bench import simulate

BYTES = [*range(256), 0x00, 0xFF, 0x55, 0xAA]


def levels(content, bit):
    """The wire, cycle by cycle, where a bit takes ``bit`` cycles, which need not be whole."""
    bits = [b for byte in content for b in (0, *(byte >> k & 1 for k in range(8)), 1)]
    return [bits[int(cycle / bit)] for cycle in range(int(len(bits) * bit))]


def received(divisor, wire, tail=40):
    block, found, errors = Receiver(divisor), [], []

    async def bench(ctx):
        for cycle, level in enumerate([*wire, *[1] * tail]):
            ctx.set(block.wire, level)
            if ctx.get(block.o.valid):
                found.append(ctx.get(block.o.payload))
            if ctx.get(block.error):
                errors.append(cycle)
            await ctx.tick()

    simulate(block, bench)
    return found, len(errors)


@pytest.mark.parametrize(("divisor", "bit"), [(4, 4), (5, 5), (25, 25), (25, 25.7), (25, 24.3)])
def test_every_byte_is_received(divisor, bit):
    content = BYTES if divisor == 5 else [0x00, 0xFF, 0x55, 0xAA, 0xC0, 0x80, 0x01, 0x7F]
    assert received(divisor, levels(content, bit)) == (content, 0)


def test_a_byte_without_a_stop_bit_is_counted_and_the_line_recovers():
    broken = [0] * 60  # much longer than a byte: one error
    assert received(5, [1] * 9 + broken + [1] * 20 + levels([0x5A], 5)) == ([0x5A], 1)


def test_a_spike_is_no_start_bit():
    assert received(25, [1] * 9 + [0] * 5 + [1] * 60 + levels([0xA5], 25)) == ([0xA5], 0)


@pytest.mark.parametrize("divisor", [4, 5])
def test_what_is_sent_is_received(divisor, rng):
    m = Module()
    m.submodules.sender = sender = Transmitter(divisor)
    m.submodules.receiver = receiver = Receiver(divisor)
    m.d.comb += receiver.wire.eq(sender.wire)
    content, found, pause = BYTES[-40:], [], rng.integers(0, 3, 40) * 17

    async def send(ctx):
        for byte, cycles in zip(content, pause, strict=True):
            for _ in range(cycles):
                await ctx.tick()
            ctx.set(sender.i.payload, byte)
            ctx.set(sender.i.valid, 1)
            await ctx.tick().until(sender.i.ready)
            ctx.set(sender.i.valid, 0)

    async def take(ctx):
        while len(found) < len(content):
            if ctx.get(receiver.o.valid):
                found.append(ctx.get(receiver.o.payload))
            await ctx.tick()

    simulate(m, send, take)
    assert found == content
