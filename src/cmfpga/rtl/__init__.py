"""The accelerator's blocks, one file per box of the block diagram (docs/architecture.md)."""

import warnings

from amaranth.hdl import UnusedElaboratable

# Blocks that are asked for numbers or ports only, where their Verilog is in the cache, are not elaborated.
warnings.filterwarnings("ignore", category=UnusedElaboratable, module=r".*[/\\]cmfpga[/\\]")
