"""``python -m cmfpga.driver``."""

import json

import pytest

from cmfpga import cli
from cmfpga.driver import __main__ as command
from cmfpga.driver import uio
from support.board import uio_tree
from support.designs import SHELL_SIZES as SMALL
from support.driving import CONFIG
from support.small_core import options
from support.uio import BUFFERS, Linux

OPTIONS = options({"preset": "fast", **SMALL})


def run(capsys, *arguments):
    status = cli.run(command.main, [*OPTIONS, *arguments])
    shown = capsys.readouterr()
    return status, shown.out, shown.err


def test_on_the_simulation(top, capsys):
    status, out, err = run(capsys)
    assert (status, err) == (0, "")
    assert [line.partition(":")[0] for line in out.splitlines()] == [
        "identity", "scratch", "interrupt", "golden batch", "counters"
    ]  # fmt: skip
    status, out, _ = run(capsys, "--json", "--no-interrupt")
    assert status == 0 and json.loads(out)["interrupt"] == "not used"
    assert CONFIG.hardware_hash[:8] in json.loads(out)["identity"]


def test_on_linux(top, tmp_path, capsys, monkeypatch):
    linux = Linux(uio_tree(tmp_path, buffers=BUFFERS), top, monkeypatch)
    monkeypatch.setattr(uio, "UioBackend", lambda: linux.backend_class(root=tmp_path))
    status, out, err = run(capsys, "--backend", "uio")
    assert (status, err) == (0, "") and "interrupt: came, and went" in out
    status, out, err = run(capsys, "--backend", "uio", "--set", "buffer_events=32")
    assert (status, out) == (2, "") and err.count("\n") == 1
    assert err.startswith("error: UIO: the hardware has the configuration")


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--backend", "uio"], "error: no UIO device called cmfpga (none found); is the overlay loaded"),
        (["--backend", "jtag"], "error: argument --backend: invalid choice: 'jtag'"),
        (["--timeout", "nan"], "error: time-out nan s: 0 to 86400 s is allowed"),
        (["--timeout", "-1"], "error: time-out -1.0 s: 0 to 86400 s is allowed"),
        (["--timeout", "soon"], "error: argument --timeout: invalid float value: 'soon'"),
    ],
)
def test_mistakes_are_one_line(top, capsys, monkeypatch, tmp_path, arguments, message):
    usual = uio.UioBackend
    monkeypatch.setattr(uio, "UioBackend", lambda: usual(root=tmp_path))
    status, out, err = run(capsys, *arguments)
    assert (status, out) == (2, "") and err.count("\n") == 1 and err.startswith(message), err
