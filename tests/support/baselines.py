"""Measures again what ``baselines.json`` keeps (minutes). The tests compare with it, the documentation shows it:

PYTHONPATH=tests python -m support.baselines
python docs/tables.py
"""

import json
import sys
from pathlib import Path

from cmfpga.accuracy.studies import WIDTH_FIELDS, WIDTHS
from cmfpga.boards import DEFAULT as BOARD
from cmfpga.config import preset
from cmfpga.rtl.axi.top import AxiTop
from cmfpga.rtl.top import VerilogCore
from cmfpga.verilog import resources
from cmfpga.verilog.emit import emit_verilog

PATH = Path(__file__).parents[1] / "verilog" / "baselines.json"
PRESETS = ("paper", "fast")


def emitted(config):
    return emit_verilog(VerilogCore(config))


def measure_preset(name, report=None):
    """Of every block of a preset."""
    found = resources.estimate(emitted(preset(name)), **({"report": report} if report else {}))
    kept = {part: found[part] for part in ("estimate", "yosys", "total", "sum_of_blocks", "blocks")}
    return {**kept, "axi": measure_axi(name)}


def measure_axi(name):
    """Of the AXI top."""
    return resources.core(emit_verilog(AxiTop(preset(name)), BOARD.top), top=BOARD.top)


def measure_widths(widths):
    """Of ``fast`` with other fraction bits: a row of the study of word widths."""
    return resources.core(emitted(preset("fast").replace(**dict(zip(WIDTH_FIELDS, widths, strict=True)))))


def main():
    def report(doing):
        print(f"  {doing}", file=sys.stderr, flush=True)

    presets, rows = {}, {}
    for name in PRESETS:
        print(f"preset {name}", file=sys.stderr)
        presets[name] = measure_preset(name, report)
    for widths in WIDTHS:
        name = ", ".join(map(str, widths))
        report(f"widths {name}")
        rows[name] = measure_widths(widths)
    PATH.write_text(json.dumps({"presets": presets, "widths": rows}, indent=1) + "\n", encoding="utf-8")
    print(f"wrote {PATH.name}")


if __name__ == "__main__":
    main()
