"""cmfpga: Contrast Maximization for event cameras on an FPGA."""

import importlib

__version__ = "0.1.0"


def __getattr__(name):
    """``cmfpga.track`` and ``cmfpga.Tracker`` without imports of their own; ``import cmfpga`` loads nothing else."""
    if name == "track":
        return importlib.import_module(".track", __name__)
    if name == "Tracker":
        return importlib.import_module(".tracking.api", __name__).Tracker
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
