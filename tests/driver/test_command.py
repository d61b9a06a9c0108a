"""``cmfpga driver``."""

import json

import pytest

from cmfpga.cli import driver
from cmfpga.driver import uio
from support.board import uio_tree
from support.designs import SHELL_SIZES as SMALL
from support.driving import CONFIG
from support.small_core import options
from support.uio import BUFFERS, Linux

OPTIONS = options({"preset": "fast", **SMALL})


def test_on_the_simulation(top, command):
    done = command(driver, *OPTIONS)
    assert (done.status, done.err) == (0, "")
    steps = ["identity", "scratch", "interrupt", "golden batch", "counters"]
    assert [line.partition(":")[0] for line in done.out.splitlines()] == steps
    done = command(driver, *OPTIONS, "--json", "--no-interrupt")
    told = json.loads(done.out)
    assert done.status == 0 and told["interrupt"] == "not used" and CONFIG.hardware_hash[:8] in told["identity"]


def test_on_linux(top, command, tmp_path, monkeypatch):
    linux = Linux(uio_tree(tmp_path, buffers=BUFFERS), top, monkeypatch)
    monkeypatch.setattr(uio, "UioBackend", lambda: linux.backend_class(root=tmp_path))
    done = command(driver, *OPTIONS, "--backend", "uio")
    assert (done.status, done.err) == (0, "") and "interrupt: came, and went" in done.out
    done = command(driver, *OPTIONS, "--backend", "uio", "--set", "buffer_events=32")
    assert done.error.startswith("UIO: the hardware has the configuration")
    assert done.out == "" and done.err.count("\n") == 1


@pytest.mark.parametrize("arguments, message", [
    (["--backend", "uio"], "no UIO device called cmfpga (none found); is the overlay loaded"),
    (["--backend", "jtag"], "argument --backend: invalid choice: 'jtag'"),
    (["--timeout", "nan"], "time-out nan s: 0 to 86400 s is allowed"),
    (["--timeout", "-1"], "time-out -1.0 s: 0 to 86400 s is allowed"),
    (["--timeout", "soon"], "argument --timeout: invalid float value: 'soon'"),
])  # fmt: skip
def test_mistakes_are_one_line(top, command, monkeypatch, tmp_path, arguments, message):
    usual = uio.UioBackend
    monkeypatch.setattr(uio, "UioBackend", lambda: usual(root=tmp_path))
    done = command(driver, *OPTIONS, *arguments)
    assert done.error.startswith(message) and done.out == "" and done.err.count("\n") == 1
