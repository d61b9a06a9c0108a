"""The emitted Verilog in Verilator as an engine."""

from ..verilog.simulation.core import VerilatedCore
from .base import Engine


class VerilatedEngine(Engine):
    """Runs the emitted Verilog in Verilator."""

    name = "rtl"

    def __init__(self, config):
        super().__init__(config)
        self._core = VerilatedCore(config)

    @property
    def core(self):
        """The component, which knows how many cycles a batch takes."""
        return self._core.core

    def _write(self, regions, anew):
        self._core.write(regions, anew)

    def _run(self, events, settings):
        results = self._core.results([(events.t, events.x, events.y)], settings)
        self.cycles = self._core.finished[-1] - self._core.offered[-1]
        return results

    def close(self):
        self._core.close()
