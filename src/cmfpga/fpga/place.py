"""Clock frequency and area of the emitted Verilog by an open flow: Yosys and nextpnr from PyPI.

Out of context: no pads, and a path from or to a port does not count. ``-no-rw-check`` is right here, because no bank
depends on what a RAM returns in a collision: that is proved (docs/verification.md).
"""

import json
import statistics
import tempfile
from pathlib import Path

from ..verilog.emit import TOP, sha256
from .families import ECP5, FAMILIES
from .floorplan import lay
from .levels import worst_paths
from .tools import COMMANDS, EstimateError, read_json, require, run, yosys

LABEL = "yosys and nextpnr, out of context; never run on a device"

#: What the tools aim for where no clock is asked for, MHz.
AIM_MHZ = 200


def require_tools(device="LFE5U-85F", speed=None, target=None):
    """The versions of Yosys and nextpnr, by name; an error that says what to install, or what cannot be asked for."""
    family = FAMILIES[device]
    _, speeds = family.devices[device]
    if speed and speed not in speeds:
        raise EstimateError(f"--speed {speed}: {device} has {', '.join(map(str, speeds))}")
    if target and family.untimed:
        raise EstimateError(f"--target: {device} has only a bound, for nextpnr has no delays of its {family.untimed}")
    packages = {"yosys": "yosys", "nextpnr": family.nextpnr}
    return {name: require(COMMANDS[tool][0], family.extra, "place and route") for name, tool in packages.items()}


def place(verilog, *, device="LFE5U-85F", speed=None, seeds=1, aim_mhz=AIM_MHZ, top=TOP, report=lambda doing: None):
    """Place and route the module ``top`` of emitted Verilog. A quarter of a minute, and one to two for each seed.

    ``device`` is one of :data:`~cmfpga.fpga.families.FAMILIES`, ``speed`` one of its grades, by default the fastest.
    Placements from the random numbers 1 … ``seeds`` differ by up to 11 %. The tools try to reach ``aim_mhz``, MHz.

    Of the dictionary, which is JSON-ready, ``fmax_mhz``: the median of those of the ``seeds``. ``resources``: ``used``
    and ``available`` of each of the family's. ``paths``: :func:`~cmfpga.fpga.levels.worst_paths` of the worst seed.
    """
    versions = require_tools(device, speed)
    family = FAMILIES[device]
    called, speeds = family.devices[device]
    speed = speed or speeds[0]
    netlist = netlist_of(verilog, top, report, family)
    lay(netlist["modules"][top], device)
    fmax, worst = {}, None
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "core.json").write_text(json.dumps(netlist), encoding="utf-8")
        for seed in map(str, range(1, seeds + 1)):
            options = [*called.format(speed=speed).split(), "--freq", f"{aim_mhz:g}", "--seed", seed]
            fmax[seed], resources = _placed(Path(folder), family, options, f"nextpnr: seed {seed} of {seeds}", report)
            if fmax[seed] == min(fmax.values()):
                worst = (Path(folder) / "core.sdf").read_text(encoding="utf-8")
    return {
        "placed": LABEL, **versions, "device": device, "speed": speed, "aim_mhz": aim_mhz, "top": top,
        "verilog_sha256": sha256(verilog), "fmax_mhz": round(statistics.median(fmax.values()), 1), "seeds": fmax,
        "resources": resources, "paths": worst_paths(worst, aim_mhz),
    }  # fmt: skip


def netlist_of(verilog, top=TOP, report=lambda doing: None, family=ECP5):
    """What is placed: Yosys's netlist (its JSON), changed as the family needs it."""
    script = f"read_verilog core.v\n{family.synthesis.format(top=top)}\nwrite_json 0.json\n"
    (netlist,) = yosys(script, verilog, [f"yosys: synthesis for {family.title}"], report)
    family.prepare(netlist["modules"][top])
    return netlist


def _placed(folder, family, options, doing, report):
    """Clock in MHz and resources of one placement, which leaves ``core.sdf``."""
    arguments = ["--json", "core.json", *options, *family.options, "--timing-allow-fail"]
    arguments += ["--report", "report.json", "--sdf", "core.sdf", "-q"]
    run(family.nextpnr, arguments, folder, [doing], [], report)
    found = read_json(folder / "report.json", "nextpnr", "report")
    try:
        (clock,) = found["fmax"].values()
        used = {name: found["utilization"][cell] for name, (cell, _) in family.resources.items()}
        return round(clock["achieved"], 1), used
    except (AttributeError, LookupError, TypeError, ValueError):
        raise EstimateError("the report of nextpnr has not one clock and the resources") from None


def text(placed, paths=12):
    """For a terminal: clock, resources, and the slowest ``paths`` of two blocks."""
    seeds, used, family = placed["seeds"], placed["resources"], FAMILIES[placed["device"]]
    beyond = f"beyond {placed['aim_mhz']:g} MHz"
    lines = [
        f"Placed ({placed['placed']}; Yosys {placed['yosys']}, nextpnr {placed['nextpnr']})",
        f"{placed['top']} on {placed['device']}, speed {placed['speed']}: {placed['fmax_mhz']:g} MHz, the median of "
        + ", ".join(f"{mhz:g} (seed {seed})" for seed, mhz in seeds.items())
        + f"; only a bound, without delays of {family.untimed}" * bool(family.untimed),
        listed(used, family),
        f"   ns  logic  stages  {beyond}  slowest path of each two blocks, seed {min(seeds, key=seeds.get)}",
    ]
    for path in placed["paths"][:paths]:
        head = f"{path['ns']:5.1f}  {path['logic_ns']:5.1f}  {path['stages']:6}  {path['late']:{len(beyond)}}"
        lines.append(f"{head}  {path['from']} → {path['to']}")
    return "\n".join(lines)


def listed(used, family):
    """The resources of a :func:`place`, for a terminal."""
    return ", ".join(
        f"{used[name]['used']:,} of {used[name]['available']:,} {kind}" for name, (_, kind) in family.resources.items()
    )
