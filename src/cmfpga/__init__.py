"""cmfpga: Contrast Maximization for event cameras on an FPGA."""

import importlib

__version__ = "0.1.0"


def __getattr__(name):
    """``cmfpga.track`` without an import of its own; ``import cmfpga`` loads nothing else."""
    if name == "track":
        return importlib.import_module(".track", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
