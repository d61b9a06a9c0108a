"""Windows that slide through a recording: how long they are, and which events each hop's window has.

In a window the image moves by :data:`WAY_PX`, which is less than a batch aims at: results overlap. What a survey of
batches found (:meth:`~cmfpga.tracking.fit.FittedCutter.survey`) says how many events that takes. Figures:
docs/sliding.md.
"""

import collections
from dataclasses import replace
from math import hypot

import numpy as np

from ..config.widths import Widths
from ..config.windows import hop_events, hop_of, window_events
from ..events import Events
from ..events.batches import Batch
from ..imaging.camera import seen
from ..imaging.iwe import events_in_roi
from ..protocol.confidence import confidence, is_judged, is_sure
from ..protocol.flags import Flag
from .ambiguity import CLEAR, best_known
from .fit import STILL_PX, FittedCutter

#: Motion of the image in a window, px; the least ``window_us``, µs, and the same in usual ranges of a window; how many
#: times fewer events than most a window has at least.
WAY_PX, LEAST_US, LONGER, FEWEST = 6.0, 60_000, 1.75, 4

#: Where few edges are seen, but sharp ones, a window is longer, up to so many times, for as many times the smallest
#: confidence. That grows with the square of the length. It is the middle one of so many windows. Where noise blurs the
#: image (below :data:`~cmfpga.tracking.ambiguity.CLEAR`) more windows would be trusted, but of these more wrong ones;
#: unless an event says half of that and κ is nearly enough.
LONGEST, RESERVE, TRIED, NEARLY = 1.6, 2.0, 3, 0.6

#: A window keeps its length while the image moves by such shares of what is aimed at; less, in so many of the hops. So
#: many times as many events are waited for; so many times the last trusted length is not passed.
ALLOWED, MOST, WAIT, REACH = (0.75, 1.25), 0.75, 2, 16


