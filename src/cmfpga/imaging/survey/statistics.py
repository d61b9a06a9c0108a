"""A recording's events: counts, rate over time and hot pixels of all, and where to look for motion among them."""

import math
import weakref

import numpy as np
from tqdm import tqdm

from ...config.presets import ENGINES
from ...errors import ConfigError, RecordingError
from ...events import Events
from ..camera import nearest, undistort

#: Pixels of the largest sensor that is surveyed; those that are sold have 1280×800.
MOST_PX = 1280 * 1024

_MAX_BINS = 512  # of the rate over time, while it is collected

# A hot pixel: at least so many events, and so many times those of the second busiest pixel around it.
_HOT_EVENTS, _HOT_TIMES = 20, 4
_HOT_SHOWN = 5

_SURVEYS = weakref.WeakKeyDictionary()  # of recordings that were read


def _counts(rows, columns):
    if rows * columns > MOST_PX:
        raise RecordingError(f"a sensor of {columns}×{rows} px, which no camera has: --sensor W,H says how large it is")
    return np.zeros((rows, columns), np.int64)


class Survey:
    """Statistics of a recording, collected chunk by chunk."""

    def __init__(self, width=None, height=None):
        self.events = self.on_events = 0
        self.t_first = self.t_last = None  #: µs
        #: Events per pixel. As large as the sensor, or, where nobody tells it, as the coordinates that occurred.
        self.counts = _counts(height or 1, width or 1)
        self.bin_us = 1  #: width of the bins of :meth:`rate`, µs
        self._bins = np.zeros(_MAX_BINS, np.int64)

    def add(self, events):
        """Take the next :class:`Events`."""
        if not len(events):
            return
        self.t_first = int(events.t[0]) if self.t_first is None else self.t_first
        self.t_last = int(events.t[-1])
        self.events += len(events)
        self.on_events += int(events.p.sum())
        rows, columns = int(events.y.max()) + 1, int(events.x.max()) + 1
        if rows > self.counts.shape[0] or columns > self.counts.shape[1]:
            larger = _counts(*np.maximum(self.counts.shape, (rows, columns)).tolist())
            larger[: self.counts.shape[0], : self.counts.shape[1]] = self.counts
            self.counts = larger
        where = events.y.astype(np.int64) * self.counts.shape[1] + events.x
        self.counts += np.bincount(where, minlength=self.counts.size).reshape(self.counts.shape)
        while (self.t_last - self.t_first) // self.bin_us >= _MAX_BINS:
            self._bins = np.concatenate([self._bins.reshape(-1, 2).sum(axis=1), np.zeros(_MAX_BINS // 2, np.int64)])
            self.bin_us *= 2
        self._bins += np.bincount((events.t - self.t_first) // self.bin_us, minlength=_MAX_BINS)

    @property
    def span_us(self):
        """From the first to the last event, µs."""
        return self.t_last - self.t_first if self.events else 0

    def rate(self, bins=60):
        """Events per second over time: ``(width of a bin in µs, float64 [at most bins])``."""
        used = self.span_us // self.bin_us + 1
        group = math.ceil(used / bins)
        padded = np.concatenate([self._bins[:used], np.zeros(-used % group, np.int64)])
        counts = padded.reshape(-1, group).sum(axis=1)
        width = group * self.bin_us
        widths = np.full(len(counts), float(width))
        widths[-1] = max(self.span_us + 1 - width * (len(counts) - 1), 1)
        return width, counts / widths * 1e6

    def hot_pixels(self):
        """``[(x, y, events)]``, the busiest first: pixels far busier than those around them."""
        rows, columns = self.counts.shape
        padded = np.pad(self.counts, 1)
        steps = ((dy, dx) for dy in range(3) for dx in range(3) if (dy, dx) != (1, 1))
        around = [padded[dy : dy + rows, dx : dx + columns] for dy, dx in steps]
        second = np.partition(np.stack(around), -2, axis=0)[-2]
        y, x = np.nonzero((self.counts >= _HOT_EVENTS) & (self.counts > _HOT_TIMES * second))
        found = [(int(a), int(b), int(self.counts[b, a])) for a, b in zip(x, y, strict=True)]
        return sorted(found, key=lambda pixel: -pixel[2])


def hot_mask(recording):
    """A recording's hot pixels as ``Config.hot_mask``; :exc:`ConfigError` where its events cannot be read twice."""
    return pixels_text(surveyed(recording, "hot pixels: auto", "say which pixels are hot").hot_pixels())


def usual_survey(recording, engine, given):
    """The survey whose hot pixels are dropped by default; None of a stream, and where the user says which pixels.

    Also None for hardware behind AXI or a serial line, which may have no mask. Of a recording that breaks off, what
    can be read counts.
    """
    if not recording.seekable or engine not in ENGINES or {"hot_pixels", "hot_mask"} & {*given}:
        return None
    survey, _ = survey_all(recording)
    return survey


def without_hot_pixels(config, survey, how):
    """``config`` with a mask of a survey's hot pixels, and a note of them; as it is, and None, where there are none.

    The note tells ``how`` a user keeps the pixels. There are none without a survey.
    """
    found = survey.hot_pixels() if survey else []
    found = [pixel for pixel in found if pixel[0] < config.sensor_width and pixel[1] < config.sensor_height]
    if not found:
        return config, None
    share = sum(events for *_, events in found) / survey.events
    note = f"hot pixels {shown(found)}: {share:.2%} of the events, which are dropped; {how} keeps them"
    return config.replace(hot_pixels=1, hot_mask=pixels_text(found)), note


def shown(pixels):
    """Hot pixels for people: the busiest, and how many there are besides."""
    text = ", ".join(f"{x},{y} ({events:,} events)" for x, y, events in pixels[:_HOT_SHOWN])
    return text + (f", and {len(pixels) - _HOT_SHOWN} more" if len(pixels) > _HOT_SHOWN else "")


def surveyed(recording, what, instead):
    """A :class:`Survey` of all events. Where they come only once, :exc:`ConfigError`: ``what`` cannot be."""
    if not recording.seekable:
        raise ConfigError(f"{recording.name}: {what}: its events come only once; {instead}")
    survey, broken = survey_all(recording)
    if broken:
        raise broken
    return survey


def pixels_text(pixels):
    """``x,y;x,y;…`` of (x, y, …) each."""
    return ";".join(f"{x},{y}" for x, y, *_ in pixels)


def survey_all(recording):
    """``(survey, error)``: of all events that can be read, once; and what the recording breaks off with, or None."""
    if recording in _SURVEYS:
        return _SURVEYS[recording], None
    survey = Survey(recording.width, recording.height)
    try:
        with tqdm(total=recording.num_events, unit="event", unit_scale=True, disable=None, leave=False) as bar:
            for chunk in recording.chunks():
                survey.add(chunk)
                bar.update(len(chunk))
    except RecordingError as error:
        return survey, error
    _SURVEYS[recording] = survey
    return survey, None


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
        if self._config.lens:
            x, y, there = _on_image(self._config, chunk.x, chunk.y)
            chunk = Events(chunk.t, np.where(there, x, 65535), np.where(there, y, 65535), chunk.p)
        self._events = Events.concatenate([self._events, chunk])
        return True

    def first(self, least=1 << 16):
        """The first events, at least so many where there are: enough to find places."""
        while len(self._events) < least and self._grow():
            pass
        return self._events

    def during(self, begin_us, duration_us):
        """Events of ``begin_us … begin_us + duration_us`` (µs from the first), or None where they are not all there."""
        while not len(self._events) or self._events.t[-1] - self._events.t[0] < begin_us + duration_us:
            if not self._grow():
                return None
        t0 = int(self._events.t[0])
        a, b = np.searchsorted(self._events.t, (t0 + begin_us, t0 + begin_us + duration_us))
        return self._events[a:b]


def _on_image(config, x, y):
    """Whole pixels at which the undistorted image has those of the sensor, and which of them lie on it."""
    step = 2.0**-config.formats.event_frac
    return nearest(config, *(axis * step for axis in undistort(config, config.lens, x, y)))


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
    x, y = np.array([pixel[:2] for pixel in hot], np.int64).reshape(-1, 2).T
    if config.lens:
        x, y, there = _on_image(config, x, y)
        x, y = x[there], y[there]
    there = (x < columns) & (y < rows)
    counts[y[there], x[there]] = 0
    # Few very busy pixels are no better than many that are busy.
    counts = np.sqrt(counts)
    places = []
    for _ in range(_PLACES):
        boxes = box_sums(counts, config.roi_width, config.roi_height)
        place = np.unravel_index(int(boxes.argmax()), boxes.shape)[::-1]
        for _ in range(3):
            place = _centred(counts, place, config)
        x, y = place = tuple(map(int, place))
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


def _centred(counts, place, config):
    """The ROI moved so that its events' centre is in its middle, on the sensor."""
    x, y = place
    part = counts[y : y + config.roi_height, x : x + config.roi_width]
    total = part.sum()
    if not total:
        return place
    axes = zip(place, part.shape[::-1], counts.shape[::-1], (part.sum(axis=0), part.sum(axis=1)), strict=True)
    return tuple(
        min(max(at + round(float((sums * np.arange(size)).sum() / total - (size - 1) / 2)), 0), end - size)
        for at, size, end, sums in axes
    )
