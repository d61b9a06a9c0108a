"""Yosys maps the emitted core to the blocks of a device: which registers its DSPs take.

Exact numbers, so that a change is noticed, for ``synth_xilinx`` of Yosys 0.70; Vivado's may differ. How many DSPs and
RAMs there are is in tests/verilog.
"""

import json
import re
from collections import Counter
from pathlib import Path

from cmfpga.verilog.emit import TOP
from support.verilog_tools import CONFIGS, emitted, yosys

OPTIONS = f"-noiopad -noclkbuf -top {TOP} -run begin:map_ffs"

#: Registers that DSPs take in, by block: (A, B, M, P) of each DSP, and how many DSPs have them.
PACKED = {
    # Input, product.
    "voter": {(1, 1, 1, 0): 3},
    # Of the two halves of its product the upper one's sum is in the DSP, too.
    "time_scaler": {(1, 1, 1, 0): 1, (1, 1, 1, 1): 1},
    # The addition of the position is in the DSP, too.
    "warp": {(1, 1, 1, 1): 2},
    # Products of wide factors: of pieces, each with its register; the smallest piece is multiplied in LUTs.
    "image": {(1, 1, 1, 0): 16, (1, 1, 1, 1): 8},
    "gradient": {(1, 1, 1, 0): 4, (1, 1, 1, 1): 2},
    "ascent": {(1, 1, 1, 0): 12},
}


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
    # As many as for the KV260's family.
    stored = json.loads((Path(__file__).with_name("baselines.json")).read_text())["presets"]["paper"]
    dsps = {name: row["dsp"] for name, row in stored["blocks"].items() if row["dsp"]}
    assert {name: sum(counts.values()) for name, counts in found.items()} == dsps
