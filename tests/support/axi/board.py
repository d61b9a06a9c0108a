"""The AXI top in a cocotb simulation, as software and DMA see it."""

import json
import os
import random

import cocotb
import numpy as np
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, RisingEdge, with_timeout
from cocotbext import axi

from cmfpga.config import Config
from cmfpga.protocol.registers import register_map
from cmfpga.protocol.tables import window_words
from cmfpga.protocol.words import result_values, setting_words, split_packets

CONFIG = Config(**json.loads(os.environ["CMFPGA_CONFIG"])) if "CMFPGA_CONFIG" in os.environ else Config()
PERIOD = 4  # ns


class Board:
    """Ports driven by cocotbext-axi; registers by name.

    ``cycle`` counts since the start; a word of s_axis was taken in the cycles ``taken``; ``sent`` are those in which
    m_axis handed one over, and whether it had TLAST.
    """

    def __init__(self, dut, *, seed=0, pauses=0.0):
        self.dut = dut
        self.registers = register_map(CONFIG)
        self.random = random.Random(seed)
        lite = "awprot", "arprot", "awvalid", "wvalid", "arvalid", "bready", "rready"
        for name in (*(f"s_axi_{one}" for one in lite), "s_axis_tvalid", "m_axis_tready", "aresetn"):
            getattr(dut, name).value = 0
        cocotb.start_soon(Clock(dut.aclk, PERIOD, unit="ns").start())
        reset = (dut.aclk, dut.aresetn, False)
        self.lite = axi.AxiLiteMaster(axi.AxiLiteBus.from_prefix(dut, "s_axi"), *reset)
        self.source = axi.AxiStreamSource(axi.AxiStreamBus.from_prefix(dut, "s_axis"), *reset)
        self.sink = axi.AxiStreamSink(axi.AxiStreamBus.from_prefix(dut, "m_axis"), *reset)
        self.monitor = axi.AxiStreamMonitor(axi.AxiStreamBus.from_prefix(dut, "m_axis"), *reset)
        for stream in (self.source, self.sink, self.monitor):
            stream.log.setLevel("ERROR")  # they write out whole packets
        self.cycle, self.taken, self.sent = 0, [], []
        self.pause(pauses)
        cocotb.start_soon(self._watch())

    def pause(self, probability):
        """Gaps and stalls on all channels with this probability."""

        def generator():
            return iter(lambda: self.random.random() < probability, None)

        writes, reads = self.lite.write_if, self.lite.read_if
        registers = writes.aw_channel, writes.w_channel, writes.b_channel, reads.ar_channel, reads.r_channel
        for channel in (self.source, self.sink, *registers):
            channel.clear_pause_generator()
            channel.pause = False
            if probability:
                channel.set_pause_generator(generator())

    async def _watch(self):
        """Count cycles and transfers, and check the rules of the streams, before each edge."""
        dut = self.dut
        waiting, payloads = None, [getattr(dut, f"m_axis_{name}") for name in ("tdata", "tkeep", "tlast", "tuser")]
        while True:
            await RisingEdge(dut.aclk)
            if dut.s_axis_tvalid.value == 1 and dut.s_axis_tready.value == 1:
                self.taken.append(self.cycle)
            if dut.m_axis_tvalid.value == 1 and dut.m_axis_tready.value == 1:
                self.sent.append((self.cycle, bool(dut.m_axis_tlast.value == 1)))
            payload = tuple(int(port.value) for port in payloads) if dut.m_axis_tvalid.value == 1 else None
            if waiting is not None and dut.aresetn.value == 1:
                assert payload == waiting, f"m_axis: {waiting} became {payload} while it waited"
            waiting = payload if dut.m_axis_tready.value != 1 else None
            self.cycle += 1

    async def reset(self, cycles=4):
        """Hold aresetn low."""
        self.dut.aresetn.value = 0
        await ClockCycles(self.dut.aclk, cycles)
        self.dut.aresetn.value = 1
        await ClockCycles(self.dut.aclk, 3)

    async def cycles(self, count):
        await ClockCycles(self.dut.aclk, count)

    # ---------------------------------------------------------------- registers

    async def write_word(self, offset, word):
        await with_timeout(self.lite.write_dword(offset, word & 0xFFFFFFFF), 100, "us")

    async def read_word(self, offset):
        return int(await with_timeout(self.lite.read_dword(offset), 100, "us"))

    async def write(self, name, word=None, **fields):
        """Write a register: a word, or fields by name (others 0)."""
        register = self.registers[name]
        await self.write_word(register.offset, register.pack(**fields) if word is None else word)

    async def read(self, name, field=None):
        """A register's word, or one field of it."""
        register = self.registers[name]
        word = await self.read_word(register.offset)
        return register[field].unpack(word) if field else word

    async def counters(self):
        return {
            link: await self.read_word(parts[0][0].offset) for link, parts in self.registers.linked("Counters").items()
        }

    async def apply(self, settings):
        """Write settings by their links, the schedules that they point at, and the nodes of a camera."""
        for name, word in setting_words(self.registers, settings).items():
            await self.write(name, word)
        for k, entry in enumerate(settings.get("schedule", ())):
            register = self.registers["SCHEDULE"]
            word = register.pack(**dict(zip((f.name for f in register.fields), entry, strict=True)))
            await self.write_word(register.offset + 4 * k, word)
        for node in settings.get("nodes", ()):
            values = dict(zip(("column", "row", "x", "y"), node, strict=True))
            for register, word in window_words(self.registers, "node", values):
                await self.write_word(register.offset, word)

    async def until(self, name, field, value=1):
        for _ in range(4000):
            if await self.read(name, field) == value:
                return
        raise AssertionError(f"{name}.{field} is not {value} after 4000 reads")

    async def result_registers(self):
        group = self.registers.group("Result")
        offsets = range(group[0].offset, group[-1].offset + 4, 4)
        return result_values(self.registers, [await self.read_word(offset) for offset in offsets])

    # ---------------------------------------------------------------- streams

    async def send(self, words, *, keep=None, wait=True):
        """One packet of 64-bit words, TLAST with the last; ``keep`` has one mask a word."""
        data = np.asarray(words, "<u8").tobytes()
        keep = None if keep is None else [mask >> n & 1 for mask in keep for n in range(8)]
        await self.source.send(axi.AxiStreamFrame(data, tkeep=keep))
        if wait:
            await with_timeout(self.source.wait(), 1, "ms")

    async def packet(self, *, timeout=1):
        """The next packet on m_axis, as 64-bit words; TKEEP must be all ones."""
        frame = await with_timeout(self.sink.recv(compact=False), timeout, "ms")
        assert all(frame.tkeep), "TKEEP is not all ones"
        return np.frombuffer(bytes(frame.tdata), "<u8").astype(np.uint64)

    async def result(self, **options):
        return result_values(self.registers, split_packets(self.registers, await self.packet(**options))[0].tolist())
