"""Windows that slide: the newest events of an ROI, evaluated again every few of them.

A **hop** takes events in, and then evaluates the window that ends with them. All that it does follows from the sequence
of events and from the settings, never from the cycle in which an event comes. Stored events have numbers; the window of
hop k is those from b(k) to e(k), without e(k).

1. *Begin.* e(k−1) and T, the time at which hop k−1 closed, are known. So b(k) is the latest of b(k−1),
   e(k−1) + ``hop_events`` − ``window_events``, and the first event that is not older than T + ``hop_us`` −
   ``window_us``. A window that shares no event with the one before it begins its dither anew.
2. *Take in* the events that lie in the ROI. The hop closes with the ``hop_events``-th of them that is stored, or before
   the first event of the sensor, wherever it lies, whose time is T + ``hop_us`` or later; and with the
   ``max_batch_events``-th of the sensor. T becomes that event's time. An event that steps back in time is dropped.
3. *Evaluate.* Fewer than ``min_roi_events``, or a step of T by more than ``window_us``, make the window degenerate: v
   and the ROI stay. The next full window starts cold, with its own range of times as the unit of time; so does the
   first. A window is full when it holds ``window_events``, as far as its hop does, or when none has been degenerate for
   ``window_us``. Each further window starts from the last v, in px per half window, with the rounds of ``follow``:
   their unit of time is the range that the window has if its hop takes as long as the last one, so that they can begin
   with event b(k) before the others come. Events that are later count as at its end.
   Without such rounds the warm schedule runs, and the unit is the window's own range. The round of ``after`` runs
   after the result, on the same window, if v is to be judged. It moves nothing: the next result carries its sums,
   curvature and verdict.
4. *Follow.* c, the ROI's corner at the reference time, moves on by v times the step of that time. Events are cropped
   where the object is at the window's end, c + v; from the end of the *next* hop on, so that nobody waits for a result.

Whether v is to be trusted changes nothing.
"""

import collections

import numpy as np
import torch

from ...config.windows import check_lengths
from ...fixed import floor_shift, round_half_up, saturate
from ...imaging.camera import undistort
from ...protocol.flags import Flag
from ...protocol.results import BatchResult, not_judged
from ...protocol.settings import clamp_roi
from ...protocol.trace import Trace
from ..ingest import TakenIn, flags_of
from ..sequence import move_within
from .core import IntegerCore
from .event_path import time_scaler
from .roi_filter import inside

_SCAN = 4096  # events that are looked at in one go, where time ends no hop


