"""``bit2bin.py`` writes what Debian's bootgen writes, and refuses what is no bitstream."""

import json
import subprocess
import sys

import pytest

from support.board_files import BOARD, bitstream

PART = "xck26-sfvc784-2LV-c"


def convert(*arguments):
    return subprocess.run(
        [sys.executable, BOARD / "bit2bin.py", *map(str, arguments)], capture_output=True, text=True, timeout=60
    )


@pytest.fixture
def bit(tmp_path):
    path = tmp_path / "cmfpga.bit"
    path.write_bytes(bitstream(PART))
    return path


@pytest.mark.parametrize("words, seed", [(0, 1), (64, 2), (4099, 3)])
def test_equals_bootgen(words, seed, tmp_path, tool):
    bootgen = tool("bootgen", "xilinx-bootgen")
    (tmp_path / "cmfpga.bit").write_bytes(bitstream(PART, words, seed))
    (tmp_path / "cmfpga.bif").write_bytes((BOARD / "sw" / "cmfpga.bif").read_bytes())
    done = subprocess.run(
        [bootgen, "-w", "-arch", "zynqmp", "-process_bitstream", "bin", "-image", "cmfpga.bif"],
        cwd=tmp_path, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    theirs = (tmp_path / "cmfpga.bit.bin").read_bytes()
    assert convert(tmp_path / "cmfpga.bit", "-o", tmp_path / "ours.bin").returncode == 0
    assert (tmp_path / "ours.bin").read_bytes() == theirs
    assert len(theirs) == 68 + 4 * words


def test_fields_as_json(bit):
    done = convert(bit, "--json", "--part", PART)
    assert done.returncode == 0
    found = json.loads(done.stdout)
    assert found["part"] == PART and found["design"].startswith("cmfpga_bd_wrapper")
    assert found["bytes"] == (bit.parent / "cmfpga.bit.bin").stat().st_size


def odd(bit):
    at = bit.index(b"e\0\0") + 1
    return bit[:at] + (len(bit) - at - 4 + 2).to_bytes(4, "big") + bit[at + 4 :] + b"xx"


@pytest.mark.parametrize("spoil, text", [
    (lambda bit: b"", "does not begin like a .bit"), (lambda bit: bit[100:], "does not begin like a .bit"),
    (lambda bit: bit[:-5], "cut short"), (odd, "whole 32-bit words"),
    (lambda bit: bit.replace(b"a\0", b"q\0", 1), "header, byte 13"),
    (lambda bit: bit[:40], "header, byte"),
    (lambda bit: bit.replace(bytes.fromhex("aa995566"), b"\0\0\0\0"), "no synchronisation word"),
], ids=["empty", "no header", "cut", "odd", "unknown field", "header only", "no sync word"])  # fmt: skip
def test_refused_in_one_line(spoil, text, bit):
    bit.write_bytes(spoil(bit.read_bytes()))
    done = convert(bit)
    assert done.returncode == 2 and not done.stdout
    assert text in done.stderr and done.stderr.count("\n") == 1 and done.stderr.startswith("error: ")
    assert not (bit.parent / "cmfpga.bit.bin").exists()


def test_other_part_and_missing_file(bit, tmp_path):
    done = convert(bit, "--part", "xczu9eg-ffvb1156-2-e")
    assert done.returncode == 2 and f"is for part {PART}" in done.stderr
    done = convert(tmp_path / "none.bit")
    assert done.returncode == 2 and "No such file" in done.stderr
