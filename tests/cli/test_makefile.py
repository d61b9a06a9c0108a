"""``make``: names that a recording or a folder may have reach the programs whole, and run nothing."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MAKE = shutil.which("make")
pytestmark = pytest.mark.skipif(MAKE is None, reason="make is not installed")

NAMES = (
    "my scene.h5", "q;touch X;.npz", "$(touch X).npz", "$(shell touch X).npz", "`touch X`", "'; touch X; '",
    '"; touch X; "', "a\ntouch X", "a\\ #|&<>*?$HOME$$b%:=,{}", "-q",
)  # fmt: skip
PROGRAM = f"""#!{sys.executable} -IS
import json, sys
with open("calls", "a") as file:
    print(json.dumps(sys.argv[1:]), file=file)
"""


@pytest.fixture
def make(tmp_path):
    """``make(*arguments)``: what ``python -m`` was called with, in a folder whose programs only write that down."""
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
    programs = tmp_path / ".venv" / "bin"
    programs.mkdir(parents=True)
    for name in ("python", "pip"):
        (programs / name).write_text(PROGRAM)
        (programs / name).chmod(0o755)
    (tmp_path / ".venv" / "installed-report").touch()
    before = {*os.listdir(tmp_path), "calls"}

    def make(*arguments):
        done = subprocess.run([MAKE, *arguments], cwd=tmp_path, capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")
        assert "X" not in os.listdir(tmp_path)
        calls = [json.loads(line)[1:] for line in (tmp_path / "calls").read_text().splitlines()]
        return calls, {*os.listdir(tmp_path)} - before

    return make


@pytest.mark.parametrize("name", NAMES)
def test_recording(make, name):
    calls, made = make(f"RECORDING={name}", f"ROI={name}", f"OUT={name}", "TRACK=--batches 3")
    tracked = ["cmfpga", "track", f"--roi={name}", "--batches", "3", f"--out={name}/track", "--", name]
    assert calls == [["cmfpga", "build", f"--out={name}"], tracked] and not made


def test_without(make):
    assert make() == ([["cmfpga", "build", "--out=build"], ["cmfpga", "track", "--out=build/track"]], set())


def test_extras(make):
    """--report works after the first command; another choice is installed though one is there already."""
    calls, _ = make("EXTRAS=all")
    assert calls[0][-2:] == ["-e", ".[all]"] and calls[1][:2] == ["cmfpga", "build"]


def test_the_site(make, tmp_path):
    calls, made = make("docs", "OUT=my $(shell touch X) site")
    assert calls[-1][-2:] == ["--site-dir", str(tmp_path / "my $(shell touch X) site" / "site")]
    assert made == {"my $(shell touch X) site"}


def test_a_release(make):
    calls, _ = make("release", "OUT=my $(shell touch X) out")
    assert calls[-2][-2:] == ["-e", ".[release]"] and calls[-1] == ["my $(shell touch X) out/release"]


def test_clean_removes_one_folder(make, tmp_path):
    for name in ("my", "out", "my out"):
        (tmp_path / name).mkdir()
    (tmp_path / "calls").touch()
    assert make("clean", "OUT=my out") == ([], {"my", "out"})
