"""The whole way to a bitstream, of a design that is small enough: the board's pins, both clocks, PLL, packer."""

import pytest

from cmfpga.boards import TANG_PRIMER_20K, ULX3S
from cmfpga.fpga import bitstream
from cmfpga.fpga.tools import COMMANDS

#: Ports of the serial top; a counter on each clock.
SMALL = """
module {top}(input clk, input rst, input uart_rx, input cpi_pclk, input cpi_hsync, input cpi_vsync,
             input [7:0] cpi_data, output reg uart_tx, output irq);
  reg [7:0] sensor, count;
  always @(posedge cpi_pclk) sensor <= sensor + (cpi_data & {{8{{cpi_hsync & cpi_vsync}}}});
  always @(posedge clk)
    if (rst) begin count <= 0; uart_tx <= 1; end
    else begin count <= count + uart_rx; uart_tx <= ^count; end
  assign irq = ^sensor;
endmodule
"""


def made_of_a_small_design(board, nextpnr, tmp_path):
    for tool in "yosys", nextpnr:
        pytest.importorskip(COMMANDS[tool][0])
    found = bitstream.bitstream(SMALL.format(top=board.top), board, tmp_path / "small")
    content = (tmp_path / "small").read_bytes()
    assert found["bytes"] == len(content) > 10_000
    for name, hz in ("clock", board.clock_hz), ("sensor", board.sensor_clock_hz):
        assert found["seeds"]["1"][name]["wanted_mhz"] == hz / 1e6
    assert found["seeds"]["1"]["clock"]["fmax_mhz"] > 100 and found["resources"]["ff"]["used"] >= 17
    return found, content


def test_of_the_ulx3s(tmp_path):
    found, content = made_of_a_small_design(ULX3S, "nextpnr-ecp5", tmp_path)
    assert b"LFE5U-85F" in content[:200]
    assert "cmfpga_ulx3s on LFE5U-85F-6CABGA381" in bitstream.text(found) and "bound" not in bitstream.text(found)


def test_of_the_tang_primer_20k(tmp_path):
    """The bitstream's head names the device; what the text says of the clock is what nextpnr knows of it."""
    found, content = made_of_a_small_design(TANG_PRIMER_20K, "nextpnr-himbaechel-gowin", tmp_path)
    rows = [line for line in content.decode().splitlines() if not line.startswith("//")]
    assert set("".join(rows)) == {"0", "1"}
    assert f"{0x0000081B:032b}" in "".join(rows[:8])
    assert "27 MHz; only a bound, without delays of multipliers" in bitstream.text(found)
