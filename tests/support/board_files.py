"""The board's folder as modules, and what a run of Vivado would give."""

import importlib.util
import struct
import sys
from pathlib import Path

from cmfpga.boards import BOARDS

ROOT = Path(__file__).parents[2]
KV260 = BOARDS["kv260"]
BOARD = ROOT / "boards" / KV260.name


def load(name, folder=BOARD):
    spec = importlib.util.spec_from_file_location(f"{folder.name}_{name}", folder / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def bitstream(part, words=64, seed=1):
    """A .bit with a header like Vivado's, and data that are no configuration of anything."""
    data = b"\xff" * 64 + bytes.fromhex("aa995566") + b"".join(
        struct.pack(">I", (seed * 2654435761 + 40503 * n) & 0xFFFFFFFF) for n in range(words)
    )  # fmt: skip
    bit = bytes.fromhex("0009 0ff00ff00ff00ff000 0001")
    texts = (("a", "cmfpga_bd_wrapper;UserID=0XFFFFFFFF;Version=2022.2"), ("b", part), ("c", "2024/01/02"),
             ("d", "03:04:05"))  # fmt: skip
    for key, text in texts:
        bit += key.encode() + struct.pack(">H", len(text) + 1) + text.encode() + b"\0"
    return bit + b"e" + struct.pack(">I", len(data)) + data
