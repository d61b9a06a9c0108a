"""The float64 reference as an engine."""

from ..reference.float_core import FloatCore
from .model import ModelEngine


class FloatEngine(ModelEngine):
    """Runs the equations in float64: what the arithmetic of the other engines is measured against.

    Cropping is the hardware's (it is exact); times, dither, votes, gradients, v and the ROI's position are not rounded,
    and v does not saturate. ``eta``, ``roi_gain`` and ``v_start`` are those that the hardware's formats can express.
    """

    name = "float"
    model = FloatCore
