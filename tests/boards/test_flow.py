"""``make`` from Verilog to the folder for the board, with the model in Vivado's place."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.board_files import BOARD, ROOT

pytest.importorskip("tkinter", reason="needs Python's tkinter: apt-get install python3-tk")

TESTS = Path(__file__).parents[1]


def make(folder, *words, found=None):
    """``make`` in a copy of the board's folder, so that nothing is left in the repository."""
    path = os.pathsep.join(filter(None, (str(TESTS), os.environ.get("PYTHONPATH"))))
    environment = {**os.environ, "VIVADO_MODEL": json.dumps(found or {}), "PYTHONPATH": path}
    vivado = f"{sys.executable} -m support.vivado.model"
    return subprocess.run(
        ["make", "--no-print-directory", "-C", folder, f"PYTHON={sys.executable}", f"VIVADO={vivado}",
         "JOBS=2", *words],
        capture_output=True, text=True, timeout=300, env=environment,
    )  # fmt: skip


@pytest.fixture
def board(tmp_path, rtl, tool):
    """``(folder, options)``: a copy of ``boards/kv260`` and the emitted Verilog."""
    tool("make", "make")
    tool("dtc", "device-tree-compiler")
    folder = tmp_path / "kv260"
    shutil.copytree(BOARD, folder, ignore=shutil.ignore_patterns("build", "__pycache__"))
    return folder, (f"VERILOG={rtl[0]}", f"REGISTERS={rtl[1]}")


def test_make_gives_the_folder_for_the_board(board):
    folder, options = board
    done = make(folder, *options)
    assert done.returncode == 0, done.stdout + done.stderr
    package = folder / "build" / "cmfpga"
    assert {path.name for path in package.iterdir()} == {
        "cmfpga.bit.bin", "cmfpga.dtbo", "shell.json", "uio.conf", "install.sh", "cmfpga.bit", "cmfpga.hwh",
        "summary.json",
    }  # fmt: skip
    assert json.loads((package / "summary.json").read_text(encoding="utf-8"))["passed"] is True
    again = make(folder, *options, "firmware")
    assert again.returncode == 0 and "vivado.py" not in again.stdout  # nothing is built twice


def test_steps_one_by_one(board):
    folder, options = board
    for step, result in (
        ("ip", "ip/component.xml"), ("ooc", "ooc/summary.json"), ("bit", "vivado/cmfpga.bit"),
        ("firmware", "cmfpga.bit.bin"), ("package", "cmfpga/install.sh"),
    ):  # fmt: skip
        assert not (folder / "build" / result).exists()
        done = make(folder, *options, step)
        assert done.returncode == 0, done.stdout + done.stderr
        assert (folder / "build" / result).exists()
    assert make(folder, "clean").returncode == 0
    assert not (folder / "build").exists()


@pytest.mark.parametrize("found", [{"wns": "-0.3"}, {"impl_status": "route_design ERROR"}, {"boards": []}])
def test_make_stops_at_a_failure(found, board):
    folder, options = board
    done = make(folder, *options, found=found)
    assert done.returncode != 0
    assert "ERROR: cmfpga:" in done.stdout
    assert not (folder / "build" / "cmfpga.bit.bin").exists() and not (folder / "build" / "cmfpga").exists()


def test_frequency_sweep(board):
    folder, options = board
    for mhz in (100, 300):
        assert make(folder, *options, "ooc", f"MHZ={mhz}").returncode == 0
        assert json.loads((folder / "build" / "ooc" / "summary.json").read_text(encoding="utf-8"))["clock_mhz"] == mhz


def test_targets_are_documented():
    readme = (BOARD / "README.md").read_text(encoding="utf-8")
    for line in (BOARD / "Makefile").read_text(encoding="utf-8").splitlines():
        if line.startswith(".PHONY:"):
            for target in line.removeprefix(".PHONY:").split():
                assert target == "all" or f"`make {target}`" in readme, target


def test_names_of_tools_in_ci():
    """What the tests look for is what continuous integration installs."""
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    for name in ("iverilog", "device-tree-compiler", "xilinx-bootgen", "python3-tk"):
        assert name in script
