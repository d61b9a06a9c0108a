"""Schedules of the sign ascent: which pixel size, which step and which of the events each iteration uses.

A schedule is written as entries ``LEVEL:LOG2STEP``, with ``/STRIDE`` and ``*COUNT`` where they are not 1, separated by
blanks: ``2:1/4*3 0:-5`` is three iterations with pixels 4 px wide, a step of 2 px per half batch and every fourth
event, then one with full resolution, a step of 1/32 and all events.
``auto`` is the schedule that was measured best, as far as the hardware's levels and format of v allow it.
"""

import re
from typing import NamedTuple

from ..errors import ConfigError
from .derived import Derived

AUTO = "auto"

# Measured best on synthetic and real batches; see docs/accuracy.md and docs/motion.md.
MEASURED = {
    "translation": {
        "cold": "2:2/4 2:1/4*2 2:0/4*2 2:-1/4 1:0/2 1:-1/2*2 1:-2/2 1:-2 1:-3*3 0:-4",
        "warm": "1:-1/2 1:-2/2 1:-2 1:-3*2 0:-4",
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

_ENTRY = re.compile(r"(\d{1,9}):(-?\d{1,9})(?:/(\d{1,9}))?(?:\*(\d{1,9}))?")


class ScheduleEntry(NamedTuple):
    """One iteration: pixels are 2^level px wide, v moves by 2^log2_step px per half batch along each axis.

    It uses every ``stride``-th of the stored events (:data:`STRIDES`), as far as there are enough: :func:`used`.
    """

    level: int
    log2_step: int
    stride: int = 1


def used(entry, iteration, n):
    """Which of ``n`` stored events an iteration uses: a slice.

    Parameters
    ----------
    entry : ScheduleEntry
    iteration : int
        Its number in the batch, from 0. Successive ones begin at another event, the farthest first: 0, 2, 1, 3.
    n : int
        The stride is halved until it leaves :data:`FEWEST`, rounded down.
    """
    stride = entry.stride
    while stride > 1 and n < FEWEST * stride:
        stride //= 2
    return slice((0, 2, 1, 3)[iteration % 4] * stride // 4, None, stride)


def used_events(plan, n):
    """How many of ``n`` stored events each iteration of ``plan``, entries as in :func:`used`, uses: list of int."""
    return [len(range(n)[used(entry, k, n)]) for k, entry in enumerate(plan)]


def parse_schedule(text, *, name, max_level, v, entries, motion="translation"):
    """The iterations of a schedule, a tuple of :class:`ScheduleEntry`.

    Parameters
    ----------
    text : str
        See above.
    name : str
        ``cold`` or ``warm``: for messages, and for ``auto``.
    max_level : int
        Largest level that the hardware has.
    v : Q
        Format of v: steps from its unit to half its range.
    entries : int
        Length of the hardware's table.
    motion : str
        For ``auto``.

    Raises
    ------
    ConfigError
        The text is malformed or empty, too long, or has a level, step or stride out of range.
    """
    auto = text == AUTO
    iterations = []
    for word in (MEASURED[motion][name] if auto else text).split():
        match = _ENTRY.fullmatch(word)
        if not match:
            raise ConfigError(f"{name}: {word!r}: LEVEL:LOG2STEP/STRIDE*COUNT is needed, /STRIDE and *COUNT if not 1")
        level, log2_step, stride, count = (int(number or 1) for number in match.groups())
        if auto:
            level, log2_step = min(level, max_level), max(-v.f, min(log2_step, v.i - 1))
        if level > max_level:
            raise ConfigError(f"{name}: {word!r}: level 0 to {max_level} is needed (max_level)")
        if not -v.f <= log2_step < v.i:
            raise ConfigError(f"{name}: {word!r}: a log2 step of {-v.f} to {v.i - 1} is needed ({v})")
        if stride not in STRIDES:
            raise ConfigError(f"{name}: {word!r}: a stride of {', '.join(map(str, STRIDES))} is needed")
        if not 1 <= count <= entries:
            raise ConfigError(f"{name}: {word!r}: a count of 1 to {entries} is needed (schedule_entries)")
        iterations += [ScheduleEntry(level, log2_step, stride)] * count
    if not 1 <= len(iterations) <= entries:
        raise ConfigError(f"{name}: {len(iterations)} iterations: 1 to {entries} are needed (schedule_entries)")
    return tuple(iterations)


class Schedules(Derived):
    """The schedules that a configuration asks for."""

    def _parse(self, name):
        limits = {"max_level": self._c.max_level, "v": self._c.formats.v, "entries": self._c.schedule_entries}
        limits["motion"] = self._c.motion
        return parse_schedule(getattr(self._c, name), name=name, **limits)

    @property
    def cold(self):
        """Iterations of a batch without a last v: tuple of :class:`ScheduleEntry`."""
        return self._parse("cold")

    @property
    def warm(self):
        """Iterations of a batch that starts from the last v."""
        return self._parse("warm")

    def check(self):
        """Raise :exc:`ConfigError` unless the hardware can hold them and count to their lengths."""
        lengths = {"cold": len(self.cold), "warm": len(self.warm)}
        if sum(lengths.values()) > self._c.schedule_entries:
            raise ConfigError(
                f"cold and warm: {lengths['cold']} + {lengths['warm']} iterations; "
                f"at most {self._c.schedule_entries} are allowed in all (schedule_entries)"
            )
        for name, iterations in lengths.items():
            if iterations > self._c.max_iterations:
                raise ConfigError(
                    f"{name}: {iterations} iterations; at most {self._c.max_iterations} are allowed (max_iterations)"
                )
