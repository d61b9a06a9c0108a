"""Fixtures of the board's tests."""

import shutil

import pytest

from support.board_files import REGISTERS, load, stand_in


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


@pytest.fixture
def rtl(tmp_path):
    """``(Verilog, regs.tcl)`` of the stand-in."""
    verilog, registers = tmp_path / "cmfpga_kv260.v", tmp_path / "regs.tcl"
    verilog.write_text(stand_in(), encoding="utf-8")
    registers.write_text(REGISTERS, encoding="utf-8")
    return verilog, registers
