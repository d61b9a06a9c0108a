"""Units of time: which one a recording uses, and the conversion to whole microseconds.

The unit is, in this order:

1. what the caller gives (``time_unit=``),
2. what the file says (an attribute such as ``unit = "microseconds"``),
3. where any of the first 65,536 time stamps (of text: 1,000) has a fractional part, the first of s, ms and µs that
   gives a time before the year 5,000 and, given 1,000 events, 100 to 10^8 events/s; not s, where all time stamps are
   multiples of 0.001 apart (a clock of 1 µs written in ms), with at least 100 different ones; s where none does,
4. for whole numbers (floats without fractions included), judged by the same first time stamps:

   ======  ==========================================================================================
   ns      a time stamp of 10^17 or more (3,000 years in µs); or, given 1,000 events, fewer than 100
           events/s if read as µs; or all time stamps are multiples of 1,000 apart (a clock of 1 µs
           written in ns), with at least 100 different ones and at most 10^8 events/s if read as ns
   ms      given 10,000 events, more than 10^8 events/s if read as µs (no sensor sends that many)
   µs      otherwise
   ======  ==========================================================================================

The rate is that of the median step from one time stamp to the next different one, so a jump or a pause does not count.
Whole seconds are never assumed: they are too coarse for events. The rule of step 4 can err for scenes that are
almost at rest, so a recording says where its unit comes from (``time_unit_source``), and the tools tell a guess.
"""

import math

import numpy as np

from ..errors import RecordingError

TIME_UNITS = ("s", "ms", "us", "ns")

# Power of ten that turns a time in the unit into µs.
POWER = {"s": 6, "ms": 3, "us": 0, "ns": -3}

# Times of this many µs and more, of either sign, are refused: differences of two times fit in int64.
LIMIT_US = 1 << 62

# Events that the rule of the module looks at.
SAMPLE_EVENTS = 1 << 16

_LARGEST_US = 10**17
_MIN_RATE, _MIN_RATE_EVENTS = 100, 1_000
_MAX_RATE, _MAX_RATE_EVENTS = 10**8, 10_000
_MIN_TICKS = 100

_SPELLINGS = {
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "millisecond", "milliseconds"),
    "us": ("us", "µs", "μs", "usec", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nanosecond", "nanoseconds"),
}
_BY_SPELLING = {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings}


def parse_unit(text, where):
    """One of ``TIME_UNITS`` for a unit as people write it; :exc:`RecordingError` for anything else."""
    if isinstance(text, bytes):
        text = text.decode("utf-8", "replace")
    unit = find_unit(text) if isinstance(text, str) else None
    if unit is None:
        raise RecordingError(f"{where}: time unit {text!r} is not known; one of {', '.join(TIME_UNITS)} is needed")
    return unit


def find_unit(text):
    """One of ``TIME_UNITS`` for a unit as people write it, or None for anything else."""
    return _BY_SPELLING.get((text or "").strip().lower())


def guess_unit(t):
    """Unit of the time stamps ``t``, the first ones of a recording (numbers, as stored), by steps 3 and 4 above."""
    t = np.asarray(t)[:SAMPLE_EVENTS]
    if t.dtype.kind == "f":
        t = t[np.isfinite(t)]  # the checks report the others
    if not len(t):
        return "us"
    steps = np.diff(t)
    steps = steps[steps > 0]
    ticks = len(steps) + 1
    # Of events that come at random, the median step is ln 2 of the mean.
    us_rate = len(t) / ticks * math.log(2) * 1e6 / np.median(steps) if len(steps) else math.inf
    if t.dtype.kind == "f" and (t != np.floor(t)).any():
        return _guess_of_fractions(t, steps, us_rate)
    if max(abs(int(t.min())), abs(int(t.max()))) >= _LARGEST_US:
        return "ns"
    if len(t) >= _MAX_RATE_EVENTS and us_rate > _MAX_RATE:
        return "ms"
    if len(t) >= _MIN_RATE_EVENTS and len(steps):
        in_thousands = not (steps % 1000).any() and ticks >= _MIN_TICKS and us_rate * 1000 <= _MAX_RATE
        if us_rate < _MIN_RATE or in_thousands:
            return "ns"
    return "us"


def _guess_of_fractions(t, steps, us_rate):
    """Step 3: ``steps`` between time stamps that differ; ``us_rate`` in events/s, if they are read as µs."""
    least, known = float(np.abs(t).min()), len(t) >= _MIN_RATE_EVENTS and len(steps) > 0
    # What rounding may leave of a multiple; where that is much, nothing can be told.
    rest = max(2e3 * np.spacing(float(np.abs(t).max())), 1e-6)
    thousandths = steps * 1e3
    in_thousandths = (
        rest < 0.05 and len(steps) + 1 >= _MIN_TICKS and (np.abs(thousandths - np.rint(thousandths)) <= rest).all()
    )
    for unit in ("s", "ms", "us"):
        scale = 10.0 ** POWER[unit]
        plausible = not known or _MIN_RATE <= us_rate / scale <= _MAX_RATE
        if least * scale < _LARGEST_US and plausible and not (unit == "s" and known and in_thousandths):
            return unit
    return "s"


def to_us(t, unit, where, first_event=0):
    """Time stamps ``t`` (integers or floats, in ``unit``) as int64 µs, rounded to the nearest, halves up.

    Integers are converted exactly; floats to the precision of float64. Raises :exc:`RecordingError` where a time stamp
    is NaN, infinite, or beyond ±2^62 µs; the message starts with ``where`` and names the index of the event,
    ``first_event`` being that of ``t[0]``.
    """
    t = np.asarray(t)
    power = POWER[unit]

    def say(needed):
        return lambda k: f"{where}: time stamp of event {first_event + k} is {t[k]}{needed}"

    out_of_range = say(f" {unit}; less than 2^62 µs is allowed")
    if t.dtype.kind == "f":
        refuse(~np.isfinite(t), say("; a finite number is needed"))
        scaled = np.floor(t.astype(np.float64) * 10.0**power + 0.5)
        refuse(np.abs(scaled) >= LIMIT_US, out_of_range)
        return scaled.astype(np.int64)
    limit = (LIMIT_US - 1) // 10 ** max(power, 0)
    refuse((t > limit) | (t < -limit), out_of_range)
    t = t.astype(np.int64)
    if power >= 0:
        return t * 10**power
    quotient, rest = np.divmod(t, 10**-power)
    return quotient + (2 * rest >= 10**-power)


def refuse(bad, say):
    """Raises the :exc:`RecordingError` of ``say(k)`` for the first ``k`` at which ``bad``, a bool array, holds."""
    if bad.any():
        raise RecordingError(say(int(bad.argmax())))
