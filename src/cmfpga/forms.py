"""Forms of what files from elsewhere hold, declared as data and checked once, where a file is loaded.

A form is a :class:`Number`, a :class:`Text`, a :class:`Many`, an :class:`Array`, or a dictionary of forms by key.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

#: Numbers beyond it are no measurement; an int64 holds those up to it.
LARGEST = (1 << 63) - 1


class FormError(ValueError):
    """Something has another form; the message says where, and what is needed."""


@dataclass(frozen=True)
class Number:
    """A finite number from ``low`` to ``high``, an integer if ``kind`` is int; None too where it may be ``missing``."""

    kind: type = float
    low: float = -LARGEST
    high: float = LARGEST
    missing: bool = False

    def check(self, value, where):
        kinds = int if self.kind is int else int | float
        if isinstance(value, kinds) and not isinstance(value, bool) and self.low <= value <= self.high:
            return
        if value is not None or not self.missing:
            raise FormError(f"{where}: {'an integer' if self.kind is int else 'a number'} is needed")

    def read(self, text, where):
        """Check a number's text, which is empty where the number is missing."""
        try:
            self.check(self.kind(text) if text else None, where)
        except ValueError:
            raise FormError(f"{where}: {text[:40]!r}: {'an integer' if self.kind is int else 'a number'}") from None


@dataclass(frozen=True)
class Text:
    """A text of at most ``most`` characters, without half ones, which ``parse`` takes."""

    most: int = 1000
    parse: Callable = str

    def check(self, value, where):
        try:
            if not isinstance(value, str) or len(value) > self.most:
                raise ValueError
            self.parse(value)
            value.encode()
        except (ValueError, LookupError):
            raise FormError(f"{where}: {str(value)[:40]!r} is no text that stands here") from None

    read = check


@dataclass(frozen=True)
class Many:
    """A list of one form, of ``least`` members or more."""

    form: Any
    least: int = 0

    def check(self, value, where):
        if not isinstance(value, list) or len(value) < self.least:
            raise FormError(f"{where}: a list of {self.least} or more is needed")
        for k, one in enumerate(value):
            check(one, self.form, f"{where}[{k}]")


@dataclass(frozen=True)
class Array:
    """An array of NumPy's ``kinds``, at most ``width`` bytes an element.

    ``shape`` has lengths, and names of lengths that are equal wherever the name stands.
    """

    kinds: str
    shape: tuple = ()
    width: int = 8
    low: float = -LARGEST
    high: float = LARGEST
    gaps: bool = False  # NaN stands where there is nothing

    def head(self, array, where, lengths):
        """Check what is declared of an array that is not read yet; returns its bytes."""
        wanted = tuple(lengths.get(length, length) for length in self.shape)
        same = len(array.shape) == len(wanted) and all(
            isinstance(need, str) or size == need for size, need in zip(array.shape, wanted, strict=True)
        )
        if not same or array.dtype.kind not in self.kinds or not 0 < array.dtype.itemsize <= self.width:
            size = "×".join(map(str, wanted)) or "one"
            raise FormError(f"{where}: {size} of kind {' or '.join(self.kinds)} needed")
        lengths.update(zip(self.shape, array.shape, strict=True))
        return math.prod(array.shape) * array.dtype.itemsize

    def check(self, values, where):
        """Check the values."""
        if values.dtype.kind in "biuf":
            good = (values >= self.low) & (values <= self.high)
            if not (good | (values != values) if self.gaps else good).all():
                raise FormError(f"{where}: numbers of {self.low:g} to {self.high:g} are needed")


def check(value, form, where):
    """Check a tree, as JSON and YAML have it; raises :exc:`FormError`."""
    if form is dict:
        if not isinstance(value, dict):
            raise FormError(f"{where}: an object is needed")
        return None
    if not isinstance(form, dict):
        return form.check(value, where)
    if not isinstance(value, dict) or value.keys() != form.keys():
        raise FormError(f"{where}: exactly {', '.join(form)} are needed"[:200])
    for name, part in form.items():
        check(value[name], part, f"{where}.{name}")
