"""From Amaranth to Verilog text, estimates of its resources, and compiled simulators."""
