"""Motion models: which numbers the ascent looks for, and how they move an event.

Each is linear in its parameters: x' = x − dt·Σ v_p·b_p(x, y). What depends on the motion loops over
:attr:`MotionModel.names` and :attr:`MotionModel.terms`; the image's axes, columns ``x`` and rows ``y``, are always two.
A parameter's unit is px per half batch where b_p is 1: translation calls its parameters by the axes that they move.
"""

from dataclasses import dataclass
from math import floor

from ..errors import ConfigError
from ..fixed import Q, bits_for


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number of a motion."""

    name: str  # suffix of ports and members: v_x, sx
    fmt: Q  # its format; it saturates
    moves_roi: str | None = None  # the axis, x or y, along which the ROI follows it


@dataclass(frozen=True, kw_only=True)
class MotionModel:
    """A motion that is linear in its parameters.

    Along its own axis the basis of ``x`` and of ``y`` is 1 and what ``terms`` say; all else is in ``terms``:
    ``{axis: ((parameter, member of the basis, sign), …)}``, what each parameter moves along the axis, beside that.

    The members of the basis at an event: ``p``, ``q``, its distance from the centre to the right and down, in lever
    arms; ``xx``, ``xy``, ``yy``, products of that distance in focal lengths.
    """

    name: str
    parameters: tuple[Parameter, ...]
    terms: dict
    lever: int  # log2 of the lever arm in px: at that distance from the centre a roll or zoom of 1 moves by 1 px
    basis: dict  # {member: Q}

    #: Of an event's position in the basis: quarters of a pixel.
    place_frac = 2
    #: Fraction bits of a rotation's curve, 1/f² of the focal length f in px, and its width.
    curve_frac, curve_bits = 27, 17

    @property
    def names(self):
        """Names of the parameters, in order."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def of_pixels(self):
        """The gradient takes ``p`` and ``q`` of the pixels that an event changes, not of the event.

        Where an event meets earlier ones in a pixel, it counts them with its own basis. On average it lies beyond them
        in its own direction, so that a motion whose basis diverges, a zoom, would be found too large.
        """
        return "zoom" in self.names

    @property
    def frac(self):
        """Fraction bits of the basis."""
        return self.lever + self.place_frac

    def lens(self, config):
        """The camera's nine numbers; :exc:`ConfigError` where a rotation cannot be seen by them."""
        return check_lens(config) if self.name == "rotation" else config.lens

    def centre(self, lens):
        """A camera's principal point, in quarters of a pixel: what a rotation counts ``p`` and ``q`` from."""
        return tuple(floor(at * (1 << self.place_frac) + 0.5) for at in lens[2:4])

    def curve(self, lens):
        """2^curve_frac/f² of a camera's nine numbers, limited to its width: what ``xx``, ``xy``, ``yy`` are made of."""
        return min(round((1 << self.curve_frac) / (lens[0] * lens[1])), (1 << self.curve_bits) - 1)

    def factors(self, parameter):
        """``((axis, member of the basis, sign), …)`` of a parameter's terms."""
        terms = ((axis, *term) for axis, terms in self.terms.items() for term in terms)
        return tuple((axis, member, sign) for axis, name, member, sign in terms if name == parameter)

    @property
    def reach(self):
        """Bound of Σ |b_p| of a parameter along both axes, times 2^frac."""
        return (1 << self.frac) + max(self._sum(self.factors(name)) for name in self.names)

    @property
    def stretch(self):
        """Bound of Σ |b_p| of all parameters along an axis, and what rounding adds; a whole number."""
        return 2 + (max(map(self._sum, self.terms.values())) >> self.frac) + 1

    def _sum(self, terms):
        return sum(-self.basis[member].min for _, member, _ in terms)


_TURN = {"x": (("roll", "q", -1),), "y": (("roll", "p", 1),)}
_GROW = {"x": (("zoom", "p", 1),), "y": (("zoom", "q", 1),)}
_BEND = {"x": (("x", "xx", 1), ("y", "xy", 1)), "y": (("x", "xy", 1), ("y", "yy", 1))}


def _both(*terms):
    return {axis: tuple(term for part in terms for term in part[axis]) for axis in ("x", "y")}


#: By the value of ``Config.motion``: the terms, what else the ROI's motion has, and whether it follows the ROI.
MOTIONS = {
    "translation": (_both(), (), True),
    "similarity": (_both(_GROW, _TURN), ("zoom", "roll"), True),
    "rotation": (_both(_BEND, _TURN), ("roll",), False),
}


def motion_model(config):
    """The :class:`MotionModel` of a configuration."""
    terms, more, follows = MOTIONS[config.motion]
    v = Q(config.v_int, config.v_frac)
    axes = tuple(Parameter(name=axis, fmt=v, moves_roi=axis if follows else None) for axis in ("x", "y"))
    lever = (max(config.roi_width, config.roi_height) // 2).bit_length() - 1
    # A quarter of the lever arm at most: beyond it a zoom gathers all events on a few pixels, which is sharp, too.
    limited = Q(max(1, min(config.v_int, lever - 2)), config.v_frac)
    members = sorted({member for part in terms.values() for _, member, _ in part})
    # The centre is the ROI's, or lies on the sensor; that of a region may lie anywhere in the image.
    image = config.geometry.size
    sizes = image if "xx" in members else (config.roi_width, config.roi_height)
    beside = 1 << config.max_level  # of a cell across the border
    farthest = {
        name: size if "xx" in members else (size if config.regions else size // 2) + beside
        for name, size in zip("pq", sizes, strict=True)
    }
    integer = {name: max(0, bits_for(far + 1) - lever) for name, far in farthest.items()}
    # Rays beyond 63 degrees from the axis (xx = 4) saturate.
    formats = {name: Q(integer.get(name, 2), lever + MotionModel.place_frac) for name in members}
    parameters = (*axes, *(Parameter(name=name, fmt=limited) for name in more))
    return MotionModel(name=config.motion, parameters=parameters, terms=terms, lever=lever, basis=formats)


def needs(motion):
    """``{field: value}`` of what the hardware of a motion builds on."""
    beyond = {"gradient": "one_pass", "ascent": "sign", "border": "whole"}
    return {"translation": {}, "similarity": beyond, "rotation": {**beyond, "undistortion": "on"}}[motion]


def check_lens(config):
    """The nine numbers of the camera by which a rotation is seen; :exc:`ConfigError` where there is none that fits."""
    if not config.lens:
        raise ConfigError("motion = rotation: a calibration is needed: camera = fx,fy,cx,cy,k1,k2,p1,p2,k3, in px")
    fx, fy, cx, cy = config.calibration[:4]  # in the user's pixels, those of the sensor
    if not 0.95 < fx / fy < 1.05:
        raise ConfigError(f"motion = rotation: fx = {fx:g}, fy = {fy:g} px: they may differ by 5 %")
    first = (config.pixel - 1) / 2  # middle of the image's first column
    for name, value, size in zip(("cx", "cy"), (cx, cy), config.geometry.size, strict=True):
        last = config.pixel * (size - 1) + first
        if not first <= value <= last:
            allowed = f"{first:g} to {last:g} is needed, on the sensor"
            raise ConfigError(f"motion = rotation: {name} = {value:g} px: {allowed}")
    least = config.pixel * 2 ** ((MotionModel.curve_frac - MotionModel.curve_bits) / 2)
    if least > (fx * fy) ** 0.5:
        raise ConfigError(f"motion = rotation: f = {(fx * fy) ** 0.5:g} px: at least {least:g} px is needed")
    return config.lens
