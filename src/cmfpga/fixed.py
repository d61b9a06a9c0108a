"""Fixed-point formats, and the rounding and saturation rules that the whole project shares.

The functions work alike on Python integers, NumPy arrays and torch tensors; :func:`round_half_up` and
:func:`floor_shift` work on Amaranth values too, so that RTL and models cannot differ in a rounding rule.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Q:
    """A two's complement (or unsigned) fixed-point format: ``Q(5, 12)`` has 18 bits, ``Q(5, 12, signed=False)`` 17.

    Of these ``i`` are integer bits, without the sign bit; it may be negative where only small values occur. ``f`` are
    fraction bits; the step is ``2**-f``.
    """

    i: int
    f: int
    signed: bool = True

    @property
    def width(self):
        """Bits in all."""
        return self.i + self.f + int(self.signed)

    @property
    def min(self):
        """Smallest raw integer."""
        return -(1 << (self.i + self.f)) if self.signed else 0

    @property
    def max(self):
        """Largest raw integer."""
        return (1 << (self.i + self.f)) - 1

    @property
    def step(self):
        """Value of one raw unit."""
        return 2.0**-self.f

    def raw(self, value):
        """Raw integer nearest to the real number ``value`` (half up); :exc:`OverflowError` where it does not fit."""
        raw = math.floor(value * (1 << self.f) + 0.5)
        if not self.min <= raw <= self.max:
            raise OverflowError(f"{value} does not fit {self} ({self.real(self.min)} to {self.real(self.max)})")
        return raw

    def real(self, raw):
        """Real value of ``raw`` (integer or array)."""
        return raw * self.step

    def __str__(self):
        return f"{'' if self.signed else 'U'}Q{self.i}.{self.f}"


def bits_for(value):
    """Bits of an unsigned number that holds 0 to ``value``."""
    return max(1, int(value).bit_length())


def signed_bits_for(magnitude):
    """Bits of a two's complement number that holds ``-magnitude`` to ``magnitude``."""
    return int(magnitude).bit_length() + 1


def floor_shift(x, shift):
    """``floor(x / 2**shift)``; a negative ``shift`` multiplies."""
    return x >> shift if shift >= 0 else x << -shift


def half_of(shift):
    """What :func:`round_half_up` adds before it shifts: half of 2**shift, or nothing where no bit is dropped."""
    return 1 << (shift - 1) if shift > 0 else 0


def round_half_up(x, shift):
    """``floor(x / 2**shift + 1/2)``; a ``shift`` of zero or less is exact."""
    return floor_shift(x + half_of(shift), shift)


def saturate(x, low, high):
    """``x`` limited to ``low … high``. (For Amaranth values see :func:`cmfpga.rtl.arithmetic.saturate`.)"""
    if hasattr(x, "clip"):  # NumPy arrays and scalars, torch tensors
        return x.clip(low, high)
    return min(max(x, low), high)
