"""The simulated hardware, compiled once."""

from support.driving import accelerator, backend, compiler, top

__all__ = ["accelerator", "backend", "compiler", "top"]
