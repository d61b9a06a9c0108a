"""Engines: the same batches through the emitted Verilog, the integer model, or the float reference."""

import pkgutil

from ..config import DEFAULT_PRESET, SLIDING_PRESET, preset
from ..config.defaults import ENGINES
from ..errors import ConfigError, needs
from ..verilog.compiler import CompilerError, cannot_compile
from .base import Engine, check_roi

#: The accelerator as a board has it, in Verilator: the core with its decoders, registers and packets around it.
AXI = "axi"

#: A board at a serial port, named behind a colon: ``serial:/dev/ttyUSB0``.
SERIAL = "serial"

#: ``module:function`` that makes an engine of a configuration. It is loaded when it is asked for: only some need torch,
#: and the accelerator's lies above this package.
_MAKERS = {
    "rtl": "cmfpga.engines:_make_rtl_engine",
    AXI: "cmfpga.driver.simulation:simulated_engine",
    SERIAL: "cmfpga.driver.uart:serial_engine",
    "model": "cmfpga.engines.model:ModelEngine",
    "float": "cmfpga.engines.model:FloatEngine",
}

#: Engines whose windows can slide.
_SLIDING = ("rtl", "model")
#: A sensor on which any ROI that a sensor has finds its place, px.
_LARGEST = {"sensor_width": 1280, "sensor_height": 800}

__all__ = [
    "AXI",
    "ENGINES",
    "SERIAL",
    "Engine",
    "check_roi",
    "engine_name",
    "make_engine",
    "open_engine",
    "usual_preset",
]


def engine_name(text):
    """``text``, if it names an engine; :exc:`ConfigError` otherwise."""
    kind, colon, port = text.partition(":") if isinstance(text, str) else (None, "", "")
    if kind not in _MAKERS or bool(port) != (kind == SERIAL) or (colon and not port):
        raise ConfigError(f"engine {text!r}: one of {', '.join((*ENGINES, AXI))}, {SERIAL}:PORT is needed")
    return text


def make_engine(name, config):
    """The engine ``rtl``, ``axi``, ``model``, ``float``, or ``serial:PORT`` for ``config``.

    ``rtl`` compiles the emitted Verilog, or, where Verilator or a C++ compiler is missing, uses Amaranth's simulator
    (its ``note`` says so). ``axi`` needs both; its results have no trace, and neither have those of a board at a
    serial port. Only ``model`` and ``float`` import torch.
    """
    kind, _, port = engine_name(name).partition(":")
    return pkgutil.resolve_name(_MAKERS[kind])(config, *([port] if port else []))


def _make_rtl_engine(config):
    """The emitted Verilog compiled by Verilator, or Amaranth's simulator where that or a C++ compiler is missing."""
    why = cannot_compile()
    if not why or config.regions:
        from .verilated import VerilatedEngine

        try:
            return VerilatedEngine(config)
        except CompilerError as error:
            if config.regions:
                raise
            why = str(error)
    if config.slides:
        raise ConfigError(f"windows = sliding: engine rtl needs a C++ compiler: {why}; engine model needs none")
    from .amaranth_sim import AmaranthEngine

    return AmaranthEngine(config, why)


def open_engine(name, config, *, option="engine"):
    """:func:`make_engine`, where a missing torch is the user's to mend; ``option`` is what chose it."""
    with needs("torch", "reference", f"{option} {name}"):
        return make_engine(name, config)


def usual_preset(given, *, batches=False, engine="rtl", objects=1):
    """The preset of a track that names none: that whose windows slide, unless batches are asked for or needed.

    Parameters
    ----------
    given : dict
        Fields that the user gives.
    batches : bool
        The user asks for batches.
    engine : str
    objects : int

    Returns
    -------
    str, str or None
        The preset, and a note for the user where windows cannot slide.
    """
    if batches:
        return DEFAULT_PRESET, None
    why = None
    if engine not in _SLIDING:
        why = f"engine {engine} has no windows that slide"
    elif objects > 1:
        why = "several objects share them"
    elif engine == "rtl" and cannot_compile():
        why = f"windows that slide need a C++ compiler, or engine model: {cannot_compile()}"
    else:
        try:
            config = preset(SLIDING_PRESET).replace(**_LARGEST | given)
            if not (config.confidence and config.judge):
                why = "how long windows are follows from the confidence, which is not measured"
        except ConfigError as error:
            why = str(error)
    return (DEFAULT_PRESET, f"in batches: {why}") if why else (SLIDING_PRESET, None)
