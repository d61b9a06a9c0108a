"""cmfpga: Contrast Maximization for event cameras on an FPGA.

``track``, ``Tracker``, ``flow`` and ``Events`` are loaded when they are asked for.
"""

import importlib

__version__ = "0.1.0"

_HOMES = {"Events": "events", "Tracker": "api.track", "flow": "api.flow", "track": "api.track"}
__all__ = ["Events", "Tracker", "flow", "track"]


def __getattr__(name):
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_HOMES[name]}", __name__), name)


def __dir__():
    return [*__all__, "__version__"]
