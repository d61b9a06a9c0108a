"""The emitted Verilog in Verilator as an engine."""

from ..protocol.settings import settings_values
from ..verilog.simulation.core import VerilatedCore
from .rtl import RtlEngine


class VerilatedEngine(RtlEngine):
    """Runs the emitted Verilog in Verilator."""

    def __init__(self, config):
        super().__init__(config)
        self._core = VerilatedCore(config)

    @property
    def core(self):
        return self._core.core

    def _simulate(self, events, settings):
        values = settings_values(self.config, settings)
        self._core.write_tables(settings)
        result, trace, _ = self._core.run(events.t, events.x, events.y, values)
        return result, trace

    def close(self):
        self._core.close()
