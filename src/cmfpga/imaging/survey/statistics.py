"""Statistics of a recording: counts, rate over time, hot pixels."""

import contextlib
import math
import weakref

import numpy as np
from tqdm import tqdm

from ...config.defaults import ENGINES
from ...errors import ConfigError, RecordingError

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
    """Statistics of a recording, collected chunk by chunk.

    Attributes
    ----------
    events, on_events : int
    t_first, t_last : int
        µs.
    counts : int64 [rows, columns]
        Events per pixel. As large as the sensor, or, where nobody tells it, as the coordinates that occurred.
    bin_us : int
        Width of the bins of ``rate``, µs.
    """

    def __init__(self, width=None, height=None):
        self.events = self.on_events = 0
        self.t_first = self.t_last = None
        self.counts = _counts(height or 1, width or 1)
        self.bin_us = 1
        self._bins = np.zeros(_MAX_BINS, np.int64)

    def add(self, events):
        """Take the next :class:`Events`."""
        if not len(events):
            return
        if self.t_first is None:
            self.t_first = int(events.t[0])
        self.t_last = int(events.t[-1])
        self.events += len(events)
        self.on_events += int(events.p.sum())
        rows, columns = int(events.y.max()) + 1, int(events.x.max()) + 1
        if rows > self.counts.shape[0] or columns > self.counts.shape[1]:
            larger = _counts(*np.maximum(self.counts.shape, (rows, columns)).tolist())
            larger[: self.counts.shape[0], : self.counts.shape[1]] = self.counts
            self.counts = larger
        width = self.counts.shape[1]
        where = events.y.astype(np.int64) * width + events.x
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
        around = [
            padded[1 + dy : 1 + dy + rows, 1 + dx : 1 + dx + columns]
            for dy in (-1, 0, 1)
            for dx in (-1, 0, 1)
            if dx or dy
        ]
        second = np.partition(np.stack(around), -2, axis=0)[-2]
        y, x = np.nonzero((self.counts >= _HOT_EVENTS) & (self.counts > _HOT_TIMES * second))
        found = [(int(a), int(b), int(self.counts[b, a])) for a, b in zip(x, y, strict=True)]
        return sorted(found, key=lambda pixel: -pixel[2])


def hot_mask(recording):
    """The hot pixels of a recording as the field ``hot_mask`` of a :class:`~cmfpga.config.Config` has them.

    Raises :exc:`ConfigError` where the events cannot be read twice.
    """
    return pixels_text(surveyed(recording, "hot pixels: auto", "say which pixels are hot").hot_pixels())


def usual_survey(recording, engine, given):
    """The survey whose hot pixels are dropped by default; None of a stream, and where the user says which pixels.

    Also None for hardware without a mask, which is behind AXI or a serial line. Of a recording that breaks off, what
    can be read counts.
    """
    if not recording.seekable or engine not in ENGINES or {"hot_pixels", "hot_mask"} & {*given}:
        return None
    try:
        return surveyed(recording, "", "")
    except RecordingError:
        survey = Survey(recording.width, recording.height)
        with contextlib.suppress(RecordingError):
            survey_all(recording, survey)
        return survey


def without_hot_pixels(config, survey, how):
    """``config`` with a mask of a survey's hot pixels, and a note of them; as it is, and None, where there are none.

    Parameters
    ----------
    config : Config
    survey : Survey or None
    how : str
        How a user keeps the pixels.
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
    """A :class:`Survey` of all events, made once. Where they come only once, :exc:`ConfigError`: ``what`` cannot be."""
    if not recording.seekable:
        raise ConfigError(f"{recording.name}: {what}: its events come only once; {instead}")
    if recording not in _SURVEYS:
        survey = Survey(recording.width, recording.height)
        survey_all(recording, survey)
        _SURVEYS[recording] = survey
    return _SURVEYS[recording]


def pixels_text(pixels):
    """``x,y;x,y;…`` of (x, y, …) each."""
    return ";".join(f"{x},{y}" for x, y, *_ in pixels)


def survey_all(recording, survey):
    """Read the whole recording into ``survey``, with a bar."""
    with tqdm(total=recording.num_events, unit="event", unit_scale=True, disable=None, leave=False) as bar:
        for chunk in recording.chunks():
            survey.add(chunk)
            bar.update(len(chunk))
