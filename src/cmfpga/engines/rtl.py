"""The hardware itself, cycle by cycle, as an engine."""

from abc import abstractmethod

from ..protocol.results import BatchResult, decode
from ..protocol.trace import Trace
from .base import Engine


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
        self._v = (0.0,) * len(config.motion_model.names)

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
    trace = Trace.of_ports(config, trace, tuple(result[f"v_{name}"] for name in config.motion_model.names))
    return BatchResult(**decode(config, result), trace=trace)
