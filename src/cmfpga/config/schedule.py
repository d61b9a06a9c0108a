"""Schedules: which pixel size, which step and which of the events each iteration uses.

A schedule is written as entries, separated by blanks, with ``*COUNT`` where it is not 1. Those of a translation are
rounds, ``LEVEL:H:LIMIT``: ``1:3/4:1 0:3/4:1/16`` is a round with pixels 2 px wide, which evaluates 3/4 px per half
batch beside v and moves v by at most 1 along each axis, then one with full resolution that moves it by at most 1/16.

Those of other motions are steps, ``LEVEL:LOG2STEP``, with ``/STRIDE`` where it is not 1: ``2:1/4*3 0:-5`` is three
iterations with pixels 4 px wide, a step of 2 px per half batch and every fourth event, then one with full resolution, a
step of 1/32 and all events.

``auto`` is the schedule that was measured best, as far as the hardware's levels and format of v allow it.
"""

import re
from fractions import Fraction
from typing import NamedTuple

from ..errors import ConfigError

AUTO = "auto"

# Measured best on synthetic and real batches; see docs/accuracy.md and docs/motion.md.
MEASURED = {
    "translation": {
        "cold": "2:3:4 2:2:3 2:3/2:2 1:1:1 0:3/4:1/4",
        "warm": "1:1:3/2 1:3/4:1 0:3/4:1/8",
        "follow": "1:3/4:1",
        "after": "0:3/4:1/16",
    },
    "similarity": {
        "cold": "2:1*3 2:0*4 2:-1*4 2:-2 1:-1*2 1:-2*3 0:-3*3 0:-4*2 0:-5*2",
        "warm": "2:-1/2*2 1:-1/2*2 1:-2*2 0:-3*2 0:-4*2 0:-5",
    },
    "rotation": {
        "cold": "3:2/4*2 3:1/4*2 3:0/4*2 2:0/4*2 2:-1/4*2 1:-1/4*2 1:-2/2*2 1:-3/2*2 "
        "0:-3/2*2 0:-4/2*2 0:-4*2 0:-5*2 0:-6",
        "warm": "2:0/4*2 2:-1/4*2 1:-1/4*2 1:-2/4*2 0:-2/4 0:-3/4*2 0:-4/2*2 0:-5",
    },
}

#: Every so many of the stored events.
STRIDES = (1, 2, 4)
#: A stride leaves at least about so many events, or it is halved.
FEWEST = 128

#: How far beside v a round evaluates, in quarters of a px per half batch, in the order of the hardware's numbers.
DISTANCES = (3, 4, 6, 8, 12)

_ENTRY = re.compile(r"(\d{1,9}):(-?\d{1,9})(?:/(\d{1,9}))?(?:\*(\d{1,9}))?")
_ROUND = re.compile(r"(\d{1,9}):(\d{1,9}(?:/[1-9]\d{0,8})?):(\d{1,9}(?:/[1-9]\d{0,8})?)(?:\*(\d{1,9}))?")


class ScheduleEntry(NamedTuple):
    """One iteration: pixels are 2^level px wide, v moves by 2^log2_step px per half batch along each axis.

    It uses every ``stride``-th of the stored events (:data:`STRIDES`), as far as there are enough: :func:`used`.
    """

    level: int
    log2_step: int
    stride: int = 1


class Round(NamedTuple):
    """One round of ``ascent = newton``: four evaluations ``distance``/4 px per half batch beside v, then a step.

    ``limit``: v moves by so much at most along each axis, px per half batch: 2^k or 1½·2^k, exact in binary.
    """

    level: int
    distance: int
    limit: float

    stride = 1  # all events

    def code(self, v):
        """The limit as the hardware's table has it: its raw value in ``v``, a Q, is ((2 + c mod 2) << c div 2) >> 1."""
        raw = int(self.limit * (1 << v.f))
        top = raw.bit_length() - 1
        return 2 * top + (raw != 1 << top)


