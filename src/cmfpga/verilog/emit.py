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
from pathlib import Path

import platformdirs
from amaranth.back import verilog
from amaranth.hdl import Fragment

from .. import __version__
from ..errors import ConfigError
from .ports import comments
from .readable import notes_of, readable

TOP = "cmfpga_core"
#: The AXI top where no board gives it a name.
AXI_TOP = "cmfpga_axi"
#: The serial top where no board gives it a name.
UART_TOP = "cmfpga_uart"


def emit_verilog(core, name=TOP):
    """The core, or a top around it, as Verilog-2001 text: one module per block, ``name`` on top.

    The other modules' names begin with that. Of the configuration only the hardware fields matter.
    """
    signals = {**core.inputs, **core.outputs}
    ports = [*signals.values()]
    # The Yosys that comes with Amaranth: another one orders and names things differently.
    with environment({"AMARANTH_USE_YOSYS": "builtin", **cache_environment("wasmtime")}), _rare_collection():
        fragment = Fragment.get(core, None)
        text = verilog.convert(fragment, name=name, ports=ports, emit_src=False, strip_internal_attrs=True)
    text = _strip_memory_contents(text)
    text = re.sub(r" *\(\* init = .*? \*\)\n", "", text)
    text = _complete_cases(text)
    text = re.sub(r"= ! ", "= ~| ", text)  # the same for any width, and what linters expect of a vector
    text = _plain_module_names(text, name)
    kinds = "|".join(sorted({kind for port in ports for kind in port.attrs}))
    text = re.sub(rf"^ *\(\* (?:{kinds}) = .*? \*\)\n", "", text, flags=re.MULTILINE) if kinds else text
    described = {
        port: (meaning, signals[port].attrs if port in signals else {}) for port, meaning in comments(core).items()
    }
    return _header(core.config, name) + "\n" + readable(text, name, described, notes_of(fragment, name))


def sha256(text):
    """Hexadecimal SHA-256 of ``text``."""
    return hashlib.sha256(text.encode()).hexdigest()


def cache_folder():
    """Where compiled simulators are kept: ``$CMFPGA_CACHE``, the user's cache, or a folder for this process alone.

    Raises :exc:`ConfigError`: ``CMFPGA_CACHE`` names a folder that cannot be written.
    """
    given = os.environ.get("CMFPGA_CACHE")
    folder = Path(given or platformdirs.user_cache_path("cmfpga"))
    refusal = _refusal(folder)
    if not refusal:
        return folder
    if given:
        what = "written" if folder.is_dir() else "made"
        why = f"cannot be {what}, for compiled simulators: {refusal}"
        raise ConfigError(f"{folder}: {why}; CMFPGA_CACHE may name another folder")
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
        # Verilator's state is that of this file alone.
        "// Operands have the widths of their signals. Verilog extends them to the result's, which holds every value:\n"
        "// verilator lint_off WIDTHEXPAND\n"
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
            lines.append(f"{indent}  default: ;")
        lines.append(line)
    return "\n".join(lines)


def _plain_module_names(text, top):
    """``\\cmfpga_core.voter `` (an escaped name) becomes ``cmfpga_core_voter``, ``\\….basis$319 `` ``…_basis``.

    The number is there because a signal of the same name is; a module and a signal may well share one.
    """
    names = {}

    def plain(match):
        new = re.sub(r"\$\d+", "", match[1]).replace(".", "_")
        if names.setdefault(new, match[1]) != match[1]:
            raise AssertionError(f"two modules {new}")
        return new + " "

    return re.sub(rf"\\({top}(?:\.[\w$]+)+) ", plain, text)
