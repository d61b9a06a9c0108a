"""The emitted Verilog is, byte for byte, that of the last commit which meant to change it."""

import json

import pytest

from cmfpga.config import preset
from cmfpga.protocol.registers import declaration
from support import emitted_hashes
from support.emitted_hashes import EMITTED, body, measure, tools
from support.verilog_tools import emitted

KEPT = json.loads(emitted_hashes.PATH.read_text())


@pytest.mark.parametrize("what", EMITTED)
def test_emitted_text_is_as_before(what, monkeypatch):
    # A release renews no hash, although the AXI top's registers say which version it is.
    monkeypatch.setattr(declaration, "__version__", "9.8.7")
    assert measure(what) == KEPT["sha256"][what], (
        f"the Verilog of {what} has changed (kept: that of {KEPT['tools']}, here: {tools()}); "
        "if that is meant: PYTHONPATH=tests python -m support.emitted_hashes"
    )


def test_everything_kept_is_compared():
    assert set(KEPT["sha256"]) == set(EMITTED)


def test_only_the_comment_at_the_top_is_left_out():
    _, text = emitted(preset("fast"))
    head, _, _ = text.partition("\n\n")
    assert body(text) == text.removeprefix(head + "\n") and all(line.startswith("//") for line in head.split("\n"))
    assert "\nmodule " in body(text)
