"""The shell needs no AXI: a board without a processor drives it, and its results equal the integer model's."""

import pytest
from amaranth.hdl import ClockDomain, Module, Signal
from amaranth.lib import memory, stream, wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from cmfpga.protocol.flags import Flag
from cmfpga.protocol.registers import register_map
from cmfpga.protocol.settings import BatchSettings
from cmfpga.protocol.words import encode, result_values, setting_words, split_packets
from cmfpga.reference.wire import to_beats
from cmfpga.rtl.shell import payloads
from cmfpga.rtl.shell.shell import Shell
from support.axi.expected import Expected, links, moving_events, same
from support.axi_streams import pass_through
from support.configs import CONFIGS, LEVELS

BOTH = {
    "paper": CONFIGS["odd"].replace(iterations=3, min_roi_events=8),
    "fast": LEVELS["fast odd"].replace(min_roi_events=8),
}


class Standalone(wiring.Component):
    """Writes a table of ``(offset, word)`` into the registers once, and shows on a lamp whether there was a batch."""

    def __init__(self, config, writes):
        self.sync = ClockDomain("sync")
        self.shell = Shell(config, clock=self.sync.clk)
        self.writes = [{"address": offset // 4, "data": word, "strobe": 15} for offset, word in writes]
        beats = stream.Signature(payloads.beat())
        super().__init__({"i": In(beats), "o": Out(beats), "irq": Out(1), "lamp": Out(1)})

    def elaborate(self, platform):
        m = Module()
        m.submodules.shell = shell = self.shell
        m.submodules.table = table = memory.Memory(shape=payloads.write(), depth=len(self.writes), init=self.writes)
        written = Signal(range(len(self.writes) + 1))
        port = table.read_port(domain="comb")
        connect(m, flipped(self.i), shell.i)
        connect(m, shell.o, flipped(self.o))
        m.d.comb += [
            port.addr.eq(written),
            shell.bus.write.payload.eq(port.data),
            shell.bus.write.valid.eq(written != len(self.writes)),
            shell.bus.read_address.eq(shell.registers["COUNT_BATCHES"].offset // 4),
            self.lamp.eq(shell.bus.read_data != 0),
            self.irq.eq(shell.irq),
        ]
        m.d.sync += written.eq(written + (shell.bus.write.valid & shell.bus.write.ready))
        return m


def writes_of(config, settings):
    """All settings, the table of schedules, the interrupt; and then go."""
    registers, values = register_map(config), links(config, settings)
    for name, word in setting_words(registers, values).items():
        yield registers[name].offset, word
    for k, entry in enumerate(values.get("schedule", ())):
        names = (f.name for f in registers["SCHEDULE"].fields)
        word = registers["SCHEDULE"].pack(**dict(zip(names, entry, strict=True)))
        yield registers["SCHEDULE"].offset + 4 * k, word
    for name, fields in {"IER": ["DONE"], "GIE": ["ENABLE"], "CTRL": ["START", "AUTO_RESTART"]}.items():
        yield registers[name].offset, registers[name].pack(**dict.fromkeys(fields, 1))


@pytest.mark.parametrize("name", BOTH)
def test_a_board_without_a_processor_equals_the_model(name, rng):
    config = BOTH[name]
    settings, model = BatchSettings.from_config(config, (9, 8)), Expected(config)
    block = Standalone(config, list(writes_of(config, settings)))
    beats = to_beats(encode(moving_events(config, 90, 1), "EVT21"))
    (batch,), _ = model.receive(beats, "EVT21")
    items = [{**beat._asdict(), "last": int(beat.last), "user": 0} for beat in beats]
    length = block.shell.result_packet.beats
    passage = pass_through(block, items, "both", rng, expect=length, pulses=("irq", "lamp"))
    assert [value["last"] for value in passage.values] == [0] * (length - 1) + [1]
    (words,) = split_packets(block.shell.registers, [value["data"] for value in passage.values])
    found = result_values(block.shell.registers, words.tolist())
    same(found, model.result(batch, settings))
    assert found["roi_events"] > 10 and found["sums_sx"] and not found["flags"] & ~Flag.DOUBTFUL
    (first, _), (last, _) = passage.out[0], passage.out[-1]
    assert first < min(passage.pulses["irq"]) <= last and min(passage.pulses["lamp"]) > first - 2
