"""Lines of text, such as ``t x y p``, to columns of integers: exact decimals, and two ways of reading that agree.

:func:`parse_fast` reads a block of plain lines with NumPy, some million lines a second, and gives up on anything
unusual. :func:`parse_line` reads one line, whatever its form, and says what is wrong with it.
"""

import re
from dataclasses import dataclass
from decimal import ROUND_HALF_DOWN, ROUND_HALF_UP, Decimal

import numpy as np

from .units import LIMIT_US

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity)", re.IGNORECASE)
# Digits before the point: enough for any time in int64, few enough for exact decimals of Python's default precision.
_MAX_DIGITS = 20
# Integers of up to this many digits turn negative if they wrap in int64.
_FAST_DIGITS = 19

# What a byte is to the fast reader.
_ODD, _SPACE, _DIGIT, _DOT, _MINUS = range(5)
_CLASS = np.full(256, _ODD, np.uint8)
_CLASS[[*b" \t\r\n,;"]] = _SPACE
_CLASS[[*b"0123456789"]] = _DIGIT
_CLASS[ord(".")] = _DOT
_CLASS[ord("-")] = _MINUS


@dataclass(frozen=True)
class Layout:
    """Which field of a line is which column.

    Parameters
    ----------
    t, x, y, p : int
        Index of the field, from 0.
    fields : int
        Number of fields of a line.
    """

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
    return line.partition(b"#")[0].replace(b",", b" ").replace(b";", b" ").decode("utf-8", "replace").split()


def parse_line(line, power, layout=PLAIN):
    """``(t, x, y, p)`` of a line (bytes), or None for an empty one or a comment.

    Parameters
    ----------
    power : int
        t is multiplied by ``10**power`` and rounded to the nearest integer, halves up.
    layout : Layout
        Where the columns are; other fields are not looked at.

    Raises
    ------
    LineError
        There are more or fewer fields than the layout has, or one of them is not a number of its kind.
    """
    fields = split_line(line)
    if not fields:
        return None
    if len(fields) != layout.fields:
        raise LineError(
            f"{len(fields)} field{'s' * (len(fields) > 1)} in {_shown(line)}; "
            f"{layout.fields} are needed ({layout.text})"
        )
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
    data = np.frombuffer(block, np.uint8)
    kind = _CLASS[data]
    if not kind.all():  # some byte is odd
        return None
    blank = np.ones(len(data) + 1, bool)
    np.equal(kind, _SPACE, out=blank[1:])
    edges = np.flatnonzero(blank[1:] != blank[:-1])
    starts, ends = edges[0::2], edges[1::2]
    if len(ends) < len(starts):  # the last line has no line feed
        ends = np.append(ends, len(data))
    if len(starts) % layout.fields:
        return None
    starts, ends = starts.reshape(-1, layout.fields), ends.reshape(-1, layout.fields)
    if not _one_row_per_line(data, starts):
        return None
    minus = np.flatnonzero(kind == _MINUS)
    # A minus may only lead a field other than t; the digit loop starts behind it.
    negative = kind[starts] == _MINUS
    if np.count_nonzero(negative) != len(minus) or negative[:, layout.t].any():
        return None
    begins = starts + negative
    dots = np.flatnonzero(kind == _DOT)
    t = _decimals(data, begins[:, layout.t], ends[:, layout.t], dots, power)
    if t is None:
        return None
    columns = [t]
    for k in (layout.x, layout.y, layout.p):
        value = _integers(data, begins[:, k], ends[:, k])
        if value is None:
            return None
        columns.append(np.where(negative[:, k], -value, value) if negative[:, k].any() else value)
    return columns


def _one_row_per_line(data, starts):
    """Whether each line that is not blank has just the fields of one row of ``starts``."""
    line = np.searchsorted(np.flatnonzero(data == ord("\n")), starts)
    return bool((line[:, 0] == line[:, -1]).all() and (line[1:, 0] > line[:-1, 0]).all())


def _integers(data, begins, ends):
    """Values of the digits from ``begins`` to ``ends``; None if there are no digits or too many."""
    lengths = ends - begins
    if not len(lengths):
        return np.zeros(0, np.int64)
    if lengths.min() < 1 or lengths.max() > _FAST_DIGITS:
        return None
    value = _accumulate(data, begins, lengths)
    return None if lengths.max() == _FAST_DIGITS and value.min() < 0 else value


def _accumulate(data, begins, lengths, places=None):
    """Value of ``lengths`` digits from ``begins``. With ``places``, as if followed by zeros up to that many digits."""
    value = np.zeros(len(begins), np.int64)
    for k in range(int(lengths.max(initial=0)) if places is None else places):
        inside = k < lengths
        digit = data[np.where(inside, begins + k, 0)].astype(np.int64) - ord("0")
        if places is None:
            value = np.where(inside, 10 * value + digit, value)
        else:
            value = 10 * value + np.where(inside, digit, 0)
    return value


def _decimals(data, begins, ends, dots, power):
    """Values of decimals times ``10**power``, rounded half up; None if a point is elsewhere or digits are too many."""
    point = ends.copy()
    if len(dots):
        owner = np.searchsorted(begins, dots, side="right") - 1
        if (owner < 0).any() or (owner[1:] == owner[:-1]).any() or (dots >= ends[owner]).any():
            return None
        point[owner] = dots
    whole = _integers(data, begins, point)
    if whole is None:
        return None
    if power < 0:
        if len(dots):
            return None
        quotient, rest = np.divmod(whole, 10**-power)
        return quotient + (2 * rest >= 10**-power)
    if whole.max(initial=0) >= LIMIT_US // 10**power:
        return None
    behind = np.minimum(point + 1, ends)
    digits = ends - behind
    fraction = _accumulate(data, behind, np.minimum(digits, power + 1), places=power + 1)  # one more, to round
    return whole * 10**power + (fraction + 5) // 10
