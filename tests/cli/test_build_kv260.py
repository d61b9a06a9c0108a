"""``cmfpga build --top kv260``: ports as Vivado infers them, the same bytes every time."""

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from cmfpga.boards import BOARDS
from cmfpga.cli import build
from cmfpga.config import Config
from cmfpga.protocol.registers import register_map
from cmfpga.protocol.registers.documents import BY_PEAKRDL
from cmfpga.verilog.emit import sha256
from support.building import TINY_SETS, check_lint
from support.designs import SHELL_SIZES
from support.small_core import sets
from support.verilog_tools import require_icarus
from support.vivado.interfaces import infer, ports

KV260 = BOARDS["kv260"]


@pytest.fixture(scope="module", params=("paper", "fast", "objects"))
def made(request, command, long_tools, tmp_path_factory):
    """(folder, kv260-info.json, preset)."""
    folder = tmp_path_factory.mktemp(request.param)
    done = command(build, "--preset", request.param, "--top", "kv260", *TINY_SETS, "--out", folder)
    assert done.status == 0
    listed = [Path(line.removeprefix("wrote ")) for line in done.out.splitlines()]
    assert all(path.stat().st_size for path in listed) and len(listed) >= 7
    return folder, json.loads((folder / "kv260-info.json").read_text()), request.param


def test_the_core_beside_it_is_the_same(made, command, tmp_path):
    folder, _, preset = made
    assert command(build, "--preset", preset, *TINY_SETS, "--out", tmp_path).status == 0
    for path in tmp_path.iterdir():
        assert path.read_bytes() == (folder / path.name).read_bytes()


def test_the_same_bytes_again(made, command, tmp_path):
    folder, info, _ = made
    text = (folder / f"{KV260.top}.v").read_text()
    assert info["sha256"] == sha256(text)
    config = Config(**info["configuration"])
    # Run-time values are registers: they change nothing.
    changed = config.replace(min_roi_events=3, start="zero", roi_gain=1.0)
    again = next(p for p in build.build_top(changed, KV260, tmp_path) if p.suffix == ".v")
    assert again.read_text() == text
    offsets = {register.name: register.offset for register in register_map(config)}
    assert {name: entry["offset"] for name, entry in info["registers"].items()} == offsets


def test_another_board_has_another_name(made, command, tmp_path, monkeypatch):
    """That is all that the Verilog knows of a board."""
    folder, _, preset = made
    other = dataclasses.replace(KV260, name="other", top="cmfpga_other")
    monkeypatch.setitem(BOARDS, other.name, other)
    assert command(build, "--preset", preset, "--top", "other", *TINY_SETS, "--out", tmp_path).status == 0
    assert json.loads((tmp_path / "other-info.json").read_text())["top"] == "cmfpga_other"
    text, own = (tmp_path / "cmfpga_other.v").read_text(), (folder / f"{KV260.top}.v").read_text()
    assert sorted(text.replace("cmfpga_other", KV260.top).split()) == sorted(own.split())


def test_ports_and_their_attributes(made):
    """Every port belongs to an interface, by its attributes, and none is missing (more: tests/boards)."""
    folder, info, _ = made
    text = (folder / f"{KV260.top}.v").read_text()
    listed = {port["name"]: (port["direction"], port["bits"]) for port in info["ports"]}
    assert {name: found[:2] for name, found in ports(text, KV260.top).items()} == listed
    axi = infer(text, KV260.top)["s_axi"]["ports"]
    assert [axi[name][2] for name in ("AWPROT", "WSTRB", "BRESP", "ARPROT", "RRESP")] == [3, 4, 2, 3, 2]


def test_lint(made):
    check_lint(made[0], KV260.top)


@pytest.mark.usefixtures("long_tools")
def test_without_peakrdl(command, tmp_path, monkeypatch):
    monkeypatch.setattr("cmfpga.protocol.registers.documents.has_peakrdl", lambda: False)
    done = command(build, "--top", "kv260", *TINY_SETS, "--out", tmp_path)
    assert done.status == 0 and done.err.count("\n") == 1 and "pip install 'cmfpga[registers]'" in done.err
    assert not any((tmp_path / name).exists() for name in BY_PEAKRDL)


def test_the_bench_plays_the_batch(command, long_tools, tmp_path):
    """The cocotb bench that is written, in Icarus Verilog."""
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
