"""The driver's facts of the KV260 are those of the board's files."""

import tomllib
from pathlib import Path

import pytest

from cmfpga.driver import facts

BOARD = Path(__file__).parents[2] / "boards" / "kv260" / "board.toml"


@pytest.mark.skipif(not BOARD.exists(), reason="boards/kv260/board.toml is not there")
def test_facts_are_those_of_the_board():
    board = tomllib.loads(BOARD.read_text(encoding="utf-8"))
    ip, linux = board["ip"], board["linux"]
    assert facts.VLNV == f"{ip['vendor']}:{ip['library']}:{ip['name']}:{ip['version']}"
    assert facts.MODULE_VLNV == f"xilinx.com:module_ref:{board['design']['top']}:1.0"
    assert facts.DMA_LENGTH_BITS == board["dma"]["length_width"]
    assert (facts.UIO_REGISTERS, facts.UIO_DMA) == (linux["uio_cmfpga"], linux["uio_dma"])
    assert (facts.BUFFER_EVENTS, facts.BUFFER_RESULTS) == (linux["buffer_events"], linux["buffer_results"])
    assert facts.BUFFER_EVENTS_SIZE == linux["buffer_events_size"]
    assert facts.BUFFER_RESULTS_SIZE == linux["buffer_results_size"]
