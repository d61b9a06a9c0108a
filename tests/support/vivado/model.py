#!/usr/bin/env python3
"""Runs the Vivado scripts in Tcl, strictly: every command is checked against ``catalog.py`` and recorded.

    python -m support.vivado.model -mode batch -source build.tcl -tclargs …

What the catalogue does not allow is an error; so is what :class:`design.Design` refuses. ``found`` (or the
environment's VIVADO_MODEL, as JSON) chooses what a run finds, see :data:`FOUND`. Needs tkinter.
"""

import fnmatch
import json
import os
import re
import sys
import tkinter

from support.vivado.catalog import AFTER, CHANGES, COMMANDS, IPS, PROPERTIES
from support.vivado.commands import ACTIONS
from support.vivado.design import Design, VivadoError, write

#: What a run finds, unless a test says otherwise, and reports as Vivado lays them out. No figures of the design.
FOUND = {
    "version": "2022.2", "boards": ["xilinx.com:kv260_som:part0:1.4"], "inline_slice": False,
    "synth_status": "synth_design Complete!", "impl_status": "write_bitstream Complete!", "wns": "0.120",
    "whs": "0.010", "wpws": "1.500", "unclocked": 0, "crossing": "Timed", "cdc": "Safe", "unit": "(ns)",
}  # fmt: skip

SLACKS = [("WNS", "TNS", "{wns}"), ("WHS", "THS", "{whs}"), ("WPWS", "TPWS", "{wpws}")]
ROWS = (
    [t for worst, total, _ in SLACKS for t in (f"{worst}{{unit}}", f"{total}{{unit}}", f"{total} Failing Endpoints",
                                               f"{total} Total Endpoints")],
    ["-------"] * 12, [t for *_, slack in SLACKS for t in (slack, "0.000", "0", "16519")],
)  # fmt: skip
RESOURCES = {"CLB LUTs*": 12345, "CLB Registers": 9876, "Block RAM Tile": 10.5, "URAM": 0, "DSPs": 33}
TEXTS = {
    "report_timing_summary": "1. checking no_clock ({unclocked})\n\n| Design Timing Summary\n-----------\n\n"
    + "".join("    " + "  ".join(row) + "  \n" for row in ROWS) + "\n\n",
    "report_utilization": "|          Site Type         |  Used | Fixed | Prohibited | Available | Util% |\n"
    + "".join(f"| {name:<26} | {n:>5} |     0 |          0 |    234240 |  1.00 |\n" for name, n in RESOURCES.items()),
    "report_power": "| Total On-Chip Power (W)  | 3.412        |\n| Dynamic (W)              | 2.9          |\n",
    "report_clock_interaction": "clk_pl_0  clk_pl_0  Clean  {crossing}\n",
    "report_cdc": "CDC-1  {cdc}  1-bit unknown CDC circuitry\n",
}  # fmt: skip

#: Tcl's own commands that a script could leave the catalogue by.
REMOVED = ("exec", "socket", "load", "cd", "after", "vwait", "unknown", "auto_execok", "tclLog")


