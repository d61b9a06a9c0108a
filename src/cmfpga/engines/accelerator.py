"""An accelerator as an engine."""

from ..protocol.results import WireResult
from .base import Engine


class AcceleratorEngine(Engine):
    """An accelerator with the checks, the empty batches and the ROI of :class:`cmfpga.engines.Engine`.

    Its results are :class:`~.results.WireResult`, which have no trace.

    Parameters
    ----------
    accelerator : Accelerator
        Its ``process`` runs the batches.
    """

    name = "axi"

    def __init__(self, accelerator):
        super().__init__(accelerator.config)
        self._accelerator = accelerator
        self._v = (0.0, 0.0)

    @property
    def v(self):
        return self._v

    def forget(self):
        """The state after a reset."""
        self.roi, self._waiting_roi, self._v = (0, 0), None, (0.0, 0.0)

    def _run(self, events, settings):
        result = self._accelerator.process(events, settings)
        self._v = result.v
        return result

    def _nothing(self, settings):
        return WireResult.nothing(roi=self.roi, roi_next=self.roi, v=self.v)

    def close(self):
        self._accelerator.close()
