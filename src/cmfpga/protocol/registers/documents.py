"""Documents of the register map: SystemRDL, Markdown, Tcl, C header; from the SystemRDL, by PeakRDL, HTML and IP-XACT.

PeakRDL (https://peakrdl.readthedocs.io) is optional: ``pip install 'cmfpga[registers]'``.
"""

import importlib.util

from ... import __version__
from ...errors import write_text
from .layout import ACCESS

#: What PeakRDL writes: file or folder, and what it is.
BY_PEAKRDL = {"registers.xml": "IP-XACT (IEEE 1685-2009)", "registers-html/index.html": "HTML"}

# Of IP-XACT, as Vivado's `ipx` commands take it.
_IPX_ACCESS = {"constant": "read-only", "status": "read-only", "written": "write-only", "command": "write-only"}

_RDL_ACCESS = {
    "constant": "sw = r; hw = na;",
    "status": "sw = r; hw = w;",
    "stored": "sw = rw; hw = r;",
    "written": "sw = w; hw = r;",
    "flag": "sw = rw; hw = rw;",
    "sticky": "sw = rw; onwrite = woclr; hw = w;",
    "command": "sw = w; hw = r; singlepulse;",
}


def systemrdl(registers, title):
    """The map as SystemRDL 2.0 text, an ``addrmap`` called ``cmfpga``."""
    lines = [f"// {title}", ""]
    for register, f in ((one, f) for one in registers for f in one.fields if f.values):
        lines.append(f"enum {_enum(register, f)} {{")
        lines += [f"    {name} = {f.width}'d{value};" for name, value in f.values.items()]
        lines += ["};", ""]
    lines += ["addrmap cmfpga {", f"    name = {_quoted('cmfpga')};", f"    desc = {_quoted(title)};"]
    lines += ["    default regwidth = 32;", "    default accesswidth = 32;"]
    for register in registers:
        lines += ["    reg {", f"        name = {_quoted(register.name)};", f"        desc = {_quoted(register.doc)};"]
        for f in register.fields:
            says = [f"desc = {_quoted(_meaning(f))};", _RDL_ACCESS[f.access]]
            says += [f"encode = {_enum(register, f)};"] if f.values else []
            if f.access != "status":  # which has no value of its own
                says.append(f"reset = {f.width}'h{f.reset & ((1 << f.width) - 1):x};")
            lines += ["        field {", *(f"            {line}" for line in says)]
            lines.append(f"        }} {f.name}[{f.lsb + f.width - 1}:{f.lsb}];")
        count = f"[{register.count}]" if register.count > 1 else ""
        lines.append(f"    }} {register.name}{count} @ {register.offset:#x};")
    return "\n".join([*lines, "};"]) + "\n"


def _quoted(text):
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _enum(register, f):
    return f"{register.name}_{f.name}_t".lower()


def _meaning(f):
    """A field's line, with unit and range."""
    span = f"; {f.low or 0} to {f.high}" if f.high is not None and f.writable else ""
    return f.doc + " (two's complement)" * f.signed + (f" [{f.unit}]" if f.unit else "") + span


def markdown(registers):
    """The map as tables, one for each group."""
    lines, group, used = [], None, {f.access for register in registers for f in register.fields}
    for register in registers:
        if register.group != group:
            group = register.group
            lines += ["", f"### {group}", "", "| offset | register | bits | field | access | reset | meaning |"]
            lines.append("| ---: | --- | ---: | --- | --- | ---: | --- |")
        offset, name = f"`{register.offset:#05x}`", f"`{register.name}`"
        if register.count > 1:
            name += f" × {register.count}"
        for f in register.fields:
            bits = f"{f.lsb + f.width - 1}:{f.lsb}" if f.width > 1 else f"{f.lsb}"
            reset = f"{f.reset:#x}" if f.reset > 9 else f"{f.reset}"
            reset = "" if f.access in ("status", "command", "written") else reset
            meaning = _meaning(f)
            if f.values:
                meaning += ": " + ", ".join(f"{value} = {key}" for key, value in f.values.items())
            lines.append(f"| {offset} | {name} | {bits} | `{f.name}` | {f.access} | {reset} | {meaning} |")
            offset = name = ""
    lines += ["", "| access | meaning |", "| --- | --- |"]
    lines += [f"| {name} | {doc} |" for name, doc in ACCESS.items() if name in used]
    return "\n".join(lines).strip() + "\n"


