"""Windows that slide: the newest events of an ROI, evaluated again every few of them.

A **hop** takes events in, and then evaluates the window that ends with them. All that it does follows from the sequence
of events and from the settings, never from the cycle in which an event comes. Stored events have numbers; the window of
hop k is those from b(k) to e(k), without e(k).

1. *Begin.* e(k−1) and T, the time at which hop k−1 closed, are known. So b(k) is the latest of b(k−1),
   e(k−1) + ``hop_events`` − ``window_events``, and the first event that is not older than T + ``hop_us`` −
   ``window_us``. A window that shares no event with the one before it begins its dither anew.
2. *Take in* the events that lie in the ROI. The hop closes with the ``hop_events``-th of them, or before the first
   event of the sensor, wherever it lies, whose time is T + ``hop_us`` or later. T becomes that event's time.
3. *Evaluate.* Fewer than ``min_roi_events``, or a step of T by more than ``window_us``, make the window degenerate: v
   and the ROI stay. The next full window starts cold, with its own range of times as the unit of time; so does the
   first. A window is full when it holds ``window_events``, as far as its hop does, or when none has been degenerate for
   ``window_us``. Each further window starts from the last v, in px per half window, with the rounds of ``follow``:
   their unit of time is the range that the window has if its hop takes as long as the last one, so that they can begin
   with event b(k) before the others come. Events that are later count as at its end.
   Without such rounds the warm schedule runs, and the unit is the window's own range. The rounds of ``after`` run
   after the result, on the same window. Either they judge: v stays, and the next result carries their sums, curvature
   and verdict; or they search: they move only the v from which the next hop starts.
4. *Follow.* c, the ROI's corner at the reference time, moves on by v times the step of that time. Events are cropped
   where the object is at the window's end, c + v; from the end of the *next* hop on, so that nobody waits for a result.

Whether v is to be trusted changes nothing.
"""

from dataclasses import dataclass

import numpy as np
import torch

from ...errors import ConfigError
from ...fixed import floor_shift, round_half_up, saturate
from ...imaging.camera import undistort
from ...protocol.flags import Flag
from ...protocol.results import RegionOutcome, not_judged
from ...protocol.trace import Trace
from ..ingest import TakenIn
from .core import IntegerCore
from .time_scaler import time_scaler

_SCAN = 4096  # events that are looked at in one go, where time ends no hop


@dataclass(frozen=True, kw_only=True)
class HopSettings:
    """How windows slide.

    Parameters
    ----------
    window_events, hop_events : int
        Most events of a window, and of a hop. Equal ones make windows that share no event.
    window_us, hop_us : int
        How old events are at most, µs, 0: half of what a span counts to; and how long a hop takes, 0: any time.
    follow : tuple of Round
        Rounds of a hop whose centre is the last v; () runs the warm schedule after the last event instead.
    after : tuple of Round
        Rounds after each result.
    judges : bool
        Those judge; else they search.
    """

    window_events: int
    window_us: int = 0
    hop_events: int
    hop_us: int = 0
    follow: tuple = ()
    after: tuple = ()
    judges: bool = False


@dataclass(frozen=True, kw_only=True)
class Hop:
    """What a hop found.

    Parameters
    ----------
    begin, end : int
        Numbers of the window's first event, and of the one after its last.
    t_us : int
        When it closed, µs.
    t_first, t_last : int
        Times of its first and last event, µs; 0 of none.
    unit : int
        v is px per half of this, µs; 0 of a degenerate window.
    late : int
        Events after the unit's end, whose scaled time is limited to that.
    outcome : RegionOutcome
        ``roi`` is where the image lies, ``roi_next`` where events are cropped from the end of the next hop on.
    """

    begin: int
    end: int
    t_us: int
    t_first: int
    t_last: int
    unit: int
    late: int
    outcome: RegionOutcome

    @property
    def v_px_per_s(self):
        """(vx, vy); None of a degenerate window."""
        return tuple(2e6 * axis / self.unit for axis in self.outcome.v) if self.unit else None


