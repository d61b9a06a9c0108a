"""Following objects through a recording: batches in order, and what is kept of them.

``track``, ``Tracker``, ``Tracking``, ``Source`` and ``open_engine`` are loaded when they are asked for.
"""

import importlib

_HOMES = {"track": "api", "Tracker": "api", "Tracking": "result", "Source": "source", "open_engine": "api"}


def __getattr__(name):
    if name in _HOMES:
        return getattr(importlib.import_module(f".{_HOMES[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
