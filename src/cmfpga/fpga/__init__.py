"""What FPGA tools say of the Verilog: resources, levels, place and route, a bitstream."""
