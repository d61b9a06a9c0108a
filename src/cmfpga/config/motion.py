"""Motion models: which numbers the ascent looks for, and how they move an event.

What depends on the motion loops over :attr:`MotionModel.names`; the image's axes, columns ``x`` and rows ``y``, are
always two. Translation calls its parameters by the axes that they move.
"""

from dataclasses import dataclass

from ..fixed import Q


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number of a motion.

    Parameters
    ----------
    name : str
        Suffix of ports and members: ``v_x``, ``dx``, ``sx``.
    unit : str
    fmt : Q
        Its format; it saturates.
    moves_roi : str or None
        The axis, ``x`` or ``y``, along which the ROI follows it.
    """

    name: str
    unit: str
    fmt: Q
    moves_roi: str | None = None


@dataclass(frozen=True, kw_only=True)
class MotionModel:
    """A motion: x' = x − dt · Σ basis_p(x, y) · v_p.

    Parameters
    ----------
    name : str
    parameters : tuple of Parameter
    basis_format : Q
        Of what an event's position makes of a parameter.
    latency : int
        Clock cycles that it takes to compute.
    """

    name: str
    parameters: tuple[Parameter, ...]
    basis_format: Q
    latency: int

    @property
    def names(self):
        """Names of the parameters, in order."""
        return tuple(parameter.name for parameter in self.parameters)


def translation(v):
    """All events move alike, by ``v`` (its format, a :class:`~cmfpga.fixed.Q`): the basis is 1 along one's own axis."""
    return MotionModel(
        name="translation",
        parameters=tuple(Parameter(name=axis, unit="px/half batch", fmt=v, moves_roi=axis) for axis in ("x", "y")),
        basis_format=Q(1, 0, signed=False),
        latency=0,
    )
