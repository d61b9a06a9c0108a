"""Lines of text, such as ``t x y p``, to columns of integers: exact decimals, and two ways of reading that agree.

:func:`parse_fast` reads a block of plain lines with NumPy, over a million lines a second, and gives up on anything
unusual. :func:`parse_line` reads one line, whatever its form, and says what is wrong with it.
"""

import io
import re
import warnings
from dataclasses import dataclass
from decimal import ROUND_HALF_DOWN, ROUND_HALF_UP, Decimal

import numpy as np

from .units import LIMIT_US

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity)", re.IGNORECASE)
# Digits before the point: enough for any time in int64, few enough for exact decimals of Python's default precision.
_MAX_DIGITS = 20
# The fast reader keeps the text of a time; a longer one is left to the other.
_TIME_BYTES = 40
_PLAIN_BYTES = b" \t\n0123456789.-"
_TO_BLANKS = bytes.maketrans(b",;\r", b"   ")


@dataclass(frozen=True)
class Layout:
    """Which of the ``fields`` of a line is which column; they count from 0."""

    t: int = 0
    x: int = 1
    y: int = 2
    p: int = 3
    fields: int = 4

    @property
    def text(self):
        """What a line needs to be, for messages: ``t x y p``."""
        names = {self.t: "t", self.x: "x", self.y: "y", self.p: "p"}
        return " ".join(names.get(k, "…") for k in range(self.fields))


PLAIN = Layout()


class LineError(ValueError):
    """What is wrong with a line, without saying where it is."""


def split_line(line):
    """Fields of a line (bytes): separated by blanks, commas or semicolons; what follows ``#`` is a comment."""
    return line.partition(b"#")[0].translate(_TO_BLANKS).decode("utf-8", "replace").split()


def parse_line(line, power, layout=PLAIN):
    """``(t, x, y, p)`` of a line (bytes), or None for an empty one or a comment.

    t is multiplied by ``10**power`` and rounded to the nearest integer, halves up. Raises :exc:`LineError` where there
    are more or fewer fields than the layout has, or a column's is not a number of its kind.
    """
    fields = split_line(line)
    if not fields:
        return None
    if len(fields) != layout.fields:
        count = f"{len(fields)} field{'s' * (len(fields) > 1)}"
        raise LineError(f"{count} in {_shown(line)}; {layout.fields} are needed ({layout.text})")
    t_text, x, y, p = (fields[k] for k in (layout.t, layout.x, layout.y, layout.p))
    number = _number("t", t_text)
    # Rounded before it is scaled: only that is exact for any number of digits.
    number = number.quantize(Decimal((0, (1,), -power)), ROUND_HALF_UP if number >= 0 else ROUND_HALF_DOWN)
    t = int(number.scaleb(power))
    if abs(t) >= LIMIT_US:
        raise LineError(f"t is {t_text[:40]}; less than 2^62 µs is allowed")
    p = {"true": "1", "false": "0"}.get(p.lower(), p)
    return t, _whole("x", x), _whole("y", y), _whole("p", p)


def _number(name, text):
    if _NOT_FINITE.fullmatch(text):
        raise LineError(f"{name} is {text}; a finite number is needed")
    if not _NUMBER.fullmatch(text):
        raise LineError(f"{name} is {_shown(text.encode())}; a number is needed")
    number = Decimal(text)
    if number and number.adjusted() >= _MAX_DIGITS:
        raise LineError(f"{name} is {text[:40]}; fewer than {_MAX_DIGITS + 1} digits before the point are allowed")
    return number


def _whole(name, text):
    number = _number(name, text)
    if number != number.to_integral_value():
        raise LineError(f"{name} is {text}; a whole number is needed")
    if abs(number) >= 1 << 63:
        raise LineError(f"{name} is {text[:40]}; a number that fits in 64 bits is needed")
    return int(number)


def _shown(line):
    text = line.strip().decode("utf-8", "replace")
    return ascii(text if len(text) <= 40 else text[:37] + "...")


def parse_fast(block, power, layout=PLAIN):
    """Columns (t, x, y, p), int64, of a block of whole lines (bytes); or None if a line needs :func:`parse_line`.

    Plain lines are numbers without exponent or plus sign, t not negative, and all but t without a point; or
    nothing but blanks. ``power`` and ``layout`` are as in :func:`parse_line`.
    """
    block = block.translate(_TO_BLANKS)
    if block.translate(None, _PLAIN_BYTES):
        return None
    if not block.strip():
        return [np.zeros(0, np.int64)] * 4
    kinds = {layout.t: f"S{_TIME_BYTES}"} | dict.fromkeys((layout.x, layout.y, layout.p), np.int64)
    kinds = [(str(k), kinds.get(k, "S1")) for k in range(layout.fields)]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # NumPy's, of whole numbers with a point
            table = np.loadtxt(io.BytesIO(block), kinds, ndmin=1)
        t = _decimals(table[str(layout.t)], power)
    except (ValueError, OverflowError, DeprecationWarning):  # more fields, or fewer, or no such numbers
        return None
    return None if t is None else [t, *(table[str(k)] for k in (layout.x, layout.y, layout.p))]


def _decimals(texts, power):
    """Values of decimals (bytes) times ``10**power``, rounded half up; None for a sign, and for too many digits."""
    whole, point, fraction = np.strings.partition(texts, b".")
    digits = np.strings.isdigit(whole) & (np.strings.isdigit(fraction) | (fraction == b""))
    if not digits.all() or np.strings.str_len(texts).max() == _TIME_BYTES:
        return None
    whole = whole.astype(np.int64)
    if power < 0:
        quotient, rest = np.divmod(whole, 10**-power)
        return None if (point == b".").any() else quotient + (2 * rest >= 10**-power)
    if whole.max() >= LIMIT_US // 10**power:
        return None
    digits = power + 1  # one more, to round
    fraction = np.strings.ljust(fraction, digits, b"0").astype(f"S{digits}").astype(np.int64)
    return whole * 10**power + (fraction + 5) // 10
