"""The simulated hardware, compiled once."""

from support.driving import compiler, top

__all__ = ["compiler", "top"]
