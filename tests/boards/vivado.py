#!/usr/bin/env python3
"""A strict model of the Vivado commands that ``boards/kv260/vivado`` uses: the scripts run, nothing is implemented.

    python tests/boards/vivado.py -mode batch -source build.tcl -tclargs …

What the model does not know is an error: commands, options, IPs, parameters, pins, interfaces, properties. So is what
Vivado would refuse: two drivers, an input without one, clocks and resets that do not fit, streams of different width,
addresses that overlap or are misaligned, a port without pin. ``found`` (or the environment's VIVADO_MODEL, as JSON)
chooses what a run finds, see :data:`vivado_reports.FOUND`. Runs in Python's own Tcl; needs tkinter, no display.
"""

import json
import os
import sys
import tkinter

import vivado_bd_commands  # noqa: F401 - fills the table
import vivado_ipx_commands  # noqa: F401 - the same
import vivado_project_commands  # noqa: F401 - the same
import vivado_run_commands  # noqa: F401 - the same
from vivado_objects import VivadoError, check_usage
from vivado_reports import FOUND
from vivado_state import COMMANDS, State

#: Tcl's own commands that a script could leave the model by.
REMOVED = ("exec", "socket", "load", "cd", "after", "vwait", "unknown", "auto_execok", "tclLog")


class Vivado:
    """One Vivado process in batch mode."""

    def __init__(self, found=None):
        self.found = {**FOUND, **(found or {})}
        self.state = State(self.found)
        self.output, self.status, self.defect = [], None, None
        self.used = set()
        self.tcl = tkinter.Tcl()
        for name in REMOVED:
            self.tcl.eval(f"catch {{rename {name} {{}}}}")
        self.tcl.createcommand("model_call", self._call)
        self.tcl.eval("rename puts model_puts")
        self.tcl.eval("proc model_error {message} { return -code error $message }")
        for name in [*COMMANDS, "exit", "puts"]:
            scope = name.rpartition("::")[0]
            if scope:
                self.tcl.eval(f"namespace eval {scope} {{}}")
            self.tcl.eval(
                f"proc {name} {{args}} {{ lassign [::model_call {{{name}}} {{*}}$args] failed result;"
                " if {$failed} { return -code error $result }; return $result }"
            )

    def _call(self, name, *words):
        """Run a command; Python's errors cannot cross Tcl, so failure is data: ``(failed, result)``."""
        try:
            if self.status is not None:
                raise VivadoError("Vivado has ended")
            if name == "exit":
                self.status = int(words[0]) if words else 0
                raise VivadoError("exit")
            if name == "puts":
                return (0, self._puts(words))
            usage, command = COMMANDS[name]
            self.used.add(name)
            options, rest = check_usage(usage, words)
            return (0, self._text(command(self.state, options, *rest)))
        except VivadoError as error:
            return (1, str(error) if str(error).startswith(f"{name}:") else f"{name}: {error}")
        except Exception as error:  # a defect of the model itself; kept for source(), Tcl would swallow it
            self.defect = error
            return (1, f"the model fails: {error!r}")

    def _puts(self, words):
        if len(words) == 1:
            self.output.append(words[0])
        elif words[0] in ("stderr", "stdout"):
            self.output.append(words[-1])
        else:
            self.tcl.call("model_puts", *words)
        return ""

    def _text(self, result):
        if result is None:
            return ""
        return tuple(result) if isinstance(result, (list, tuple)) else str(result)

    def source(self, script, *arguments):
        """Run a script to its end; returns the exit status, as Vivado's batch mode gives it."""
        self.tcl.call("set", "argv", tuple(map(str, arguments)))
        self.tcl.call("set", "argc", len(arguments))
        try:
            self.tcl.call("source", str(script))
        except tkinter.TclError as error:
            if self.status is None:
                self.output.append(f"ERROR: {error}")
                self.status = 1
        if self.defect is not None:
            raise self.defect
        if self.status is None:
            self.status = 0
        return self.status


def main(words):
    if words == ["-version"]:
        print(f"Vivado v{FOUND['version']} (model)")
        return 0
    flags, arguments = {"-nojournal", "-nolog", "-notrace"}, []
    if "-tclargs" in words:
        at = words.index("-tclargs")
        words, arguments = words[:at], words[at + 1 :]
    rest = [word for word in words if word not in flags]
    if len(rest) != 4 or rest[:2] != ["-mode", "batch"] or rest[2] != "-source":
        print(f"ERROR: unknown command line: {words}", file=sys.stderr)
        return 1
    run = Vivado(json.loads(os.environ.get("VIVADO_MODEL", "{}")))
    status = run.source(rest[3], *arguments)
    print("\n".join(run.output))
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
