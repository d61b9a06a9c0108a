"""Verilog of the core, or of a top around it: the same bytes for the same configuration, version and Yosys.

Also the folder where what is compiled, from it or for it, is kept.
"""

import atexit
import contextlib
import functools
import gc
import hashlib
import logging
import os
import re
import shutil
import tempfile
import textwrap
from pathlib import Path

import platformdirs
from amaranth.back import verilog

from .. import __version__
from ..errors import ConfigError

TOP = "cmfpga_core"
#: The AXI top where no board gives it a name.
AXI_TOP = "cmfpga_axi"
#: The serial top where no board gives it a name.
UART_TOP = "cmfpga_uart"


def emit_verilog(core, name=TOP):
    """The core, or a top around it, as Verilog-2001 text: one module per block, ``name`` on top.

    Parameters
    ----------
    core : VerilogCore, AxiTop or UartTop
        Only the hardware fields of its configuration matter.
    name : str
        Of the top module; the names of the others begin with it.
    """
    ports = [*core.inputs.values(), *core.outputs.values()]
    # The Yosys that comes with Amaranth: another one orders and names things differently.
    with environment({"AMARANTH_USE_YOSYS": "builtin", **cache_environment("wasmtime")}), _rare_collection():
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


def cache_folder():
    """Where compiled simulators are kept: ``$CMFPGA_CACHE``, the user's cache, or a folder for this process alone.

    Raises
    ------
    ConfigError
        ``CMFPGA_CACHE`` names a folder that cannot be written.
    """
    given = os.environ.get("CMFPGA_CACHE")
    folder = Path(given or platformdirs.user_cache_path("cmfpga"))
    refusal = _refusal(folder)
    if not refusal:
        return folder
    if given:
        what = "written" if folder.is_dir() else "made"
        raise ConfigError(
            f"{folder}: cannot be {what}, for compiled simulators: {refusal}; CMFPGA_CACHE may name another folder"
        )
    return _temporary_folder(folder)


def cache_environment(name):
    """What a process must have in its environment so that the tool ``name`` in it finds a cache; most often nothing.

    wasmtime, which runs Yosys, fails where the user's cache cannot be written.
    """
    if not _refusal(platformdirs.user_cache_path(name)):
        return {}
    return {"XDG_CACHE_HOME": str(cache_folder().absolute())}


def _refusal(folder):
    """Why nothing can be written into ``folder``, which is made if it is not there; None if it can."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return None
    except OSError as error:
        return error.strerror


@functools.cache
def _temporary_folder(instead_of):
    folder = Path(tempfile.mkdtemp(prefix="cmfpga-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    logging.getLogger(__name__).warning(  # without any set-up of logging, the line as it is, on stderr
        f"note: {instead_of} cannot be written: what is compiled is kept in {folder} until this process ends; "
        "CMFPGA_CACHE may name a folder that stays"
    )
    return folder


@contextlib.contextmanager
def _rare_collection():
    """A design is very many objects that stay: to look for garbage among them takes as long as making them."""
    before = gc.get_threshold()
    gc.set_threshold(50_000, 20, 10)
    try:
        yield
    finally:
        gc.set_threshold(*before)


@contextlib.contextmanager
def environment(changes):
    """The process's environment with these variables."""
    before = {name: os.environ[name] for name in changes if name in os.environ}
    os.environ.update(changes)
    try:
        yield
    finally:
        for name in changes.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)


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
