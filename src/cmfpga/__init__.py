"""cmfpga: Contrast Maximization for event cameras on an FPGA."""

__version__ = "0.1.0"