def used(entry, iteration, n):
    """Which of ``n`` stored events an iteration uses: a slice.

    ``iteration`` is its number in the batch, from 0. Successive ones begin at another event, the farthest first: 0, 2,
    1, 3. The stride is halved until it leaves :data:`FEWEST`, rounded down.
    """
    stride = entry.stride
    while stride > 1 and n < FEWEST * stride:
        stride //= 2
    return slice((0, 2, 1, 3)[iteration % 4] * stride // 4, None, stride)


def used_events(plan, n):
    """How many of ``n`` stored events each iteration of ``plan``, entries as in :func:`used`, uses: list of int."""
    return [len(range(n)[used(entry, k, n)]) for k, entry in enumerate(plan)]


def _sign_entry(word, match, *, name, v, auto):
    """:class:`ScheduleEntry` and count of a word, and its level apart."""
    level, log2_step, stride, count = (int(number or 1) for number in match.groups())
    if auto:
        log2_step = max(-v.f, min(log2_step, v.i - 1))
    if not -v.f <= log2_step < v.i:
        raise ConfigError(f"{name}: {word!r}: a log2 step of {-v.f} to {v.i - 1} is needed ({v})")
    if stride not in STRIDES:
        raise ConfigError(f"{name}: {word!r}: a stride of {', '.join(map(str, STRIDES))} is needed")
    return ScheduleEntry(level, log2_step, stride), count


def _round(word, match, *, name, v, auto):
    """:class:`Round` and count of a word."""
    level, distance, limit, count = match.groups()
    distance, limit = 4 * Fraction(distance), Fraction(limit) * (1 << v.f)
    if distance not in DISTANCES:
        allowed = ", ".join(str(Fraction(one, 4)) for one in DISTANCES)
        raise ConfigError(f"{name}: {word!r}: a distance of {allowed} is needed")
    most = 1 << v.f + v.i - 1
    if auto:
        limit = min(max(limit, 1), most)
    odd = limit.numerator >> ((limit.numerator & -limit.numerator).bit_length() - 1) if limit else 0
    if limit.denominator > 1 or odd not in (1, 3) or limit > most:
        least = Fraction(1, 1 << v.f)
        raise ConfigError(f"{name}: {word!r}: a limit of 2^k or 3·2^k is needed, {least} to {1 << v.i - 1} ({v})")
    return Round(int(level), int(distance), int(limit) / (1 << v.f)), int(count or 1)


#: By whether entries are rounds: how a word looks, what it makes, and what to say of one that looks otherwise.
_FORMS = {
    False: (_ENTRY, _sign_entry, "LEVEL:LOG2STEP/STRIDE*COUNT is needed, /STRIDE and *COUNT if not 1"),
    True: (_ROUND, _round, "LEVEL:H:LIMIT*COUNT is needed, *COUNT if not 1; H and LIMIT such as 1 or 3/4"),
}


def parse_schedule(text, *, name, max_level, v, entries, motion="translation", least=1):
    """The iterations of the schedule ``text`` of a ``motion``: a tuple of :class:`ScheduleEntry`, or of :class:`Round`.

    ``name`` (cold, warm, follow or after) is for messages, and for ``auto``. The hardware has levels up to
    ``max_level`` and a table of ``entries``. Steps go from the unit of ``v``, a :class:`~cmfpga.fixed.Q`, to half its
    range. Raises :exc:`ConfigError` where the text is malformed, has fewer than ``least`` iterations, or too many, or a
    level, step or stride out of range.
    """
    auto = text == AUTO
    form, make, needed = _FORMS[motion == "translation"]
    iterations = []
    for word in (MEASURED[motion].get(name, "") if auto else text).split():
        match = form.fullmatch(word)
        if not match:
            raise ConfigError(f"{name}: {word!r}: {needed}")
        level = int(match[1])
        if level > max_level and not auto:
            raise ConfigError(f"{name}: {word!r}: level 0 to {max_level} is needed (max_level)")
        entry, count = make(word, match, name=name, v=v, auto=auto)
        if not 1 <= count <= entries:
            raise ConfigError(f"{name}: {word!r}: a count of 1 to {entries} is needed (schedule_entries)")
        iterations += [entry._replace(level=min(level, max_level))] * count
    if not least <= len(iterations) <= entries:
        raise ConfigError(f"{name}: {len(iterations)} iterations: {least} to {entries} are needed (schedule_entries)")
    return tuple(iterations)


class Schedules:
    """The schedules that a :class:`~cmfpga.config.Config` asks for: tuples of iterations."""

    def __init__(self, config):
        def parse(name, least=0):
            limits = {"max_level": config.max_level, "v": config.formats.v, "entries": config.schedule_entries}
            return parse_schedule(getattr(config, name), name=name, motion=config.motion, least=least, **limits)

        self.cold = parse("cold", 1)  #: of a batch without a last v
        self.warm = parse("warm", 1)  #: of a batch that starts from the last v
        #: Rounds of a window that slides, which begin before its last event; () if none do.
        self.follow = parse("follow") if config.slides else ()
        self.after = parse("after") if config.slides else ()  #: judges it, after its result