class Sliding:
    """Events in, a :class:`BatchResult` of each hop out. :exc:`ConfigError` where a window or hop may not be so long.

    Of a result ``t_first`` is the time of the window's first event, None of a degenerate one; ``t_us`` is T, ``span``
    the unit of time, 0 of a degenerate window: v is px per half of it. ``roi`` is where the image lies, ``roi_next``
    where events are cropped from the end of the next hop on. ``roi_events`` are those of the window, of which ``fresh``
    are new, and ``late`` come after the unit's end. The other counts are those of the hop.

    ``settings.roi`` is where the first ROI lies, by default at 0, 0.
    """

    def __init__(self, config, settings):
        self.config, self.settings = config, settings
        self.core = IntegerCore(config)  #: ascends; of what it keeps between batches only v is used
        check_lengths(config, settings)
        self._oldest = settings.window_us or 1 << (config.span_bits - 1)
        #: Times, columns and rows of the stored events from the window's first on.
        self.window = tuple(np.zeros(0, np.int64) for _ in range(3))
        #: b; e, that of the one after its last so far; and the event with which the dither began.
        self.begin = self.end = self._origin = 0
        self._last_end, self._hop = 0, (settings.hop_events, settings.hop_us)  # e(k−1); limits of the hop under way
        self._counts = collections.Counter()  # of the hop's events
        self._closed = self._latest = self._renewed = None  # T; the latest event's time; T after a degenerate window
        self._step, self._t_ref, self._followed = 0, 0, False  # the first is how long the last hop took, µs
        self._judged = None  # sums, flags and fields of the round after the last result
        self._thinned = 0  # phase of the thinning
        self._frac = config.v_frac + config.dt_frac
        self._limits = tuple(axis << self._frac for axis in (config.geometry.roi_x_max, config.geometry.roi_y_max))
        corner, self._limited = clamp_roi(config, settings.roi or (0, 0))
        self._corner = tuple(at << self._frac for at in corner)
        self.crop = self._next_crop = corner  #: left column and top row of the ROI that events must lie in now

    def take_lengths(self, settings):
        """Take over how long windows are from now on; the hop under way keeps its own length."""
        check_lengths(self.config, settings)
        self.settings = self.settings.with_lengths(settings)
        self._oldest = settings.window_us or 1 << (self.config.span_bits - 1)
        if self._closed is None:
            self._hop = settings.hop_events, settings.hop_us

    def run(self, t, x, y):
        """Take events in; yields a result for each hop that closes."""
        config, given, counts = self.config, self.settings, self._counts
        size = config.roi_width, config.roi_height
        t, x, y = (np.asarray(axis, np.int64) for axis in (t, x, y))
        if not len(t):
            return
        hot, noise = self.core.noise_filter.judge(t, x, y, given)
        x, y = (np.asarray(axis, np.int64) for axis in undistort(config, given.camera, x, y))
        t, back = self._unwrapped(t)
        hot, noise = hot & ~back, noise & ~back
        lost, at = {"time_back": back, "hot": hot, "noise": noise}, 0
        good = ~(back | hot | noise)
        if self._closed is None:
            self._closed = self._renewed = int(t[0])
        while at < len(t):
            most, most_us = self._hop
            stop = int(np.searchsorted(t, self._closed + most_us)) if most_us else len(t)
            last = min(stop, at + _SCAN, at + config.max_batch_events - counts["events"])
            here = at + np.flatnonzero(good[at:last] & inside(config, x[at:last], y[at:last], self.crop, size))
            stored = here[-self._thinned % given.thinning :: given.thinning]
            room = most - (self.end - self._last_end)
            full = len(stored) >= room
            if full:
                stored, last = stored[:room], int(stored[room - 1]) + 1
                here = here[: np.searchsorted(here, last)]
            self._thinned = (self._thinned + len(here)) % given.thinning
            part = slice(at, last)
            for name, which in lost.items():
                counts[name] += int(which[part].sum())
            counts["events"] += last - at
            counts["outside"] += int(good[part].sum()) - len(here)
            counts["thinned"] += len(here) - len(stored)
            self.end += len(stored)
            self.window = tuple(
                np.concatenate([kept, axis[stored]]) for kept, axis in zip(self.window, (t, x, y), strict=True)
            )
            at = last
            if full or counts["events"] == config.max_batch_events:
                yield self._close(int(t[last - 1]))
            elif last == stop < len(t):
                yield self._close(int(t[last]))

    def _unwrapped(self, t):
        """Times that go on where the last ones ended, of each event the latest so far; and which ones step back."""
        wrap, last = 1 << self.config.time_bits, int(t[0]) if self._latest is None else self._latest
        steps = (np.diff(t, prepend=last) + wrap // 2) % wrap - wrap // 2
        times = last + np.cumsum(steps)
        latest = np.maximum.accumulate(np.maximum(times, last))
        if (latest - times).max() >= wrap // 2:  # so far back that it counts as ahead: one event after the other
            for k, one in enumerate(t.tolist()):
                times[k] = last + (one - last + wrap // 2) % wrap - wrap // 2
                latest[k] = last = max(last, int(times[k]))
        self._latest = int(latest[-1])
        return latest, times < latest

    def _close(self, now):
        """Evaluate the window that ends here, and begin the next hop."""
        config, given, step = self.config, self.settings, now - self._closed
        t_first = int(self.window[0][0]) if len(self.window[0]) else 0
        n, coming = self.end - self.begin, self._next_crop
        span = int(self.window[0][-1]) - t_first if n else 0
        stale = step > self._oldest
        judged, late, unit, corner, sums = not_judged(config), 0, 0, self.crop, None
        flags, self._limited = Flag.ROI_CLAMPED if self._limited else Flag(0), False
        # Full: all is there that a hop leaves room for, or what is older has expired.
        full = n > given.window_events - given.hop_events or now - self._renewed >= self._oldest - given.hop_us
        enough = n >= max(1, given.min_roi_events) and span > 0 and not stale
        cold = not self._followed
        self._followed = bool(enough and (full or not cold))
        if not enough:
            self._renewed = now
        trace = Trace.without_iterations(config, self.core.v)
        if self._followed:
            follows = given.follow and not cold
            if follows:  # the window's range, if its hop takes as long as the last one
                span = self._step + (self._closed - t_first if self.begin < self._last_end else 0)
            unit = int(saturate(span, 1, (1 << config.span_bits) - 1))
            plan = given.follow if follows else given.cold if cold else given.warm
            if cold:
                self.core.v = tuple(given.v_start)
            else:
                corner = self._whole(self._corner)[0]
            trace, said, found, late = self._ascend(plan, unit, corner)
            self.core.v = tuple(trace.v[-1].tolist())
            if not cold and self._judged:
                sums, verdict, found = self._judged
                said = said & ~Flag.DOUBTFUL | verdict
            flags |= said | self.core.short
            judged |= found | ({"restarted": 0} if config.confidence else {})
            flags |= self._move(t_first, unit, cold)
        else:
            flags |= Flag.DEGENERATE
        flags |= flags_of(self._counts, Flag.TIME_BACK, Flag.THINNED)
        result = BatchResult(
            t_first=t_first % (1 << config.time_bits) if self._followed else None, span=unit,
            t_us=now % (1 << config.time_bits),
            **{name: self._counts[name] for name in ("events", "outside", "thinned", "time_back", "hot", "noise")},
            time_span=0, overflow=0, roi_events=n, fresh=self.end - self._last_end, late=late, roi=corner,
            roi_next=self._next_crop, v=self.core.velocity, iterations=len(trace.sum_i), sums=sums, flags=flags,
            **judged, trace=trace,
        )  # fmt: skip
        if self._followed:
            self._judged = None
            if given.after and config.confidence and given.judge:
                after, verdict, found, _ = self._ascend(given.after, unit, corner)
                self._judged = after.last_sums, verdict & Flag.DOUBTFUL, found
        self.crop = coming
        self._step = step
        self._begin_hop(now, stale)
        return result

    def _ascend(self, plan, unit, corner):
        """``(trace, flags, fields, late)`` of these rounds or iterations, from the core's v on."""
        t, x, y = self.window
        frac = self.config.formats.event_frac
        batch = TakenIn(
            torch.from_numpy(t - t[0]),
            *(torch.from_numpy(axis - (at << frac)) for axis, at in zip((x, y), corner, strict=True)),
            {"span": unit, "roi_events": len(t)},
            phase=self.begin - self._origin,
        )
        return *self.core.ascend(batch, self.settings, plan, corner), int((t - t[0] > unit).sum())

    def _move(self, t_first, unit, cold):
        """Carry the ROI on by the core's v, unless it stands still: what the sensor limited."""
        t_ref, shift = t_first + (unit >> 1), self.config.dt_frac
        since = -1 << shift if cold else int(time_scaler(self.config, self._t_ref - t_first, span=unit))
        self._t_ref = t_ref
        if not self.settings.roi_gain:
            return Flag(0)
        start = tuple(axis << self._frac for axis in self.crop) if cold else self._corner
        self._corner, stopped = move_within(start, tuple(-v * since for v in self.core.v), self._limits)
        ahead = tuple(at + (v << shift) for at, v in zip(self._corner, self.core.v, strict=True))
        self._next_crop, limited = self._whole(ahead)
        return Flag.ROI_CLAMPED if limited or stopped else Flag(0)

    def _whole(self, position):
        """The nearest corner on the sensor, px, and whether it was limited."""
        rounded = tuple(round_half_up(axis, self._frac) for axis in position)
        return move_within(rounded, (0, 0), tuple(floor_shift(most, self._frac) for most in self._limits))

    def _begin_hop(self, now, stale):
        given, times = self.settings, self.window[0]
        old = len(times) if stale else int(np.searchsorted(times, now + given.hop_us - self._oldest))
        begin = max(self.begin + old, self.end + given.hop_events - given.window_events)
        self.window = tuple(axis[begin - self.begin :] for axis in self.window)
        self.begin = begin
        if begin == self.end:
            self._origin = begin
        self._closed, self._last_end, self._hop = now, self.end, (given.hop_events, given.hop_us)
        self._counts.clear()
