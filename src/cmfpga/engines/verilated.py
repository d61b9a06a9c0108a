"""The emitted Verilog in Verilator as an engine."""

from ..verilog.simulation.core import VerilatedCore
from .base import Engine

_PIECE = 4096  # events for whose results there is memory


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
        if self.config.slides:
            if settings.roi is not None:
                self._core.reset()
            return self._slide(events, settings)
        results = self._core.results([(events.t, events.x, events.y)], settings)
        self.cycles = self._core.finished[-1] - self._core.offered[-1]
        return results

    def _slide(self, events, settings):
        found = []
        for at in range(0, len(events), _PIECE):
            part = events[at : at + _PIECE]
            found += self._core.slide(part.t, part.x, part.y, settings)
        return found

    def close(self):
        super().close()
        self._core.close()