def window_lengths(config, cutter, trial, roi):
    """The settings that say how long windows and hops are: those of the configuration, or as suits the motion.

    And how far the image then moves in half a window, px; None where it is not asked for.

    A :class:`~cmfpga.tracking.fit.FittedCutter` surveys the first events in ``roi``, (x, y, width, height), unless
    ``window_events`` says it all; ``trial`` is as of its survey. Yields None where the source has no events yet.
    """
    count = window_events(config)
    least = max(config.min_roi_events, count // FEWEST)
    if config.window_events or not isinstance(cutter, FittedCutter):
        return {"window_events": count, "hop_events": hop_events(config), "min_roi_events": least}, None
    yield from cutter.survey(trial, roi)
    length = min(max(1, round(cutter.size * WAY_PX / (2 * cutter.way))), cutter.max_events)
    length = round(length * _longer(config, trial, (yield from cutter.ahead(TRIED * length)), length))
    ahead = yield from cutter.ahead(length)
    inside = len(events_in_roi(seen(config, ahead), roi[:2], *roi[2:])[0])
    thinning = _thinning(config, inside)
    inside //= thinning  # that are stored
    count = max(1, min(inside, config.buffer_events))
    span = int(ahead.t[-1] - ahead.t[0]) if len(ahead) else 0
    share = count / max(1, inside)
    return _lengths(config, count, span * share) | {"thinning": thinning}, cutter.way * length / cutter.size * share


def _lengths(config, count, span_us):
    """The settings for windows of so many events, which usually take so long."""
    oldest = config.window_us or min(1 << (config.span_bits - 1), max(LEAST_US, round(LONGER * span_us)))
    return {
        "window_events": count,
        "hop_events": min(config.hop_events or hop_of(count), count),
        "window_us": oldest,
        "hop_us": min(config.hop_us, oldest),
        "min_roi_events": max(config.min_roi_events, count // FEWEST),
    }


def _thinning(config, inside):
    """The configured one, or else so much that a window of dense texture fits the ring: a shorter one is biased."""
    fitting = min(max(1, round(inside / config.buffer_events)), Widths.thinning_max)
    return config.thinning if config.thinning > 1 else fitting


def _longer(config, trial, events, length):
    """How many times longer windows of this length are to be, by those of ``events`` in which the image moves."""
    parts = [events[at : at + length] for at in range(0, len(events) - length + 1, length)]
    moved = [one for part in parts for one in trial(part) if is_judged(one) and hypot(*one.v) > STILL_PX]
    if not moved:
        return 1.0
    found = np.median([max(confidence(config, one), 1e-9) for one in moved]) / config.confidence_limit
    if np.median([best_known(config, one) for one in moved]) < (CLEAR if found < NEARLY else CLEAR / 2):
        return 1.0
    return float(np.clip(np.sqrt(RESERVE / found), 1.0, LONGEST))


class FittedWindows:
    """How long windows are from now on, so that the image goes on moving by ``way`` px in half of one.

    Hops are counted until they have :data:`WAIT` times as many new events as a window. If the image moves by less than
    is allowed in most of them, trusted or not, windows become longer: where more edges come into sight, so many events
    take less and less time. If it moves by more in those that are trusted, they become shorter, as far as they stay
    sure. Where none is trusted and they do not move by less, they are as long as the last that was to be trusted.
    Windows that are not full, as where an object stops, become no longer. Equal results, asked for after equal numbers
    of events, give equal lengths.

    ``given`` are the settings with which a run begins. Without a ``way`` they stay.
    """

    def __init__(self, config, given, way):
        self._config, self._way, self._sure = config, way, given.window_events
        self.given, self._hops = given, []

    def add(self, result):
        """Take a hop's result."""
        full = result.roi_events > self.given.window_events - 2 * self.given.hop_events
        share = confidence(self._config, result) / self._config.confidence_limit if is_sure(result) else 0.0
        hop = hypot(*result.v), share, full, result.span, result.roi_events, result.fresh
        self._hops = [*self._hops, hop] if self._way and Flag.DEGENERATE not in result.flags else []

    def fit(self):
        """The settings of the hops that follow, once all results so far are added."""
        given, hops = self.given, np.array(self._hops).reshape(-1, 6)
        if not len(hops) or hops[:, -1].sum() < WAIT * np.median(hops[:, 4]):
            return given
        moved, share, full, span, held, _ = hops.T
        self._hops, sure, held = [], share > 0, np.median(held)
        self._sure = given.window_events if sure.any() else self._sure
        low, high = (limit * self._way for limit in ALLOWED)
        if np.quantile(moved, MOST) < low and full.all():
            length = min(held * self._way / max(np.median(moved), self._way / 2), REACH * self._sure)
        elif not sure.any() and full.all():
            length = self._sure
        elif 2 * sure.sum() > len(sure) and np.median(moved[sure]) > high:
            enough = np.sqrt(RESERVE / np.median(share[sure]))  # as in _longer
            length = held * min(max(self._way / np.median(moved[sure]), enough, 0.5), 1.0)
        else:
            return given
        least = min(FEWEST * self._config.min_roi_events, given.window_events)
        length = int(np.clip(round(length), least, self._config.buffer_events))
        self.given = replace(given, **_lengths(self._config, length, np.median(span) * length / held))
        return self.given


class Overlapping:
    """Which of a track's windows are borne out: of those so far that have time in common, two thirds are sharp.

    Windows that overlap share most of their events. Where their verdict flips from hop to hop the peak is noise's.
    """

    def __init__(self):
        self._windows = collections.deque()  # time of the last event, µs; whether it was sharp

    def bear_out(self, events, sure):
        """Whether the next window is borne out, which has these ``events`` and is ``sure``; itself counts."""
        if not len(events):
            return sure
        self._windows.append((int(events.t[-1]), sure))
        while self._windows[0][0] < events.t[0]:
            self._windows.popleft()
        return 3 * sum(one for _, one in self._windows) >= 2 * len(self._windows)


def with_those_of(passed, result):
    """``result`` with the counts of a hop before, whose result is ``passed`` over; None: of none."""
    if passed is None:
        return result
    counts = ("events", "outside", "thinned", "time_back", "hot", "noise", "fresh")
    return replace(result, **{name: getattr(passed, name) + getattr(result, name) for name in counts})


class Newest:
    """The newest events of the whole sensor, the first that comes being number ``first``.

    Hops tell where in them a window begins and ends.
    """

    def __init__(self, config, first):
        self._wrap, self._longest, self._events = 1 << config.time_bits, 1 << config.span_bits, Events.empty()
        self._marks = np.zeros((2, 0), bool)
        self._begin = self._end = first  # numbers of the first event that is kept, and of the one behind the last hop's

    def add(self, events, marks=None):
        """Events that follow the last ones; ``marks``, two bool arrays: what the filters in front drop of them."""
        self._events = Events.concatenate([self._events, events])
        marks = np.zeros((2, len(events)), bool) if marks is None else marks
        self._marks = np.concatenate([self._marks, marks], axis=1)

    @property
    def left(self):
        """How many events came after the last hop's."""
        return self._begin + len(self._events) - self._end

    def window(self, result):
        """Events of the next result's window, a :class:`Batch`, and their marks; what is older is forgotten."""
        self._end += result.events
        end = self._end - self._begin
        times, kept = self._events.t[:end], 0
        last = int(times[-1]) if end else 0
        if result.t_first is None:  # degenerate: the hop's own, and what is old enough is forgotten
            begin, kept = end - result.events, int(np.searchsorted(times, last - self._longest))
        else:
            begin = kept = int(np.searchsorted(times, last - self._age(result, last)))
        window = Batch(*(getattr(self._events, axis)[begin:end] for axis in "txyp"), self._begin + begin)
        marks = tuple(self._marks[:, begin:end])
        self._events, self._marks, self._begin = self._events[kept:], self._marks[:, kept:], self._begin + kept
        return window, marks

    def _age(self, result, last):
        """How old the window's first event was when its last one came, µs."""
        since = (result.t_us - last + self._wrap // 2) % self._wrap - self._wrap // 2
        return (result.t_us - result.t_first) % self._wrap - since