def tcl(registers):
    """The map for Vivado's IP packager: a procedure ``cmfpga_registers ADDRESS_BLOCK`` that adds registers and fields.

    A register that stands several times is added as often, with its number. Commands and properties: AMD UG835, `ipx`.
    """
    lines = ["proc cmfpga_registers {address_block} {"]
    for register in registers:
        for number in range(register.count):
            name = f"{register.name}_{number}" if register.count > 1 else register.name
            reset = sum((f.reset << f.lsb) & f.mask for f in register.fields)
            access = {_IPX_ACCESS.get(f.access, "read-write") for f in register.fields}
            lines += _ipx("register", name, "address_block", {
                "address_offset": f"0x{register.offset + 4 * number:X}", "size": 32,
                "access": access.pop() if len(access) == 1 else "read-write",
                "description": _braced(register.doc), "reset_value": f"0x{reset:X}",
            })  # fmt: skip
            for f in register.fields:
                lines += _ipx("field", f.name, "register", {
                    "bit_offset": f.lsb, "bit_width": f.width, "access": _IPX_ACCESS.get(f.access, "read-write"),
                    "description": _braced(_meaning(f)),
                    **({"modified_write_value": "oneToClear"} if f.access == "sticky" else {}),
                })  # fmt: skip
    return "\n".join([*lines, "}"]) + "\n"


def _ipx(kind, name, parent, properties):
    add = f"    set {kind} [ipx::add_{kind} {name} ${parent}]"
    return [add, *(f"    set_property {one} {value} ${kind}" for one, value in properties.items())]


def c_header(registers, settings=()):
    """The map as a C header: offsets, and of each field its lowest bit, its mask in place, what it is, or may be.

    ``settings``, ``[(offset, word)]``, are what CMFPGA_SETTINGS lists: initializers of a batch's settings.
    """
    lines = ["#ifndef CMFPGA_REGISTERS_H", "#define CMFPGA_REGISTERS_H"]
    for register in registers:
        name = f"CMFPGA_{register.name}"
        count = f", {register.count} of them" if register.count > 1 else ""
        lines += ["", f"/* {register.doc}{count} */", f"#define {name} {register.offset:#x}u"]
        for f in register.fields:
            values = {"VALUE": f.reset & f.mask >> f.lsb} if f.access == "constant" else f.values
            lines.append(f"#define {name}__{f.name}_LSB {f.lsb}")
            lines.append(f"#define {name}__{f.name}_MASK {f.mask:#x}u /* {_meaning(f)} */")
            lines += [f"#define {name}__{f.name}_{key} {value:#x}u" for key, value in values.items()]
    if pairs := ", \\\n    ".join(f"{{{offset:#x}u, {word:#x}u}}" for offset, word in settings):
        lines += ["", "/* {offset, word} of each setting of a batch */", f"#define CMFPGA_SETTINGS \\\n    {pairs}"]
    return "\n".join([*lines, "", "#endif"]) + "\n"


def _braced(text):
    """A word of Tcl in which nothing is substituted."""
    if set(text) & set("{}\\"):
        raise ValueError(f"{text!r}: no braces or backslashes can be in it")
    return "{" + text + "}"


def has_peakrdl():
    """Whether the optional extra is installed."""
    return all(map(importlib.util.find_spec, ("systemrdl", "peakrdl_html", "peakrdl_ipxact")))


def write_documents(registers, title, folder, settings=()):
    """Paths of the documents written: of our own, and, with PeakRDL, of :data:`BY_PEAKRDL`."""
    texts = {
        "registers.rdl": systemrdl(registers, title),
        "registers.md": f"# Registers\n\n{title}\n\n{markdown(registers)}",
        "regs.tcl": f"# {title}\n\n{tcl(registers)}",
        "cmfpga_registers.h": f"/* {title} */\n{c_header(registers, settings)}",
    }
    for name, text in texts.items():
        write_text(folder / name, text)
    if has_peakrdl():
        _by_peakrdl(folder / "registers.rdl", folder)
    return [folder / name for name in (*texts, *(BY_PEAKRDL if has_peakrdl() else ()))]


def _by_peakrdl(rdl, folder):
    from peakrdl_html import HTMLExporter
    from peakrdl_ipxact import IPXACTExporter, Standard
    from systemrdl import RDLCompiler

    compiler = RDLCompiler()
    compiler.compile_file(str(rdl))
    top = compiler.elaborate().top
    ipxact, html = (folder / name for name in BY_PEAKRDL)
    names = {"vendor": "cmfpga.org", "library": "ip", "version": __version__}
    IPXACTExporter(**names, standard=Standard.IEEE_1685_2009).export(top, str(ipxact))
    HTMLExporter().export(top, str(html.parent), skip_not_present=False)
