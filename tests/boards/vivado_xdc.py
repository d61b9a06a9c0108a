"""The strict model's reading of XDC files, in an interpreter of their own."""

import tkinter
from pathlib import Path

from vivado_objects import VivadoError, check_usage

ALLOWED = {
    "PACKAGE_PIN": None,
    "IOSTANDARD": ("LVCMOS33", "LVCMOS18"),
    "SLEW": ("SLOW", "MEDIUM", "FAST"),
    "DRIVE": ("4", "8", "12"),
    "BITSTREAM.GENERAL.COMPRESS": ("TRUE", "FALSE"),
    "BITSTREAM.CONFIG.OVERTEMPSHUTDOWN": ("ENABLE", "DISABLE"),
}


def read_constraints(path, ports, clocks=None):
    """Run an XDC. ``clocks`` collects ``{name: ns}`` where clocks may be made; None where they may not."""
    tcl = tkinter.Tcl()

    def call(name, *words):
        try:
            if name == "get_ports":
                (port,) = tcl.splitlist(words[0])
                return (0, f"port {port}") if port in ports else (1, f"no port {port}")
            if name == "current_design":
                return (0, "design")
            if name == "create_clock":
                options, (target,) = check_usage("-name= -period= port", words)
                if clocks is None:
                    raise VivadoError("the block design has this clock's constraint already")
                if not target.startswith("port ") or float(options["-period"]) <= 0:
                    raise VivadoError(f"create_clock {words}")
                clocks[options["-name"]] = float(options["-period"])
                return (0, "")
            key, value, target = words
            if key not in ALLOWED or (ALLOWED[key] and value not in ALLOWED[key]):
                raise VivadoError(f"{key} {value} is not known")
            if target.startswith("port "):
                ports[target.removeprefix("port ")][key] = value
            return (0, "")
        except (VivadoError, ValueError) as error:
            return (1, str(error))

    tcl.createcommand("model_call", call)
    for name in ("get_ports", "current_design", "create_clock", "set_property"):
        tcl.eval(
            f"proc {name} {{args}} {{ lassign [model_call {name} {{*}}$args] failed result;"
            " if {$failed} { return -code error $result }; return $result }"
        )
    try:
        tcl.call("source", str(path))
    except tkinter.TclError as error:
        raise VivadoError(f"{Path(path).name}: {error}") from None
