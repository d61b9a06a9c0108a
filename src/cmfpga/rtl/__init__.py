"""The accelerator's blocks, one file per box of the block diagram (docs/architecture.md)."""

import re
import warnings
from pathlib import Path

from amaranth.hdl import UnusedElaboratable

# Blocks that are asked for numbers or ports only, where their Verilog is in the cache, are not elaborated.
_HERE = re.escape(str(Path(__file__).parents[1]))
warnings.filterwarnings("ignore", category=UnusedElaboratable, module=_HERE)
