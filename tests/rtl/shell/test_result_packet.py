"""Result packet: words and registers are those of the result, whatever stalls, is held or is read meanwhile."""

import itertools

import pytest

from cmfpga.config import preset
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.registers import register_map
from cmfpga.protocol.results import fields_of
from cmfpga.protocol.shapes import leaves
from cmfpga.rtl.shell import result_packet
from support.bench import simulate
from support.mutation import break_blocks
from support.values import Port, random_values


def words_of(config, registers, result, own):
    flat = dict(own)
    for f in fields_of("batch", "region", "packet", config=config):
        shape, value = f.shape(config), result[f.name]
        parts = value.values() if isinstance(value, dict) else [value]
        flat |= dict(zip(leaves(f.name, shape), parts, strict=True))
    if result["flags"] & Flag.DEGENERATE:
        flat |= {name: 0 for name in flat if name.startswith("sums_")}
    flat["t_ref"] = (result["t_first"] + (result["span"] >> 1)) % (1 << 32)
    group = registers.group("Result")
    words = {}
    for register in group:
        fields = [((flat[f.link] >> f.link_lsb) & (1 << f.width) - 1) << f.lsb for f in register.fields]
        words[(register.offset - group[0].offset) // 4] = sum(fields)
    return words


@pytest.mark.parametrize(("stall", "reads"), [(0.0, 0.0), (0.3, 0.3), (0.6, 0.1)])
@pytest.mark.parametrize("name", ["fast", "paper", "objects"])
def test_words_and_registers(name, stall, reads, rng):
    check(name, stall, reads, rng)


MUTANTS = {
    "every record ends a packet": ("last & ends if", "last if"),
    "no record does": ("ends.eq(last | ~streams)", "ends.eq(0)"),
    "streamed from the middle on": ("Mux(inside, streaming, self.stream_results)", "self.stream_results"),
    "every region is a batch": ("(self.i.payload.last if self.config.regions else 1)", "1"),
}


@pytest.mark.parametrize("mutant", MUTANTS)
def test_a_broken_packet_of_regions_is_noticed(mutant, monkeypatch, rng):
    break_blocks(monkeypatch, result_packet, *MUTANTS[mutant])
    with pytest.raises(AssertionError):
        check("objects", 0.3, 0.0, rng)


def check(name, stall, reads, rng):
    """Results, three of a batch with a table of regions, through a block; AssertionError where one is not right."""
    config = preset(name)
    registers = register_map(config)
    block = result_packet.ResultPacket(config, registers)
    results = random_values(block.i.payload.shape(), rng)
    shown, sent, held_back, of_batch = dict.fromkeys(range(64), 0), [], 0, 3 if config.regions else 1

    async def bench(ctx):
        nonlocal shown, held_back
        inputs = ("wire", "config_range", "stream_results", "hold", "read", "address")
        ports = {name: Port(getattr(block, name)) for name in inputs}
        payload, packets, left, current, number, begun = Port(block.i.payload), [], 15, None, 1, []
        streams, ends = False, []
        for cycle in range(2000):
            if current is None and rng.random() < 0.05 and left:
                left, current = left - 1, next(results)
                if config.regions:
                    current["last"] = int(left % of_batch == 0)
                payload.set(ctx, current)
            ctx.set(block.i.valid, int(current is not None))
            ctx.set(block.o.ready, int(rng.random() >= stall))
            ask = {name: int(rng.random() < 0.5) for name in ("wire", "config_range", "hold")}
            for name, value in (ask | {"stream_results": int(left % 5 > 0)}).items():
                ports[name].set(ctx, value)
            address = int(rng.integers(32))
            ports["read"].set(ctx, int(rng.random() < reads))
            ports["address"].set(ctx, address)
            if ctx.get(block.read):
                found = ctx.get(block.words) if ctx.get(block.any_shown) else 0
                assert found == shown.get(2 * address, 0) | shown.get(2 * address + 1, 0) << 32, (cycle, address)
            if ctx.get(block.begun):
                own = {"batch": number, "wire": ask["wire"], "config_range": ask["config_range"]}
                words, hold = words_of(config, registers, current, own), ask["hold"]
                begun.append(cycle)
                if (left + 1) % of_batch == 0:
                    streams = left % 5 > 0
                if streams:
                    packets.append(words)
                    ends.append(left % of_batch == 0)
            if ctx.get(block.o.valid) and ctx.get(block.o.ready):
                data, last = ctx.get(block.o.payload.data), ctx.get(block.o.payload.last)
                sent.extend((data & 0xFFFFFFFF, data >> 32))
                k = len(sent) // 2
                assert last == (k % block.beats == 0 and ends[(k - 1) // block.beats])
                if not stall and not reads:
                    assert cycle - begun[-1] == block.latency + (k - 1) % block.beats
            if ctx.get(block.taken):
                number, current = number + (left % of_batch == 0), None
                held_back += hold
                shown = shown if hold else words
            await ctx.tick()
        wanted = [packet.get(k, 0) for packet in packets for k in range(2 * block.beats)]
        assert sent == wanted and len(packets) > 8 and number == 1 + 15 // of_batch and 0 < held_back < 15
        assert min(b - a for a, b in itertools.pairwise(begun)) >= 32

    simulate(block, bench)
