"""Engines: the same batches through the emitted Verilog, the integer model, or the float reference."""

from ..errors import ConfigError
from .base import Engine, check_roi

ENGINES = ("rtl", "model", "float")

__all__ = ["ENGINES", "Engine", "check_roi", "make_engine"]


def make_engine(name, config):
    """The engine ``rtl``, ``model`` or ``float`` for ``config``.

    ``rtl`` compiles the emitted Verilog, or, where there is no C++ compiler, uses Amaranth's simulator (its
    ``note`` says so). Only the other two import torch.
    """
    if name == "rtl":
        from .rtl import make_rtl_engine

        return make_rtl_engine(config)
    if name == "model":
        from .model import ModelEngine

        return ModelEngine(config)
    if name == "float":
        from .floating import FloatEngine

        return FloatEngine(config)
    raise ConfigError(f"engine {name!r}: one of {', '.join(ENGINES)} is needed")
