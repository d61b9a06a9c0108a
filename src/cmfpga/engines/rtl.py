"""The hardware itself, cycle by cycle, as an engine."""

import os
import shlex
import shutil
from abc import abstractmethod

from ..protocol.results import BatchResult, decode
from ..protocol.trace import Trace
from .base import Engine

COMPILERS = ("c++", "g++", "clang++")


def find_compiler():
    """The command of a C++ compiler, as a shell takes it: ``$CXX``, or the first of :data:`COMPILERS`; None without.

    Whether it works is found out by using it.
    """
    given = os.environ.get("CXX", "").strip()
    return given or next((shlex.quote(path) for path in map(shutil.which, COMPILERS) if path), None)


def make_rtl_engine(config):
    """The emitted Verilog compiled by Verilator, or Amaranth's simulator where there is no C++ compiler that works."""
    why = "no C++ compiler found"
    if find_compiler():
        from ..verilog.compile import CompilerError
        from .verilated import VerilatedEngine

        try:
            return VerilatedEngine(config)
        except CompilerError as error:
            why = str(error)
    from .amaranth_sim import AmaranthEngine

    return AmaranthEngine(config, why)


class RtlEngine(Engine):
    """Common part of the engines that have a clock.

    Attributes
    ----------
    core : Core or VerilogCore
        Knows how many cycles a batch takes.
    """

    name = "rtl"

    def __init__(self, config):
        super().__init__(config)
        self._v = (0.0, 0.0)

    @property
    def v(self):
        return self._v

    def _run(self, events, settings):
        result, trace = self._simulate(events, settings)
        batch = to_batch_result(self.config, result, trace)
        self._v = batch.v
        return batch

    @abstractmethod
    def _simulate(self, events, settings):
        """``(result, trace)``: the result ports by name (without ``result_``), and trace ports, int64 [T, 7]."""


def to_batch_result(config, result, trace):
    """A :class:`BatchResult` of raw values: result ports by name, and the trace ports' [T, 7] in their order."""
    trace = Trace.of_ports(config, trace, (result["v_x"], result["v_y"]))
    return BatchResult(**decode(config, result), trace=trace)