class Sliding:
    """Events in, hops out.

    Parameters
    ----------
    config : Config
    roi : pair of int
        Left column and top row of the first ROI.
    hops : HopSettings

    Attributes
    ----------
    core : IntegerCore
        Ascends; of what it keeps between batches only v is used.
    crop : pair of int
        Left column and top row of the ROI that events must lie in now.
    window : three int64 arrays
        Times, columns and rows of the stored events from the window's first on.

    Raises
    ------
    ConfigError
        A window or hop has a length that the configuration does not allow.
    """

    def __init__(self, config, roi, hops):
        self.config, self.hops, self.core = config, hops, IntegerCore(config)
        oldest = 1 << (config.span_bits - 1)
        for name, high in (
            ("window_events", config.buffer_events), ("hop_events", hops.window_events), ("window_us", oldest),
            ("hop_us", hops.window_us or oldest),
        ):  # fmt: skip
            if not (low := int(name.endswith("events"))) <= (value := getattr(hops, name)) <= high:
                raise ConfigError(f"{name} = {value}: {low} to {high} is needed")
        self._oldest = hops.window_us or oldest
        self.window = tuple(np.zeros(0, np.int64) for _ in range(3))
        self._begin = self._end = self._origin = 0  # b, e, and the event with which the dither began
        self._last_end = 0  # e(k−1)
        self._found = self._outside = self._back = 0  # of this hop: in the ROI, not thinned out yet; and others
        self._closed = self._latest = self._fresh = None  # T; the latest event's time; T after a degenerate window
        self._step, self._t_ref, self._followed = 0, 0, False  # the first is how long the last hop took, µs
        self._judged = None  # sums, flags and fields of the rounds after the last result, if they judge
        self._thinned = 0  # phase of the thinning
        self._frac = config.v_frac + config.dt_frac
        size = config.geometry.roi_x_max, config.geometry.roi_y_max
        self._limits = tuple(axis << self._frac for axis in size)
        self._corner = tuple(int(saturate(at, 0, most)) << self._frac for at, most in zip(roi, size, strict=True))
        self.crop = self._next_crop = self._whole(self._corner)[0]

    def run(self, t, x, y, settings):
        """Take events in; yields a :class:`Hop` for each that closes. ``settings``: :class:`BatchSettings`."""
        config, hops = self.config, self.hops
        t, x, y = (np.asarray(axis, np.int64) for axis in (t, x, y))
        if not len(t):
            return
        dropped = np.logical_or(*self.core.noise_filter.judge(t, x, y, settings))
        x, y = (np.asarray(axis, np.int64) for axis in undistort(config, settings.camera, x, y))
        t, back = self._unwrapped(t)
        if self._closed is None:
            self._closed = self._fresh = int(t[0])
        good = ~(back | dropped)
        t, x, y, at = t[good], x[good], y[good], 0
        self._back += int(back.sum())
        while at < len(t):
            due = self._closed + hops.hop_us
            stop = int(np.searchsorted(t, due)) if hops.hop_us else len(t)
            last = min(stop, at + _SCAN)
            inside = at + np.flatnonzero(self._inside(x[at:last], y[at:last]))
            stored = inside[-self._thinned % settings.thinning :: settings.thinning]
            room = hops.hop_events - (self._end - self._last_end)
            full = len(stored) >= room
            if full:
                stored, last = stored[:room], int(stored[room - 1]) + 1
                inside = inside[: np.searchsorted(inside, last)]
            self._thinned = (self._thinned + len(inside)) % settings.thinning
            self._found += len(inside)
            self._outside += last - at - len(inside)
            self._end += len(stored)
            self.window = tuple(
                np.concatenate([kept, axis[stored]]) for kept, axis in zip(self.window, (t, x, y), strict=True)
            )
            at = last
            if full or (last == stop < len(t)):
                yield self._close(int(t[last - 1 if full else last]), settings)

    def _unwrapped(self, t):
        """Times that go on where the last ones ended, and which events step back."""
        wrap, last = 1 << self.config.time_bits, int(t[0]) if self._latest is None else self._latest
        t = last + (t - last + wrap // 2) % wrap - wrap // 2
        latest = np.maximum.accumulate(np.maximum(t, last))
        self._latest = int(latest[-1])
        return t, t < latest

    def _inside(self, x, y):
        frac, size = self.config.formats.event_frac, (self.config.roi_width, self.config.roi_height)
        half = (1 << frac) >> 1
        at = ((axis + half >> frac) - corner for axis, corner in zip((x, y), self.crop, strict=True))
        return np.logical_and(*((axis >= 0) & (axis < most) for axis, most in zip(at, size, strict=True)))

    def _close(self, now, settings):
        """Evaluate the window that ends here, and begin the next hop."""
        hops, t_first, step = self.hops, int(self.window[0][0]) if len(self.window[0]) else 0, now - self._closed
        n, coming = self._end - self._begin, self._next_crop
        span = int(self.window[0][-1]) - t_first if n else 0
        stale = step > self._oldest
        judged, flags, late, unit, corner, sums = not_judged(self.config), Flag(0), 0, 0, self.crop, None
        # Full: all is there that a hop leaves room for, or what is older has expired.
        full = n > hops.window_events - hops.hop_events or now - self._fresh >= self._oldest - hops.hop_us
        enough = n >= max(1, settings.min_roi_events) and span > 0 and not stale
        cold = not self._followed
        self._followed = bool(enough and (full or not cold))
        if not enough:
            self._fresh = now
        trace = Trace.without_iterations(self.config, self.core.v)
        if self._followed:
            follows = hops.follow and not cold
            unit = self._ahead(t_first) if follows else span
            unit = int(saturate(unit, 1, (1 << self.config.span_bits) - 1))
            plan = hops.follow if follows else self.config.ascent_rule.plan(settings, not cold)
            if cold:
                self.core.v = tuple(settings.v_start)
            else:
                corner = self._whole(self._corner)[0]
            trace, flags, found, late = self._ascend(plan, unit, corner, settings)
            self.core.v = tuple(trace.v[-1].tolist())
            if follows and self._judged:
                sums, verdict, found = self._judged
                flags = flags & ~Flag.DOUBTFUL | verdict
            judged |= found | ({"restarted": 0} if self.config.confidence else {})
            flags |= self._move(t_first, unit, cold, settings)
        else:
            flags |= Flag.DEGENERATE
        outcome = RegionOutcome(
            roi_events=n,
            outside=self._outside,
            overflow=0,
            thinned=self._found - (self._end - self._last_end),
            roi=corner,
            roi_next=self._next_crop,
            v=self.core.velocity,
            iterations=len(trace.sum_i),
            sums=sums,
            flags=flags | (Flag.TIME_BACK if self._back else Flag(0)),
            **judged,
            trace=trace,
        )
        hop = Hop(
            begin=self._begin,
            end=self._end,
            t_us=now,
            t_first=t_first,
            t_last=t_first + span,
            unit=unit,
            late=late,
            outcome=outcome,
        )
        if self._followed:
            self._judged = None
            if hops.after:
                after, verdict, found, _ = self._ascend(hops.after, unit, corner, settings)
                if hops.judges:
                    self._judged = after.last_sums, verdict & Flag.DOUBTFUL, found
                else:
                    self.core.v = tuple(after.v[-1].tolist())
        self.crop = coming
        self._step = step
        self._begin_hop(now, stale)
        return hop

    def _ahead(self, t_first):
        """The range of the window, if its hop takes as long as the last one."""
        return self._step + (self._closed - t_first if self._begin < self._last_end else 0)

    def _ascend(self, plan, unit, corner, settings):
        """``(trace, flags, fields, late)`` of these rounds or iterations, from the core's v on."""
        t, x, y = self.window
        frac, n = self.config.formats.event_frac, len(t)
        batch = TakenIn(
            torch.from_numpy(t - t[0]),
            *(torch.from_numpy(axis - (at << frac)) for axis, at in zip((x, y), corner, strict=True)),
            {"span": unit, "roi_events": n},
            Flag(0),
            None,
            phase=self._begin - self._origin,
        )
        return *self.core.ascend(batch, settings, plan, corner), int((t - t[0] > unit).sum())

    def _move(self, t_first, unit, cold, settings):
        """Carry the ROI on by the core's v, unless it stands still: what the sensor limited."""
        t_ref, shift = t_first + (unit >> 1), self.config.dt_frac
        since = -1 << shift if cold else int(time_scaler(self.config, self._t_ref - t_first, span=unit))
        self._t_ref = t_ref
        if not settings.roi_gain:
            return Flag(0)
        start = tuple(axis << self._frac for axis in self.crop) if cold else self._corner
        target = tuple(at - v * since for at, v in zip(start, self.core.v, strict=True))
        self._corner = tuple(int(saturate(at, 0, most)) for at, most in zip(target, self._limits, strict=True))
        ahead = tuple(at + (v << shift) for at, v in zip(self._corner, self.core.v, strict=True))
        self._next_crop, limited = self._whole(ahead)
        return Flag.ROI_CLAMPED if limited or self._corner != target else Flag(0)

    def _whole(self, position):
        """The nearest corner on the sensor, px, and whether it was limited."""
        rounded = tuple(round_half_up(axis, self._frac) for axis in position)
        limited = tuple(
            int(saturate(axis, 0, floor_shift(most, self._frac)))
            for axis, most in zip(rounded, self._limits, strict=True)
        )
        return limited, limited != rounded

    def _begin_hop(self, now, stale):
        hops = self.hops
        times = self.window[0]
        old = len(times) if stale else int(np.searchsorted(times, now + hops.hop_us - self._oldest))
        begin = max(self._begin + old, self._end + hops.hop_events - hops.window_events)
        self.window = tuple(axis[begin - self._begin :] for axis in self.window)
        self._begin = begin
        if begin == self._end:
            self._origin = begin
        self._closed, self._last_end = now, self._end
        self._found = self._outside = self._back = 0
