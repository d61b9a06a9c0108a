"""Fixtures of the board's tests."""

import re
import shutil

import pytest

from cmfpga.protocol.registers import register_map
from cmfpga.protocol.registers.documents import tcl
from cmfpga.rtl.axi.top import AxiTop
from cmfpga.verilog.compile import kept_verilog
from cmfpga.verilog.emit import AXI_TOP
from support.board_files import KV260, load
from support.designs import SHELL


@pytest.fixture(scope="session")
def maker():
    return load("facts")


@pytest.fixture(scope="session")
def facts(maker):
    return maker.load()


@pytest.fixture
def tool():
    """``tool(program, package)``: the program's path; without it the test skips and names Debian's package."""

    def find(program, package):
        path = shutil.which(program)
        if path is None:
            pytest.skip(f"needs {program}: apt-get install {package}")
        return path

    return find


@pytest.fixture(scope="session")
def emitted():
    """An emitted AXI top under the name of the board's, without the modules inside."""
    text = kept_verilog(AxiTop(SHELL), AXI_TOP).replace(AXI_TOP, KV260.top)
    return re.search(rf"^module {KV260.top}\(.*?^endmodule$", text, re.DOTALL | re.MULTILINE)[0]


@pytest.fixture
def rtl(tmp_path, emitted):
    """``(Verilog, regs.tcl)``, as ``cmfpga build --top kv260`` writes them."""
    verilog, registers = tmp_path / "cmfpga_kv260.v", tmp_path / "regs.tcl"
    verilog.write_text(emitted, encoding="utf-8")
    registers.write_text(tcl(register_map(SHELL)), encoding="utf-8")
    return verilog, registers
