"""The accelerator's blocks, one file per box of the block diagram (docs/architecture.md)."""

import atexit
import gc
import re
import warnings
from pathlib import Path

from amaranth.hdl import Elaboratable, UnusedElaboratable
from amaranth.lib import wiring

# Blocks that are asked for numbers or ports only, where their Verilog is in the cache, are not elaborated.
_HERE = re.escape(str(Path(__file__).parents[1]))
warnings.filterwarnings("ignore", category=UnusedElaboratable, module=_HERE)


class Block(wiring.Component):
    """A component with these members, most often of a configuration, which it keeps."""

    def __init__(self, config=None, /, **members):
        if config is not None:
            self.config = config
        super().__init__(members)


@atexit.register
def _use():
    """The same of blocks that are still there at the end: when they go, filters have gone."""
    gc.unfreeze()
    for each in gc.get_objects():
        if issubclass(type(each), Elaboratable) and type(each).__module__.startswith("cmfpga."):
            each._MustUse__used = True  # Amaranth's own mark
