"""Builds the emitted AXI top for a simulator and runs modules of cocotb tests on it."""

import contextlib
import importlib.metadata
import json
import shutil
from xml.etree import ElementTree

import pytest

from cmfpga.rtl.axi.top import AxiTop
from cmfpga.verilog import compile
from cmfpga.verilog.compiler import find_compiler, require_compiler
from cmfpga.verilog.emit import AXI_TOP, sha256

#: What cocotb's main program needs of Verilator.
RUNTIME = ("verilated", "verilated_threads", "verilated_dpi", "verilated_vpi")


def require(simulator):
    """Skip where something is missing that neither PyPI nor this repository brings."""
    pytest.importorskip("cocotbext.axi", reason="cocotbext-axi is not installed (pip install cocotb cocotbext-axi)")
    found = {"icarus": shutil.which("iverilog") and shutil.which("vvp"), "verilator": find_compiler()}
    if not found[simulator]:
        pytest.skip(f"not installed: Debian package {({'icarus': 'iverilog', 'verilator': 'g++'})[simulator]}")


def _verilated(verilog, ports):
    """The program of the Verilog in Verilator, compiled unless the cache has it.

    cocotb's own way makes every signal public, which takes minutes to compile and hours to run; ports are enough.
    """
    from cocotb_tools import config as cocotb

    main = f'#define Vtop Vcore\n#include "{cocotb.share_dir}/lib/verilator/verilator.cpp"\n'
    public = "".join(f'public_flat_rw -module "{AXI_TOP}" -var "{name}"\n' for name in ports)
    compiler, version = require_compiler()

    def build(scratch, made):
        texts = {f"{AXI_TOP}.v": verilog, "ports.vlt": f"`verilator_config\n{public}", "harness.cpp": main}
        for name, text in {**texts, "Vtop.h": '#include "Vcore.h"\n'}.items():
            (scratch / name).write_text(text)
        compile._verilate(scratch, AXI_TOP, "--vpi", "--timescale", "1ns/1ps", scratch / "ports.vlt")
        links = f"-L{cocotb.libs_dir}", f"-Wl,-rpath,{cocotb.libs_dir}", "-lcocotbvpi_verilator"
        compile._compile(compiler, version, scratch, made, *links, runtime=RUNTIME)

    tools = [version, *(importlib.metadata.version(package) for package in ("verilator", "cocotb"))]
    return compile.kept_file(f"cocotb-{sha256(' '.join([verilog, main, public, *tools]))[:24]}.exe", build)


def simulate(simulator, config, tests, folder):
    """Run tests, ``{module: names}``, of a configuration's AXI top: ``{name: what was wrong, or None}``, and the log.

    ``simulator`` is ``icarus`` or ``verilator``; ``folder`` gets what is built.
    """
    from cocotb_tools.runner import get_runner

    top, verilated = AxiTop(config), simulator == "verilator"
    text, runner = compile.kept_verilog(top, AXI_TOP), get_runner(simulator)
    log, results, verilog = folder / "tests.log", folder / "tests.xml", folder / f"{AXI_TOP}.v"
    if verilated:
        (folder / AXI_TOP).symlink_to(_verilated(text, top.port_order))
    else:
        verilog.write_text(text)
        runner.build(
            sources=[verilog], hdl_toplevel=AXI_TOP, build_args=["-g2005"], build_dir=folder,
            timescale=("1ns", "1ps"), log_file=folder / "build.log", always=True,
        )  # fmt: skip
    modules = [f"support.axi.{module}" for module in tests]
    names = "|".join(rf"{module}\.{name}" for module, names in tests.items() for name in names)
    extra = {"CMFPGA_CONFIG": json.dumps(config.to_dict()), "PYTHONWARNINGS": "ignore::DeprecationWarning"}
    extra |= {"COCOTB_LOG_LEVEL": "WARNING", "COCOTB_ANSI_OUTPUT": "0", "COCOTB_TEST_FILTER": rf"\.({names})$"}
    # Under pytest the runner raises SystemExit where a test fails; the file says which.
    with contextlib.suppress(SystemExit):
        runner.test(
            hdl_toplevel=AXI_TOP, hdl_toplevel_lang="verilog", test_module=modules, seed=1, build_dir=folder,
            test_args=["+verilator+rand+reset+2"] if verilated else [], extra_env=extra, results_xml=str(results),
            log_file=log,
        )  # fmt: skip
    said = log.read_text() if log.exists() else "no log"
    if not results.exists():
        raise AssertionError(f"{simulator} gave no results:\n{said[-6000:]}")
    found = {}
    for case in ElementTree.parse(results).iter("testcase"):
        wrong = [child for child in case if child.tag in ("failure", "error", "skipped")]
        found[case.get("name")] = (wrong[0].get("message") or wrong[0].tag) if wrong else None
    return found, said
