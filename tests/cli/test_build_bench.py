"""The cocotb bench that ``cmfpga build --top kv260`` writes, in Icarus Verilog."""

import json
import os
import subprocess
import sys

import pytest

from cmfpga.cli import build
from support.designs import SHELL_SIZES
from support.small_core import sets
from support.verilog_tools import require_icarus


def test_plays_the_batch(command, long_tools, tmp_path):
    pytest.importorskip("cocotb", reason="cocotb is not installed (pip install cocotb)")
    require_icarus()
    small = sets({**SHELL_SIZES, "max_batch_events": 150})
    assert command(build, *small, "--top", "kv260", "--out", tmp_path).status == 0
    file = tmp_path / "cmfpga_kv260_batch.json"
    kept = json.loads(file.read_text())

    def play():
        run = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_cmfpga_kv260.py"]
        done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, env={**os.environ, "SIM": "icarus"})
        return done.returncode, done.stdout + done.stderr

    status, said = play()
    assert status == 0 and "1 passed" in said, said
    assert len(kept["expected"]) == 1 and len(kept["expected"][0]) > 20
    mask, word = kept["expected"][-1]["4"]  # RESULT_V_X
    kept["expected"][-1]["4"] = mask, word ^ 1
    file.write_text(json.dumps(kept))
    status, said = play()
    assert status == 1 and "'4': (" in said, said
