"""Values: of ports, as integers, lists and dictionaries for the bits of a shape, and random ones; of a result."""

import itertools

import numpy as np
import torch
from amaranth.hdl import Shape, Value
from amaranth.lib import data

from cmfpga.protocol.results import fields_of
from cmfpga.protocol.shapes import REQUIRED


class Codec:
    """Bits of a shape to plain integers, lists and dictionaries, and back.

    The simulator does the same through layouts, which takes longer than the simulation itself.
    """

    def __init__(self, shape):
        self.keys = None
        if isinstance(shape, data.Layout):
            self.keys = [(key, field.offset, Codec(field.shape)) for key, field in shape]
            self.is_array = isinstance(shape, data.ArrayLayout)
        shape = Shape.cast(shape)
        self.width, self.signed = shape.width, shape.signed
        self.mask = (1 << self.width) - 1
        self.low, self.high = shape_range(shape)

    def pack(self, value):
        if self.keys is None:
            assert self.low <= value <= self.high, f"{value} does not fit {self.width} bits"
            return value & self.mask
        assert len(value) == len(self.keys)
        bits = 0
        for key, offset, codec in self.keys:
            bits |= codec.pack(value[key]) << offset
        return bits

    def unpack(self, bits):
        if self.keys is None:
            bits &= self.mask
            return bits - self.mask - 1 if self.signed and bits >> (self.width - 1) else bits
        if self.is_array:
            return [codec.unpack(bits >> offset) for _, offset, codec in self.keys]
        return {key: codec.unpack(bits >> offset) for key, offset, codec in self.keys}


class Port:
    """A signal, or a view of one, that is set to and read as plain values."""

    def __init__(self, signal):
        self.codec = Codec(signal.shape())
        self.bits = Value.cast(signal)
        if self.bits.shape().signed:
            self.bits = self.bits.as_unsigned()

    def set(self, ctx, value):
        ctx.set(self.bits, self.codec.pack(value))

    def get(self, ctx):
        return self.codec.unpack(ctx.get(self.bits))


def random_value(shape, rng):
    """Anything of this shape: what stands on wires when it must not matter."""
    if isinstance(shape, data.StructLayout):
        return {name: random_value(member, rng) for name, member in shape.members.items()}
    if isinstance(shape, data.ArrayLayout):
        return [random_value(shape.elem_shape, rng) for _ in range(shape.length)]
    low, high = shape_range(shape)
    return int(rng.integers(low, high, endpoint=True)) if high < 1 << 63 else int(rng.integers(1 << 62))


def random_values(shape, rng, count=16):
    """Endless :func:`random_value`, of which a few are computed and repeated."""
    return itertools.cycle([random_value(shape, rng) for _ in range(count)])


def shape_range(shape):
    shape = Shape.cast(shape)
    if shape.signed:
        return -(1 << (shape.width - 1)), (1 << (shape.width - 1)) - 1
    return 0, (1 << shape.width) - 1


def edge_integers(rng, low, high, count):
    """Random integers, half of them at the ends of the range or around zero."""
    edges = np.array([value for value in (low, low + 1, -1, 0, 1, high - 1, high) if low <= value <= high])
    anywhere = rng.integers(low, high, count, endpoint=True)
    return np.where(rng.random(count) < 0.5, rng.choice(edges, count), anywhere)


def random_g(config, rng):
    """A gradient G of any magnitude, zero, or at its bound."""
    if rng.random() < 0.3:
        return int(rng.choice([0, -1, 1, config.widths.g_max, -config.widths.g_max]))
    return int(2.0 ** rng.uniform(0, config.widths.g_bits - 1)) * int(rng.choice([-1, 1]))


def random_gaps(rng, count, probability):
    """Idle cycles before each of ``count`` items."""
    return np.where(rng.random(count) < probability, rng.integers(1, 5, count), 0).tolist()


def tensor(values):
    return torch.tensor(np.asarray(values, np.int64))


def required(*scopes, **values):
    """``values`` of a result, and one for each other field of the scopes that has no default."""
    return {f.name: f.nothing for f in fields_of(*scopes) if f.default is REQUIRED} | values
