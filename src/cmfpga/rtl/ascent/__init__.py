"""Blocks that move v, and the ROI after it."""

from .constant import ConstantAscent
from .newton import NewtonAscent
from .sign import SignAscent

#: By the value of ``ascent``: the ways to move v, each an :class:`~cmfpga.rtl.ascent.ascent.Ascent`.
ASCENTS = {"constant": ConstantAscent, "newton": NewtonAscent, "sign": SignAscent}
