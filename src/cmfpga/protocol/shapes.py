"""Shapes of what crosses the boundary of the hardware, and places where registers show it.

A shape is a :class:`~cmfpga.fixed.Q`, or a dictionary of shapes by the names of the parts: ``{"x": Q, "y": Q}``. A leaf
is a part that is a ``Q``; its name has the names on the way to it, joined by ``_``, as the Verilog ports have.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..fixed import Q, bits_for

#: Stands where a value has no default.
REQUIRED = object()


def always(config):
    """Where every hardware has something."""
    return True


def whole(bits):
    """An unsigned whole number of so many bits."""
    return Q(bits, 0, signed=False)


def up_to(limit):
    """A whole number from 0 to ``limit``."""
    return whole(bits_for(limit))


def pair(x, y=None):
    """Two numbers, along x and y, of one shape unless ``y`` is given."""
    return {"x": x, "y": x if y is None else y}


def leaves(name, shape):
    """``{leaf name: Q}`` of a shape, in order."""
    if isinstance(shape, Q):
        return {name: shape}
    return {leaf: q for key, part in shape.items() for leaf, q in leaves(f"{name}_{key}", part).items()}


@dataclass(frozen=True, kw_only=True)
class Place:
    """Bits of a register that show one leaf, or a part of it."""

    word: int  # number of the register in its group
    register: str = ""  # its name; by default the group's prefix and the name of the setting or result
    part: str = ""  # what the leaf's name has behind the name of the setting or result: _x
    part_lsb: int = 0  # the lowest bit of the leaf that stands here
    field: str = "VALUE"
    lsb: int = 0
    width: int = 32
    access: str = ""  # a key of registers.layout.ACCESS; by default what is usual in the group
    signed: bool | None = None  # by default as the leaf
    doc: str = ""  # by default that of the setting or result
    register_doc: str = ""  # where the register's differs
    unit: str | None = None  # by default that of the setting or result


def corner(word, **more):
    """Places of a left column and a top row in one register."""
    return (
        Place(word=word, part="_x", field="X", width=16, unit="px", doc="left column of it", **more),
        Place(word=word, part="_y", field="Y", lsb=16, width=16, unit="px", doc="top row of it", **more),
    )


@dataclass(frozen=True, kw_only=True)
class Declared:
    """A setting or a result: what its ports, its registers and its attribute follow from."""

    name: str
    shape: Callable | None = None  # shape(config)
    when: Callable = always  # when(config): the hardware has it
    shown: Callable = always  # shown(config): there is a register; none for what the ascent has no use for
    default: Any = REQUIRED  # of the attribute
    places: tuple = ()  # Place, in the register map
    doc: str = ""
    unit: str = ""

    def shape_of(self, config):
        """The port's shape."""
        return self.shape(config)

    def doc_of(self, config):
        """``(doc, unit)``."""
        return self.doc, self.unit

    def limits(self, config, leaf, part):
        """Smallest and largest raw value of a leaf that a register allows; None: whatever fits."""
        return None, None

    def reset_of(self, config, q, high):
        """A register's raw value after a reset."""
        return 0


def record(name, module, declared):
    """A dataclass of ``declared``, each a field with its default."""
    members = [
        (one.name, Any) if one.default is REQUIRED else (one.name, Any, dataclasses.field(default=one.default))
        for one in declared
    ]
    return dataclasses.make_dataclass(name, members, namespace={"__module__": module}, frozen=True, kw_only=True)
