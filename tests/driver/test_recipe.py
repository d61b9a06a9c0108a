"""The recipe of docs/registers.md writes what the driver does; played word by word it gives the model's result."""

import re
from pathlib import Path

from cmfpga.config import preset
from cmfpga.driver.golden import expected_result, golden_batch, setting_writes
from cmfpga.driver.simulation import PACKET
from cmfpga.protocol.registers import register_map
from support.driving import CONFIG, REGISTERS

PAGE = (Path(__file__).parents[2] / "docs" / "registers.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| \d \| `(0x\w+)` \| `(\w+)` \| ((?:`0x\w+` ?)+) \|", PAGE, re.MULTILINE)
WRITES = [
    (int(offset, 16) + 4 * k, int(word, 16))
    for offset, _, words in ROWS
    for k, word in enumerate(re.findall(r"0x\w+", words))
]


def test_it_writes_what_the_driver_does():
    config = preset("fast")
    registers, told, driver = register_map(config), dict(WRITES), setting_writes(config)
    assert [registers[name].offset for _, name, _ in ROWS] == [int(offset, 16) for offset, _, _ in ROWS]
    resets = {register.offset: register.reset for register in registers}
    assert [told.get(offset, resets.get(offset)) for offset, _ in driver] == [word for _, word in driver]
    more = {registers[name].offset for name in ("INPUT", "ISR", "CTRL")}
    assert set(told) - {offset for offset, _ in driver} == more and len(told) == len(WRITES)


def test_played_on_the_emitted_verilog(top):
    (events, roi), expected = golden_batch(CONFIG), expected_result(CONFIG)[0]
    for offset, word in WRITES:
        top.write32(offset, roi[0] | roi[1] << 16 if offset == REGISTERS["ROI"].offset else word)
    top.send([int(t) << 32 | int(y) << 16 | int(x) for t, x, y in zip(events.t, events.x, events.y, strict=True)])
    assert top.run(100_000, PACKET)
    words = [int(word) for word in top.take()]
    assert len(words) == top.read32(REGISTERS["RESULT_SIZE"].offset) and "packet of `RESULT_SIZE` words" in PAGE
    (low, high), span = ((words[2] & 0xFFFFFFFF, words[2] >> 32), words[3] >> 32)
    found = [(half - (half >> 31 << 32)) / 2**6 * 2_000_000 / span for half in (low, high)]
    assert found == [v * 2_000_000 / expected["span"] for v in expected["v"]] and any(found)
    assert (words[0] & 0xFFFFFFFF, words[0] >> 32) == (1, expected["flags"])
    assert (words[8] >> 32 & 0xFFFF, words[8] >> 48) == tuple(expected["roi_next"])
