"""The simulated hardware, compiled once."""

from support.driving import accelerator, backend, top

__all__ = ["accelerator", "backend", "top"]
