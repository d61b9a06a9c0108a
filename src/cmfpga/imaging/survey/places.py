"""Where and when to look for motion: events of a recording from one on, and the busiest ROIs among them."""

import numpy as np

from ...errors import RecordingError
from ...events import Events
from ..camera import nearest, seen, undistort

_READ_EVENTS = 2_000_000  # most events that a proposal looks at from one start
_PLACES = 4  # candidates that are looked at from one start


class Window:
    """Events of a recording from one event on, read as they are asked for.

    With a camera in ``config`` they are where the undistorted image has them, on whole pixels; those that leave the
    sensor are far beyond it.
    """

    def __init__(self, recording, start, config):
        self.start, self._config = start, config
        self._chunks = recording.chunks(start)
        self._events = Events.empty()
        self._ended = False

    def _grow(self):
        try:
            chunk = None if self._ended or len(self._events) >= _READ_EVENTS else next(self._chunks, None)
        except RecordingError:  # what comes before the damage can still be looked at
            if not len(self._events):
                raise
            chunk = None
        if chunk is None:
            self._ended = True
            return False
        self._events = Events.concatenate([self._events, whole_pixels(self._config, chunk)])
        return True

    def first(self):
        """The first events: enough to find places, at least."""
        while len(self._events) < 1 << 16 and self._grow():
            pass
        return self._events

    def count(self, most):
        """How many of the first ``most`` events there are."""
        while len(self._events) < most and self._grow():
            pass
        return min(len(self._events), most)

    def during(self, begin_us, duration_us):
        """Events of ``begin_us … begin_us + duration_us`` (µs from the first), or None where they are not all there."""
        while not len(self._events) or self._events.t[-1] - self._events.t[0] < begin_us + duration_us:
            if not self._grow():
                return None
        t0 = int(self._events.t[0])
        a, b = np.searchsorted(self._events.t, (t0 + begin_us, t0 + begin_us + duration_us))
        return self._events[a:b]


def whole_pixels(config, events):
    """``events`` as a :class:`Window` has them."""
    if not config.lens:
        return events
    placed = seen(config, events)
    x, y, there = nearest(config, placed.x, placed.y)
    return Events(events.t, np.where(there, x, 65535), np.where(there, y, 65535), events.p)


def hot_places(config, hot):
    """Hot pixels, (x, y, events) each, where a :class:`Window` has their events."""
    if not (config.lens and hot):
        return hot
    x, y, counts = np.array(hot).T
    step = 2.0**-config.formats.event_frac
    x, y, there = nearest(config, *(axis * step for axis in undistort(config, config.lens, x, y)))
    return np.stack([x, y, counts], axis=1)[there].tolist()


def busy_places(events, config, hot, recording):
    """Corners of ROIs with many events, the busiest first."""
    columns = recording.width or config.sensor_width
    rows = recording.height or config.sensor_height
    if columns < config.roi_width or rows < config.roi_height:
        return []
    # A short beginning, so that an object is seen where it is, not where it went.
    events = events[: max(len(events) // 8, 5000)]
    inside = (events.x < columns) & (events.y < rows)
    where = events.y[inside].astype(np.int64) * columns + events.x[inside]
    counts = np.bincount(where, minlength=columns * rows).reshape(rows, columns).astype(float)
    for x, y, _ in hot_places(config, hot):
        if x < columns and y < rows:
            counts[y, x] = 0
    # Few very busy pixels are no better than many that are busy.
    counts = np.sqrt(counts)
    places = []
    for _ in range(_PLACES):
        place = _busiest(counts, config.roi_width, config.roi_height)
        for _ in range(3):
            place = _centred(counts, place, config)
        x, y = place
        part = counts[y : y + config.roi_height, x : x + config.roi_width]
        if part.sum() < 30:
            break
        places.append(place)
        part[:] = 0
    return places


def box_sums(counts, width, height):
    """Sums over all boxes of ``width`` × ``height`` pixels, by their top left ones: [rows − height + 1, …]."""
    sums = np.pad(counts, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    return sums[height:, width:] - sums[:-height, width:] - sums[height:, :-width] + sums[:-height, :-width]


def _busiest(counts, width, height):
    boxes = box_sums(counts, width, height)
    y, x = np.unravel_index(int(boxes.argmax()), boxes.shape)
    return int(x), int(y)


def _centred(counts, place, config):
    """The ROI moved so that its events' centre is in its middle, on the sensor."""
    x, y = place
    part = counts[y : y + config.roi_height, x : x + config.roi_width]
    total = part.sum()
    if not total:
        return place
    rows, columns = counts.shape
    x += round(float((part.sum(axis=0) * np.arange(part.shape[1])).sum() / total - (config.roi_width - 1) / 2))
    y += round(float((part.sum(axis=1) * np.arange(part.shape[0])).sum() / total - (config.roi_height - 1) / 2))
    return min(max(x, 0), columns - config.roi_width), min(max(y, 0), rows - config.roi_height)
