"""Measures again what ``baselines.json`` keeps, where its Verilog has changed. The tests compare with it, docs show it:

PYTHONPATH=tests python -m support.baselines            # resources, minutes
PYTHONPATH=tests python -m support.baselines placed     # clock and area by place and route, an hour
PYTHONPATH=tests python -m support.baselines families   # the same of other families than the ECP5, hours
PYTHONPATH=tests python -m support.baselines families "paper, GW2A-18"   # this row alone, in any case, of all seeds
python docs/tables.py
"""

import ast
import json
import re
import sys
from pathlib import Path

from cmfpga.boards import DEFAULT as BOARD
from cmfpga.config import preset
from cmfpga.fpga import place, resources
from cmfpga.fpga.families import FAMILIES
from cmfpga.rtl.axi.top import AxiTop
from cmfpga.verilog.emit import TOP, emit_verilog, sha256
from support.emitted_hashes import axi_top, body
from support.verilog_tools import emitted

PATH = Path(__file__).parents[1] / "fpga" / "baselines.json"
PRESETS = ("paper", "fast")
#: Of these only the whole core: four evaluators; windows that slide; without confidence; motions and their neighbours.
PLAIN = {"quad": {}, "sliding": {}, "fast, no confidence": {"confidence": 0}}
MOTIONS = {name: {} for name in ("full-frame", "rotation", "fast-128", "similarity")}
#: Of many regions: a unit by itself, and all of it, of one unit and of four.
REGIONS = {"flow, a unit": {"units": 1}, "flow, one unit": {"units": 1}, "flow": {}}
#: Presets that fit the device, with the fields that it asks for, and seeds of each. 36-kbit RAMs are two each there.
PLACED, SEEDS = {"fast": {"ram_style": "auto"}, "paper": {}, "quad": {}, "sliding": {}}, 5
#: Presets that other families' devices hold.
ELSEWHERE = {"LIFCL-40": ("fast",), "GW2A-18": ("paper",)}
BASELINES = json.loads(PATH.read_text(encoding="utf-8"))


def code_of(module):
    """The code of a module without its docstrings and comments."""
    tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body[0] = ast.Pass()
    return ast.unparse(tree)


def fingerprint(text, row, module=resources):
    """Of a row and of all that its measurement depends on: the Verilog, Yosys and the code that counts."""
    counted = code_of(module)
    if "device" in row:
        family = FAMILIES[row["device"]]
        counted += f"{family.synthesis} {family.options}"
    return sha256(json.dumps([body(text), resources.require_yosys(), counted, row], sort_keys=True))


def current(name, row, text, measure, module=resources):
    """What is kept of ``name``, if nothing that it depends on has changed; else a new measurement."""
    if row and BASELINES["fingerprints"].get(name) == fingerprint(text, row, module):
        return row
    print(f"measuring {name}", file=sys.stderr, flush=True)
    return measure()


def core_of(name):
    """Rows of every block of a preset; and of the core, of which ``emitted`` gives the text."""
    text = emitted(preset(name))[1]
    parts = ("estimate", "yosys", "total", "sum_of_blocks", "blocks")

    def measure():
        found = resources.estimate(text, by_block=True)
        return {part: found[part] for part in parts}

    stored = BASELINES["presets"].get(name, {})
    return current(name, {part: stored[part] for part in parts if part in stored}, text, measure), text


def axi_of(name):
    """Row of the AXI top, and the text that it depends on."""
    config, stored = preset(name), BASELINES["presets"].get(name, {})
    neutral = axi_top(config)

    def measure():
        return resources.core(emit_verilog(AxiTop(config), BOARD.top), top=BOARD.top)

    return current(f"{name} axi", stored.get("axi"), neutral, measure), neutral


def core_alone(kind, name, changes):
    """Row of a preset's core, some of its fields changed; and the text."""
    text = emitted(preset(name.split(",")[0]).replace(**changes))[1]
    top = {"top": f"{TOP}_unit_0"} if name.endswith("a unit") else {}
    return current(name, BASELINES[kind].get(name), text, lambda: resources.core(text, **top)), text


def placed_of(name, seeds=SEEDS, device="LFE5U-85F", kind="placed"):
    """Clock and area of a preset, whose name the part of ``name`` before a comma is, and the text."""
    text = emitted(preset(name.split(",")[0]).replace(**PLACED[name] if kind == "placed" else {}))[1]

    def measure():
        found = place.place(text, seeds=seeds, device=device)
        row = {kind: found[kind] for kind in ("fmax_mhz", "yosys", "nextpnr", "device", "speed")}
        return row | {
            "seeds": [*found["seeds"].values()],
            **{kind: n["used"] for kind, n in found["resources"].items()},
        }

    return current(f"{name} placed", BASELINES[kind].get(name), text, measure, place), text


def main(what=None, *again):
    """What has been measured is kept at once: a run that was broken off goes on where it was.

    ``again``: only these rows of what was placed, and in any case.
    """
    if what in ("placed", "families"):
        devices = {"LFE5U-85F": PLACED} if what == "placed" else ELSEWHERE
        rows = {
            name + f", {device}" * (what == "families"): device for device, names in devices.items() for name in names
        }
        if unknown := [name for name in again if name not in rows]:
            sys.exit(f"error: {unknown[0]}: no row; the rows are {'; '.join(rows)}")
        for name in again or rows:
            if again:
                BASELINES["fingerprints"].pop(f"{name} placed", None)
            BASELINES[what][name], text = placed_of(name, device=rows[name], kind=what)
            BASELINES["fingerprints"][f"{name} placed"] = fingerprint(text, BASELINES[what][name], place)
            write(BASELINES)
        return
    presets, fingerprints = (BASELINES[part] for part in ("presets", "fingerprints"))
    for name in PRESETS:
        core, text = core_of(name)
        presets[name] = core | {"axi": presets.get(name, {}).get("axi")}
        fingerprints[name] = fingerprint(text, core)
        write(BASELINES)
        presets[name]["axi"], text = axi_of(name)
        fingerprints[f"{name} axi"] = fingerprint(text, presets[name]["axi"])
        write(BASELINES)
    for kind, cores in (("plain", PLAIN), ("motions", MOTIONS), ("regions", REGIONS)):
        for name, changes in cores.items():
            BASELINES[kind][name], text = core_alone(kind, name, changes)
            fingerprints[name] = fingerprint(text, BASELINES[kind][name])
            write(BASELINES)


def write(baselines):
    """A line a row."""
    text = re.sub(r"\{[^{}]*\}", lambda row: " ".join(row[0].split()), json.dumps(baselines, indent=1))
    PATH.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
