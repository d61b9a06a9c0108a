"""The models as engines: the bit-exact integers, and float64."""

import torch

from ..errors import ConfigError
from ..reference.float_core import FloatCore
from ..reference.integer.core import IntegerCore
from ..reference.integer.sliding import Sliding
from ..reference.regions import RegionSequence
from . import Engine


class ModelEngine(Engine):
    """Runs :class:`cmfpga.reference.integer.core.IntegerCore`; equals the RTL in every bit but has no clock."""

    name = "model"
    model = IntegerCore

    def __init__(self, config):
        super().__init__(config)
        torch.set_num_threads(1)  # tensors this small only get slower with more
        self.core = self.model(config)
        self._table = RegionSequence(self.core) if config.regions else self.core

    def _write(self, regions, anew):
        self._table.write(regions, anew)

    def forget(self):
        super().forget()
        self._sliding = None

    def _run(self, events, settings):
        if self.config.slides:
            if self._sliding is None or settings.roi is not None:
                self._sliding = Sliding(self.config, settings)
            self._sliding.take_lengths(settings)
            return list(self._sliding.run(events.t, events.x, events.y))
        return [self._table.run(events.t, events.x, events.y, settings)]


class FloatEngine(ModelEngine):
    """Runs the equations in float64: what the arithmetic of the other engines is measured against.

    Cropping is the hardware's (it is exact); times, dither, votes, gradients, v and the ROI's position are not rounded,
    and v does not saturate. ``eta``, ``roi_gain`` and ``v_start`` are those that the hardware's formats can express.
    """

    name = "float"
    model = FloatCore

    def __init__(self, config):
        if config.slides:
            raise ConfigError("engine float: windows = batches is needed; rtl and model have windows that slide")
        super().__init__(config)
