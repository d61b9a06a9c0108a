"""Paths of a placed netlist, from what nextpnr writes as SDF.

A path begins at what a clock drives (a register, a RAM) and ends at what a clock reads; ports do not count.
"""

import re
from collections import Counter, defaultdict
from graphlib import CycleError, TopologicalSorter

from .tools import EstimateError

_CELL = re.compile(r"\(INSTANCE (\S+)\)(.*?)(?=\(CELLTYPE|\Z)", re.DOTALL)
_LATEST = r"\([\d.]*:[\d.]*:([\d.]+)\)"  # of minimum, typical, maximum
_WIRE = re.compile(rf"\(INTERCONNECT (\S+) (\S+) {_LATEST}")
_ARC = re.compile(rf"\(IOPATH (\S+) (\S+) {_LATEST}")
_CHECK = re.compile(rf"\(SETUPHOLD \(posedge (\S+)\) \(posedge (\S+)\) {_LATEST}")
# What Yosys appends to a register's name to call the cells around it.
_GROWN = re.compile(r"_(?:TRELLIS_\w+?|CCU2C|LUT4|PFUMX|L6MUX21|MULT18X18D|DP16KD)_.*")


def worst_paths(sdf, aim_mhz):
    """The slowest path of each pair of blocks, slowest first.

    Returns
    -------
    list of dict
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
