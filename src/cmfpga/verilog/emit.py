"""Verilog of the core, or of a top around it: the same bytes for the same configuration, version and Yosys."""

import hashlib
import os
import re
import textwrap

from amaranth.back import verilog

from .. import __version__

TOP = "cmfpga_core"
AXI_TOP = "cmfpga_kv260"


def emit_verilog(core, name=TOP):
    """The core, or a top around it, as Verilog-2001 text: one module per block, ``name`` on top.

    Parameters
    ----------
    core : VerilogCore or KV260Top
        Only the hardware fields of its configuration matter.
    name : str
        Of the top module; the names of the others begin with it.
    """
    # The Yosys that comes with Amaranth: another one orders and names things differently.
    os.environ["AMARANTH_USE_YOSYS"] = "builtin"
    ports = [*core.inputs.values(), *core.outputs.values()]
    text = verilog.convert(core, name=name, ports=ports, emit_src=False, strip_internal_attrs=True)
    text = _strip_memory_contents(text)
    text = re.sub(r" *\(\* init = .*? \*\)\n", "", text)
    text = _separate_initial_values(text)
    text = _complete_cases(text)
    text = re.sub(r"= ! ", "= ~| ", text)  # the same for any width, and what linters expect of a vector
    text = _plain_module_names(text, name)
    text = _place_attributes(text, name, core)
    text = _order_ports(text, name, core.port_order)
    return _header(core.config, name) + text.partition("\n")[2]


def sha256(text):
    """Hexadecimal SHA-256 of ``text``."""
    return hashlib.sha256(text.encode()).hexdigest()


def _header(config, name):
    return (
        f"// {name}: Contrast Maximization for event cameras, emitted by cmfpga {__version__}.\n"
        f"// Configuration {config.hardware_hash[:16]}; its fields are in build-info.json.\n"
        "// SPDX-License-Identifier: BSD-2-Clause\n"
    )


def _strip_memory_contents(text):
    """Drop the word-by-word initial contents, which must be all zero.

    No RAM needs any (the core sweeps its banks after every reset), an UltraRAM cannot have any, and they are
    most of the text.
    """

    def check(match):
        if re.search(r"'h0*[1-9a-f]", match[0]):
            raise AssertionError("a memory has initial contents that are not zero")
        return ""

    return re.sub(r"  initial begin\n(?:    \S+ ?\[\d+\] = \S+;\n)+  end\n", check, text)


def _separate_initial_values(text):
    """``reg x = 0;`` becomes ``reg x; initial x = 0;``.

    An ``initial`` statement is an event at time 0, which starts the ``always @*`` blocks in every simulator and
    language version; a declaration's value is not one in SystemVerilog.
    """
    return re.sub(
        r"^  (reg (?:\[\d+:0\] )?)(\S+ ?) = (\S+);$", r"  \1\2;\n  initial \2 = \3;", text, flags=re.MULTILINE
    )


def _complete_cases(text):
    """Give every ``casez`` a default, which does nothing: what the statement means without it."""
    lines, has_default = [], []
    for line in text.split("\n"):
        word = line.strip()
        if word.startswith("casez "):
            has_default.append(False)
        elif word == "default:":
            has_default[-1] = True
        elif word == "endcase" and not has_default.pop():
            indent = line[: len(line) - len(word)]
            lines += [f"{indent}  default:", f"{indent}      /* empty */;"]
        lines.append(line)
    return "\n".join(lines)


def _plain_module_names(text, top):
    """``\\cmfpga_core.voter `` (an escaped name) becomes ``cmfpga_core_voter``."""
    return re.sub(rf"\\({top}(?:\.\w+)+) ", lambda match: match[1].replace(".", "_") + " ", text)


def _place_attributes(text, name, core):
    """Give each port of the top its own attributes, and take them from everything else.

    Yosys merges signals that one constant or one driver feeds, and then writes the attributes of one of them to all:
    an interface would have one port twice and miss another.
    """
    ports = {**core.inputs, **core.outputs}
    kinds = sorted({kind for port in ports.values() for kind in port.attrs})
    if not kinds:
        return text
    text = re.sub(rf"^ *\(\* (?:{'|'.join(kinds)}) = .*? \*\)\n", "", text, flags=re.MULTILINE)
    start = re.search(rf"^module {name}\(", text, re.MULTILINE).start()
    end = text.index("\nendmodule\n", start)

    def declaration(match):
        attributes = ports[match[2]].attrs
        return "".join(f'  (* {kind} = "{value}" *)\n' for kind, value in attributes.items()) + match[0]

    declared = r"^  (?:input|output) (signed )?(?:\[\d+:0\] )?(\w+) ?;$"
    body = re.sub(declared, declaration, text[start:end], flags=re.MULTILINE)
    return text[:start] + body + text[end:]


def _order_ports(text, top, order):
    """List the top module's ports in the order of the diagram, clock and reset first."""
    head = re.search(rf"^module {top}\((.*?)\);", text, re.DOTALL | re.MULTILINE)
    names = re.findall(r"\w+", head[1])
    if sorted(names) != sorted(order):
        raise AssertionError(f"ports of {top}: {set(names) ^ set(order)}")
    wrapped = textwrap.fill(", ".join(order), 118, initial_indent="  ", subsequent_indent="  ")
    return text[: head.start()] + f"module {top}(\n{wrapped}\n);" + text[head.end() :]