class Vivado(Design):
    """One Vivado process in batch mode. Tcl sees an object as ``kind:name``; ``things`` has its properties."""

    def __init__(self, found=None):
        self.found = {**FOUND, **(found or {})}
        gone = "xilinx.com:ip:xlslice:1.0" if self.found["inline_slice"] else "xilinx.com:inline_hdl:ilslice:1.0"
        super().__init__({vlnv: ip for vlnv, ip in IPS.items() if vlnv != gone})
        self.output, self.status, self.defect, self.used, self.done = [], None, None, set(), set()
        self.things, self.files, self.clocks = {}, {"sources_1": [], "constrs_1": []}, {}
        self.tcl = tkinter.Tcl()
        self.tcl.eval("".join(f"catch {{rename {name} {{}}}};" for name in REMOVED))
        self.tcl.eval("rename puts tcl_puts; namespace eval ipx {}")
        self.tcl.createcommand("model_call", self._call)
        for name in [*COMMANDS, "exit", "puts"]:
            self.tcl.eval(
                f"proc {name} {{args}} {{ lassign [::model_call {name} {{*}}$args] failed result;"
                " if {$failed} { return -code error $result }; return $result }"
            )

    def _call(self, name, *words):
        """Run a command; Python's errors cannot cross Tcl, so failure is data: ``(failed, result)``."""
        try:
            if self.status is not None:
                raise VivadoError("Vivado has ended")
            if name == "exit":
                self.status = int(words[0])
                raise VivadoError("exit")
            if name == "puts":
                return (0, self.tcl.call("tcl_puts", *words) if len(words) > 1 else self.output.append(words[0]) or "")
            self.used.add(name)
            usage, _, kind = COMMANDS[name].partition("=> ")
            options, rest = self.check(usage, words)
            self.used |= {f"{name} {option}" for option in options}
            self.need("report" if name.startswith("report_") else name)
            action = ACTIONS.get(name) or getattr(Vivado, name, None)
            result = action(self, options, *rest) if action else ""
            if ("-file" in options) == ("-return_string" in options) and name in TEXTS:
                raise VivadoError("-file or -return_string")
            if "-return_string" in options:
                result = TEXTS[name].format(**self.found)
            elif "-file" in options:
                write(options["-file"])
            elif kind:
                result = self.get(kind, options, *rest)
            self.do(name)
            return (0, "" if result is None else result)
        except VivadoError as error:
            return (1, f"{name}: {error}")
        except Exception as error:  # a defect of the model itself; kept for source(), Tcl would swallow it
            self.defect = error
            return (1, f"the model fails: {error!r}")

    def source(self, script, *arguments):
        """Run a script to its end; returns the exit status, as Vivado's batch mode gives it."""
        self.tcl.call("set", "argv", tuple(map(str, arguments)))
        try:
            self.tcl.call("source", str(script))
        except tkinter.TclError as error:
            if self.status is None:
                self.output.append(f"ERROR: {error}")
                self.status = 1
        if self.defect is not None:
            raise self.defect
        self.status = self.status or 0
        return self.status

    def need(self, name):
        if missing := [step for step in AFTER.get(name, "").split() if not self.done & set(step.split("|"))]:
            raise VivadoError(f"{' and '.join(missing)} comes first")

    def do(self, name):
        self.done -= {"validate_bd_design", "save_bd_design"} if name in CHANGES else set()
        self.done.add(name)

    def check(self, usage, words):
        """``({option: value}, [positional words])``, or an error if the usage does not allow them."""
        tokens = [re.fullmatch(r"(!?)(-\w+)?(=?)(.*)", token).groups() for token in usage.split()]
        allowed = {option: (takes, pattern) for _, option, takes, pattern in tokens if option}
        names = [(takes, pattern) for _, option, takes, pattern in tokens if not option]
        options, rest, words = {}, [], list(words)
        while words:
            word = words.pop(0)
            if not re.match(r"-[a-zA-Z]", word):
                rest.append(word)
            elif word not in allowed or (allowed[word][0] and not words):
                raise VivadoError(f"unknown option {word}, or one without value")
            else:
                options[word] = self.value(*allowed[word], words.pop(0)) if allowed[word][0] else True
        if missing := {option for required, option, *_ in tokens if required} - set(options):
            raise VivadoError(f"options missing: {sorted(missing)}")
        if names and names[-1][1].endswith("..."):
            names[-1:] = [(names[-1][0], names[-1][1][:-3])] * (len(rest) - len(names) + 1)
        if len(names) != len(rest):
            raise VivadoError(f"expected {usage!r}, got {rest}")
        return options, [self.value(*name, word) for name, word in zip(names, rest, strict=True)]

    def value(self, takes, allowed, text):
        if allowed.startswith("<"):
            return self.objects(text, allowed[1:-1].split("|"), 1)[0].partition(":")[2]
        if takes and allowed and not re.fullmatch(allowed, text):
            raise VivadoError(f"cannot be {text!r}, only {allowed}")
        return text

    def objects(self, text, kinds, count=None):
        found = self.tcl.splitlist(text)
        good = [thing for thing in found if thing in self.things and thing.partition(":")[0] in kinds]
        if not good or len(found) != (count or len(good)):
            raise VivadoError(f"expected {count or 'some'} {' or '.join(kinds)}, by a get_… command, got {found}")
        return found

    def add(self, kind, name="", **properties):
        return self.things.setdefault(f"{kind}:{name}", properties)

    def names(self, kind):
        """Of the objects of a kind; what the cells have becomes one when it is asked for."""
        parts = ("axi", "axis") if kind == "intf_pin" else (kind,)
        return [name for part in parts for name in self.has.get(part, ())] or [
            thing.partition(":")[2] for thing in self.things if thing.startswith(f"{kind}:")
        ]

    def get(self, kind, options, pattern="", owner=""):
        """What a command of the catalogue returns: handles."""
        plain = kind.strip("+:?")
        if "+" in kind:
            names = [f"{owner}.{pattern}" if plain == "field" else pattern]
            if f"{plain}:{names[0]}" in self.things:
                raise VivadoError(f"there is a {plain} {names[0]} already")
        else:
            pattern = f"{options['-of_objects']}.{pattern}" if plain == "parameter" else pattern
            names = [name for name in self.names(plain) if fnmatch.fnmatchcase(name, pattern)]
        if not names and "?" not in kind:
            raise VivadoError(f"no {plain} matches {pattern!r}")
        for name in names:
            self.add(plain, name)
        return tuple(f"{plain}:{name}" for name in names)

    def set_property(self, options, *words):
        *pairs, objects = (*self.tcl.splitlist(options.get("-dict", "")), *words)
        if len(words) != (1 if "-dict" in options else 3) or len(pairs) % 2:
            raise VivadoError("expected name, value, objects or -dict pairs, objects")
        settings = dict(zip(pairs[::2], pairs[1::2], strict=True))
        for thing in self.objects(objects, ("cell", *PROPERTIES)):
            kind, _, name = thing.partition(":")
            for key, value in settings.items():
                self.need("PSU" if "PSU__" in key else key)
                self.do("CONFIG" if kind == "cell" else key)
                if kind != "cell" and not re.fullmatch(PROPERTIES[kind].get(key, "(?!)"), value):
                    raise VivadoError(f"{thing} has no property {key}, or it cannot be {value!r}")
                if key == "board_part" and value not in self.found["boards"]:
                    raise VivadoError(f"board part {value!r} is not installed")
            if kind == "cell":
                self.configure(name, settings)
            self.things[thing] |= settings

    def get_property(self, _, name, thing):
        (thing,) = self.objects(thing, ("run", "interface", "parameter"), 1)
        if name not in self.things[thing]:
            raise VivadoError(f"no property {name}; there are {', '.join(self.things[thing])}")
        return self.things[thing][name]


def main(words):
    words = [word for word in words if word not in ("-nojournal", "-nolog", "-notrace")]
    if words[:3] != ["-mode", "batch", "-source"] or words[4:5] != ["-tclargs"]:
        print(f"ERROR: unknown command line: {words}", file=sys.stderr)
        return 1
    run = Vivado(json.loads(os.environ.get("VIVADO_MODEL", "{}")))
    status = run.source(words[3], *words[5:])
    print("\n".join(run.output))
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
