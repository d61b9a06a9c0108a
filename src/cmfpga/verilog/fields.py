"""Where the fields of an event, the settings and a result lie in one word: as ports in order, the first lowest."""

from .emit import TOP
from .ports import plain

GROUPS = ("event", "settings", "result")


def packed(table, group):
    """``([(port, its lowest bit)], bits)`` of a group's fields, without the handshake.

    Parameters
    ----------
    table : list of Port
        :func:`~cmfpga.verilog.ports.port_table` of the core.
    group : str
        One of :data:`GROUPS`.
    """
    found, lsb = [], 0
    for port in table:
        if port.group == group and port.field not in ("valid", "ready"):
            found.append((port, lsb))
            lsb += port.bits
    return found, lsb


def header(table):
    """``cmfpga_core_fields.vh``: of each field its lowest bit and its number of bits, for inclusion in a module."""
    lines = [
        f"// Fields of {TOP} in one word: event[EVENT_T_LSB +: EVENT_T_BITS] is the time stamp. Include in a module.",
        "// SPDX-License-Identifier: BSD-2-Clause",
        "// verilator lint_off UNUSEDPARAM",
        "// No module needs all of them.",
    ]
    for group in GROUPS:
        places, bits = packed(table, group)
        lines += ["", f"localparam {group.upper()}_BITS = {bits};"]
        for port, lsb in places:
            name, sign = port.name.upper(), "signed; " if port.signed else ""
            lines.append(f"localparam {name}_LSB = {lsb}, {name}_BITS = {port.bits};  // {sign}{plain(port.meaning)}")
    return "\n".join([*lines, "// verilator lint_on UNUSEDPARAM"]) + "\n"
