"""Cutting a recording, or another source of events, into batches, the same for every engine."""

import operator
from dataclasses import dataclass

import numpy as np

from ..errors import ConfigError, RecordingError
from .arrays import Events
from .recording import CHUNK_EVENTS

#: What :meth:`BatchCutter.next` returns where the source has no events *yet*: ask again later.
WAITING = object()
_END = object()

# Events whose coordinates are looked at in one go when ROI events are counted: little more than a batch.
_SCAN_EVENTS = 4096
#: At every so many events :meth:`BatchCutter.piece` ends a piece.
PIECE_EVENTS = 1024


@dataclass(frozen=True, eq=False)
class Batch(Events):
    """Events of one batch.

    ``first_event`` is the index in the recording of the first event (for an empty batch: of the event that comes next).
    A batch that is ``cut_short`` was cut at ``max_events`` before it was complete; its other events begin the next one.
    With ``duration_us``, ``window`` has the window's begin and end, µs; the end is exclusive.
    """

    first_event: int = 0
    cut_short: bool = False
    window: tuple[int, int] | None = None


class BatchCutter:
    """Cuts a recording into consecutive batches.

    Each event is in one batch, or in the rest that :attr:`leftover` counts.

    What makes a batch complete is one of three:

    - ``events``: that many events of the whole sensor;
    - ``duration_us``: the window [t0 + k·D, t0 + (k + 1)·D) of time, t0 being the time of the first event that is
      cut. A window without events gives an empty batch. It is complete once there is an event after it;
    - ``roi_events``: that many events inside the ROI; the last of them is the batch's last event.

    A batch that reaches ``max_events`` before it is complete is returned as it is, with ``cut_short`` set. A cut window
    goes on in the next batch; a batch by ROI events starts counting anew. A last incomplete batch is not returned: it
    would be estimated from fewer events, or less time, than all others.

    Raises :exc:`ConfigError` for a value that is not allowed; :exc:`RecordingError`, also in :meth:`next`, is the
    source's.

    Parameters
    ----------
    source : EventSource
    start_event : int
        Index of the first event to cut.
    events, duration_us, roi_events : int, optional
        Exactly one of them, 1 or more: events, µs, events.
    max_events : int
        Largest batch, in events of the whole sensor.
    seen : callable, optional
        ``seen(events)``: events whose ``x`` and ``y`` are where the ROI has them, as
        :func:`cmfpga.imaging.camera.seen` finds them.
    """

    def __init__(self, source, *, start_event=0, events=None, duration_us=None, roi_events=None, max_events, seen=None):
        modes = {"events": events, "duration_us": duration_us, "roi_events": roi_events}
        given = {name: value for name, value in modes.items() if value is not None}
        if len(given) != 1:
            told = " and ".join(given) or "no size"
            raise ConfigError(f"{told} given for batches: one of {', '.join(modes)} is needed")
        self.max_events = whole("max_events", max_events)
        ((self.mode, size),) = given.items()
        self.size = whole(self.mode, size)
        if self.mode != "duration_us" and self.size > self.max_events:
            raise ConfigError(f"{self.mode} = {self.size}: at most {self.max_events} is allowed (max_events)")
        self._seen = seen or (lambda events: events)
        self._source, self._start = source, whole("start_event", start_event, low=0)
        self._chunks = source.chunks(self._start, CHUNK_EVENTS)
        self._chunk = Events.empty()
        self._at = 0  # first event of the chunk that is in no batch yet
        #: Index in the recording of the next event to cut.
        self.position = self._start
        self._window_begin = self._leftover = self._broken = None
        self._parts, self._count, self._inside = [], 0, 0  # of the batch that is being filled

    @property
    def leftover(self):
        """Events after the last batch; 0 until :meth:`next` has returned None."""
        return self._leftover or 0

    def too_few(self):
        """The :exc:`ConfigError` of a track without any batch, or of a single event."""
        left = f"({self.position - self._start + self.leftover} left)"
        return ConfigError(f"{self._source.name}: too few events for one batch after event {self._start} {left}")

    @property
    def waiting(self):
        """The events that :meth:`peek` has seen and nothing has cut."""
        return self._chunk[self._at :]

    def peek(self, count, until=None):
        """The next ``count`` events, which stay; or :data:`WAITING`.

        Fewer at the end of the source, and where one comes that is not earlier than ``until``, µs.
        """
        parts, chunk = [self.waiting], _END
        while sum(map(len, parts)) < count:
            if until is not None and len(parts[-1]) and parts[-1].t[-1] >= until:
                break
            chunk = self._pull()
            if chunk is None or chunk is _END:
                break
            parts.append(chunk)
        self._chunk, self._at = Events.concatenate(parts), 0
        if until is not None:
            count = min(count, int(np.searchsorted(self._chunk.t, until)))
        return WAITING if chunk is None else self._chunk[:count]

    def _pull(self):
        """What the source gives next. Where it breaks off, its events end; once they are cut, :meth:`next` raises."""
        try:
            return next(self._chunks, _END)
        except RecordingError as error:
            self._broken = error
            return _END

    def _rest(self, leftover):
        """Events that are in no batch yet, at least one; None at the end, when ``leftover`` are; or :data:`WAITING`."""
        if self._leftover is not None:
            return None
        while self._at == len(self._chunk):
            chunk = self._pull()
            if chunk is None:
                return WAITING
            if chunk is _END:
                self._leftover = leftover
                if self._broken:
                    raise self._broken
                return None
            self._chunk, self._at = chunk, 0
        return self._chunk[self._at :]

    def next(self, roi=None):
        """The next :class:`Batch`, None at the end, or :data:`WAITING`.

        ``roi`` is (x, y, width, height): left column, top row and size of the ROI, px, integers. It counts with
        ``roi_events`` only, and may be another one for each batch. Parts outside the sensor hold no events.
        """
        if self.mode == "roi_events" and self._leftover is None:
            roi = _checked_roi(roi)
        while True:
            rest, count, cut_short = self._rest(self._count), self._count, False
            if rest is None or rest is WAITING:
                return rest
            if self.mode == "events":
                take = min(self.size - count, len(rest))
                complete = count + take == self.size
            elif self.mode == "duration_us":
                take, complete, cut_short = self._take_window(rest, count)
            else:
                ahead = self._seen(rest[: min(_SCAN_EVENTS, self.max_events - count)])
                take, hits = _take_roi(ahead, roi, self.size - self._inside)
                self._inside += hits
                complete = self._inside == self.size
                cut_short = not complete and count + take == self.max_events
            self._parts.append(rest[:take])
            self._count += take
            self._at += take
            if complete or cut_short:
                return self._batch(cut_short)

    def piece(self):
        """Events that have come, up to a multiple of :data:`PIECE_EVENTS`; None at the end, or :data:`WAITING`."""
        rest = self._rest(0)
        if rest is None or rest is WAITING:
            return rest
        part = rest[: PIECE_EVENTS - (self.position - self._start) % PIECE_EVENTS]
        self._at += len(part)
        self.position += len(part)
        return part

    def give_back(self, count):
        """So many of the last events that :meth:`piece` gave belong to no window."""
        self.position -= count
        if self._leftover is not None:
            self._leftover = count

    def _take_window(self, rest, count):
        if self._window_begin is None:
            self._window_begin = int(rest.t[0])
        take = int(np.searchsorted(rest.t, self._window_begin + self.size))
        complete = take < len(rest)
        if count + take > self.max_events:
            return self.max_events - count, False, True
        return take, complete, False

    def _batch(self, cut_short):
        parts, count, first = self._parts, self._count, self.position
        self._parts, self._count, self._inside = [], 0, 0
        self.position += count
        window = None
        if self.mode == "duration_us":
            window = (self._window_begin, self._window_begin + self.size)
            if not cut_short:
                self._window_begin = window[1]
        events = parts[0] if len(parts) == 1 else Events.concatenate(parts)
        return Batch(events.t, events.x, events.y, events.p, first, cut_short, window)


def _take_roi(events, roi, wanted):
    """How many of ``events`` to take until ``wanted`` of them are inside the ROI, and how many of those are."""
    x, y, width, height = roi
    column, row = events.x - (x - 0.5), events.y - (y - 0.5)
    hits = np.flatnonzero((column >= 0) & (column < width) & (row >= 0) & (row < height))
    if len(hits) < wanted:
        return len(events), len(hits)
    return int(hits[wanted - 1]) + 1, wanted


def whole(name, value, low=1):
    """``value`` as an int; raises :exc:`ConfigError`, which names it, unless it is one of ``low`` or more."""
    try:
        number = operator.index(value)
    except TypeError:
        number = low - 1
    if number < low or isinstance(value, bool):
        raise ConfigError(f"{name} = {value!r}: an integer of {low} or more is needed")
    return number


def _checked_roi(roi):
    try:
        _, _, width, height = roi = tuple(map(operator.index, roi))
    except (TypeError, ValueError):
        raise ConfigError(f"roi = {roi!r}: four integers (x, y, width, height) are needed with roi_events") from None
    if width < 1 or height < 1:
        raise ConfigError(f"roi = {roi!r}: width and height of 1 or more are needed")
    return roi
