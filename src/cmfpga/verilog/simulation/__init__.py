"""The emitted Verilog in Verilator: the core, and the AXI top as a board would see it."""
