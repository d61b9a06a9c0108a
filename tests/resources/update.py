"""Measures the presets again and writes ``baselines.json`` (minutes):

python tests/resources/update.py
python docs/generate.py            puts them into the documentation
"""

import json
import sys
from pathlib import Path

from cmfpga import resources
from cmfpga.config import preset
from cmfpga.emit import emit_verilog
from cmfpga.rtl.top import VerilogCore

PATH = Path(__file__).with_name("baselines.json")
PRESETS = ("paper", "fast")


def measure(name):
    """What is kept of the estimate of a preset."""
    print(f"preset {name}", file=sys.stderr)
    found = resources.estimate(
        emit_verilog(VerilogCore(preset(name))), report=lambda doing: print(f"  {doing}", file=sys.stderr)
    )
    return {part: found[part] for part in ("yosys", "total", "sum_of_blocks", "blocks")}


if __name__ == "__main__":
    PATH.write_text(json.dumps({name: measure(name) for name in PRESETS}, indent=1) + "\n", encoding="utf-8")
    print(f"wrote {PATH.name}")
