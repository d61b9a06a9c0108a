"""Plays a batch through the AXI ports, and compares the result with what the integer model says of it.

``cmfpga build --top kv260`` writes this file beside the Verilog, and the batch beside it. It needs cocotb 2, pytest and
a simulator: ``SIM=icarus pytest test_cmfpga_kv260.py``.
"""

import json
import os
from pathlib import Path

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles, FallingEdge, RisingEdge, with_timeout

HERE = Path(__file__).parent
(BATCH,) = HERE.glob("*_batch.json")
DATA = json.loads(BATCH.read_text(encoding="utf-8"))


async def transfer(dut, port, **values):
    """Offer something on a channel until it is taken. Inputs change at the falling edge."""
    for name, value in values.items():
        getattr(dut, f"{port}{name}").value = value
    getattr(dut, f"{port}valid").value = 1
    await RisingEdge(dut.aclk)
    while not getattr(dut, f"{port}ready").value:
        await RisingEdge(dut.aclk)
    await FallingEdge(dut.aclk)
    getattr(dut, f"{port}valid").value = 0


async def write(dut, offset, word):
    """A register, by AXI4-Lite."""
    data = cocotb.start_soon(transfer(dut, "s_axi_w", data=word, strb=0xF))
    await transfer(dut, "s_axi_aw", addr=offset)
    await data
    while not dut.s_axi_bvalid.value:
        await FallingEdge(dut.aclk)
    assert dut.s_axi_bresp.value == 0, f"a write to {offset:#x} is answered with an error"


async def packet(dut):
    """The 64-bit words of m_axis up to the next TLAST."""
    words, last = [], False
    while not last:
        await RisingEdge(dut.aclk)
        if dut.m_axis_tvalid.value and dut.m_axis_tready.value:
            words.append(int(dut.m_axis_tdata.value))
            last = bool(dut.m_axis_tlast.value)
    return words


@cocotb.test()
async def a_batch(dut):
    cocotb.start_soon(Clock(dut.aclk, 10, unit="ns").start())
    for name in ("s_axi_awvalid", "s_axi_wvalid", "s_axi_arvalid", "s_axis_tvalid", "s_axi_rready"):
        getattr(dut, name).value = 0
    for name in ("s_axi_bready", "m_axis_tready"):
        getattr(dut, name).value = 1
    for name in ("s_axi_awprot", "s_axi_arprot", "s_axis_tuser"):
        getattr(dut, name).value = 0
    dut.aresetn.value = 0
    await ClockCycles(dut.aclk, 4)
    await FallingEdge(dut.aclk)
    dut.aresetn.value = 1
    for offset, word in DATA["writes"]:
        await write(dut, offset, word)
    result = cocotb.start_soon(packet(dut))
    for k, word in enumerate(DATA["words"]):
        await transfer(dut, "s_axis_t", data=int(word, 16), keep=0xFF, last=int(k == len(DATA["words"]) - 1))
    words = await with_timeout(result, 100, "ms")
    records = [words[k : k + DATA["beats"]] for k in range(0, len(words), DATA["beats"])]
    halves = [[word >> shift & 0xFFFFFFFF for word in record for shift in (0, 32)] for record in records]
    assert all(record[0] == 1 for record in halves), "a result of another batch than the first"
    assert DATA["expected"], f"nothing to compare with: {DATA['source']}"
    for wanted in DATA["expected"]:
        different = [
            {place: (hex(record[int(place)]), hex(word)) for place, (mask, word) in wanted.items()
             if record[int(place)] & mask != word}
            for record in halves
        ]  # fmt: skip
        assert {} in different, f"word of the result: (what came, what is right): {different[0]}"
    assert len(halves) == len(DATA["expected"])
    cocotb.log.info("%d events' words, %d results as %s", len(DATA["words"]), len(halves), DATA["source"])


def test_a_batch():
    """Starts the simulator ($SIM, by default icarus)."""
    from cocotb_tools.runner import get_runner

    runner, top = get_runner(os.environ.get("SIM", "icarus")), DATA["top"]
    folder = HERE / "sim_build"
    runner.build(sources=[HERE / f"{top}.v"], hdl_toplevel=top, build_dir=folder, timescale=("1ns", "1ps"), always=True)
    runner.test(hdl_toplevel=top, test_module=Path(__file__).stem, build_dir=folder, test_dir=HERE)


if __name__ == "__main__":
    test_a_batch()
