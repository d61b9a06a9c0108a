"""Yosys maps the emitted core to the blocks of a device: how many memories and DSPs, and which registers DSPs take.

Exact numbers, so that growth is noticed. They are for ``synth_xilinx`` of Yosys 0.70; Vivado's may be smaller.
"""

import json
import re
from collections import Counter

import pytest
from verilog_tools import CONFIGS, emitted, yosys

from cmfpga.emit import TOP

pytestmark = pytest.mark.slow

OPTIONS = f"-noiopad -noclkbuf -top {TOP} -run begin:map_ffs"

RAMB36E2 = {
    # I, Dx and Dy: 1024 words of 20, 21 and 21 bits.
    **{f"accumulator_bank_{number}": 3 for number in range(4)},
    # 2048 events of 36 bits (24 of time, 6 of column, 6 of row).
    "event_buffer": 2,
}
DSP48E2 = {
    "gradient": 4,  # ΣI·ΣD for two axes, 20 × 20 bits, two DSPs each
    "gradient_reader": 16,  # I·D for two axes and four banks, 20 × 21 bits, two DSPs each
    "roi_updater": 2,  # roi_gain·v for two axes
    "time_scaler": 1,  # time difference times reciprocal
    "updater": 8,  # gradient times gain for two axes, 36 × 24 bits, four DSPs each
    "voter": 3,  # fx·fy, dt·fx, dt·fy
    "warp": 2,  # dt·v for two axes
}

#: Registers that DSPs take in, by block: (A, B, M, P) of each DSP, and how many DSPs have them.
PACKED = {
    # Input, product.
    "warp": {(1, 1, 1, 0): 2},
    "voter": {(1, 1, 1, 0): 3},
    "time_scaler": {(1, 1, 1, 0): 1},
    # The addition of the position is in the DSP, too.
    "roi_updater": {(1, 1, 1, 1): 2},
    # Of a product of two DSPs the second one's sum has its register. Yosys moves no registers between the two, so the
    # other stages of the product stay outside; Vivado does.
    "gradient_reader": {(1, 1, 0, 0): 8, (1, 1, 0, 1): 8},
    "gradient": {(1, 1, 0, 0): 2, (1, 1, 0, 1): 2},
    # Of four DSPs. Yosys adds their products in fabric, or the registers behind would be inside, too.
    "updater": {(0, 1, 0, 0): 8},
}


def test_memories_and_dsps(tmp_path):
    """For UltraScale+, which the KV260 has."""
    _, text = emitted(CONFIGS["default"])
    (tmp_path / "core.v").write_text(text)
    yosys(tmp_path, f"read_verilog core.v\nsynth_xilinx -family xcup {OPTIONS}\ntee -q -o stat.json stat -json\n")
    modules = json.loads((tmp_path / "stat.json").read_text())["modules"]
    cells = {name.lstrip("\\").removeprefix(f"{TOP}_"): m["num_cells_by_type"] for name, m in modules.items()}
    for kind, numbers in (("RAMB36E2", RAMB36E2), ("DSP48E2", DSP48E2)):
        assert {name: found[kind] for name, found in cells.items() if kind in found} == numbers
    # Gates and flip-flops are mapped by later steps; a latch, a memory or a multiplier would have been left over.
    other = r"RAM(?!B36E2)|URAM|FIFO|SRL|\$(_D?LATCH|_SR_|mem|mul|div|mod|dff|sdff)"
    assert not [kind for found in cells.values() for kind in found if re.match(other, kind)]


def test_registers_that_dsps_take_in(tmp_path):
    """For 7 series, because Yosys looks for DSP registers there only; flat, because they come from other blocks."""
    _, text = emitted(CONFIGS["default"])
    (tmp_path / "core.v").write_text(text)
    yosys(tmp_path, f"read_verilog core.v\nsynth_xilinx -family xc7 -flatten {OPTIONS}\ndump -o dsp.il t:DSP48E1\n")
    found = {}
    for cell in re.split(r"^\s+cell ", (tmp_path / "dsp.il").read_text(), flags=re.MULTILINE)[1:]:
        block = re.match(r"\\DSP48E1 \$flatten\\(\w+)\.", cell)[1]
        registers = dict(re.findall(r"parameter \\(\w+REG) (?:1')?(\d+)$", cell, re.MULTILINE))
        key = tuple(int(registers.get(f"{name}REG", 0)) for name in "ABMP")
        found.setdefault(block, Counter())[key] += 1
    assert found == PACKED
    assert {name: sum(counts.values()) for name, counts in found.items()} == DSP48E2
