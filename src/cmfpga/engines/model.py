"""The bit-exact integer model as an engine."""

import torch

from ..reference.integer.core import IntegerCore
from .base import Engine


class ModelEngine(Engine):
    """Runs :class:`cmfpga.reference.integer.core.IntegerCore`; equals the RTL in every bit but has no clock."""

    name = "model"
    model = IntegerCore

    def __init__(self, config):
        super().__init__(config)
        torch.set_num_threads(1)  # tensors this small only get slower with more
        self.core = self.model(config)

    @property
    def v(self):
        return self.core.velocity

    def _trace_v(self):
        return self.core.v

    def _run(self, events, settings):
        return self.core.run(events.t, events.x, events.y, settings)
