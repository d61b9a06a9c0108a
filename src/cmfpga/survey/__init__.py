"""What a recording holds, and an ROI and batches that suit it: for ``info`` and ``track --roi auto``. NumPy only.

The proposal. A batch is measured best where the image moves by 3 to 5 px per half batch; below 1 px every method
scatters. So, where many events are, the motion is estimated in a window of time, the window is made longer or shorter
until the image moves by 4 px per half of it, and the next windows must confirm the velocity. The estimate is the
contrast's highest peak over a grid of velocities, coarse to fine, with dithered positions: it needs no start value.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from ..config.dither import DITHER_BITS, FACTORS
from ..errors import ConfigError, RecordingError
from ..events import Events

#: Motion that the proposal aims at, px per half batch, and what is accepted.
TARGET_PX = 4.0
ALLOWED_PX = (3.0, 5.0)

_MAX_BINS = 512  # of the rate over time, while it is collected
_READ_EVENTS = 2_000_000  # most events that a proposal looks at from one start

# A hot pixel: at least so many events, and so many times those of the second busiest pixel around it.
_HOT_EVENTS, _HOT_TIMES = 20, 4

_PLACES = 4  # candidates that are looked at from one start
_STARTS = 8  # starts, evenly over the recording's events
_ROUNDS = 8  # changes of the window's length
_USED_EVENTS = 2000  # of the ROI, thinned evenly
_MIN_ROI_EVENTS = 150
_FIRST_ROI_EVENTS = 600
_REACH_PX = 10  # velocities that the grid holds, px per half window
_MIN_GAIN = 1.08  # contrast at the peak, to that at v = 0
_MIN_CLARITY = 0.03  # see estimate
_AGREE = 0.35  # how far the velocity of other windows may differ, relative


# -------------------------------------------------------------------- statistics


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
        self.counts = np.zeros((height or 1, width or 1), np.int64)
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
            larger = np.zeros(np.maximum(self.counts.shape, (rows, columns)), np.int64)
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


# -------------------------------------------------------------------- motion


def estimate(x, y, dt, width, height):
    """Velocity at which the image of warped events is sharpest, px per half window, and how much sharper than at 0.

    Parameters
    ----------
    x, y : float64 [n]
        Positions in the ROI, px.
    dt : float64 [n]
        Scaled times, −1 … 1.
    width, height : int
        Of the ROI, px.

    Returns
    -------
    (vx, vy), gain, clarity : float64 [2], float, float
        ``gain`` is the contrast at v over the one at v = 0. ``clarity`` is what the contrast loses, as a share of it, 3
        px away in the direction in which it loses least, in an image of pixels twice as wide: near 0 where all edges
        have one direction, along which the motion cannot be seen.
    """
    k = np.arange(len(x)) + 0.5
    x, y = (axis + k * factor * 2.0**-DITHER_BITS % 1 - 0.5 for axis, factor in zip((x, y), FACTORS, strict=True))
    grid = np.arange(-_REACH_PX, _REACH_PX + 1.0)
    start = [(vx, vy) for vx in grid for vy in grid]
    v = max(start, key=lambda v: _contrast(x, y, dt, v, width, height, 2))
    for level, step in ((1, 1.0), (1, 0.5), (0, 0.5), (0, 0.25), (0, 0.125)):
        best = _contrast(x, y, dt, v, width, height, level)
        while True:
            around = [(v[0] + a * step, v[1] + b * step) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]
            values = [_contrast(x, y, dt, near, width, height, level) for near in around]
            if max(values) <= best:
                break
            best, v = max(values), around[int(np.argmax(values))]
            if max(map(abs, v)) > _REACH_PX + 2:
                break
    still = _contrast(x, y, dt, (0.0, 0.0), width, height, 0)
    # With a border that no event leaves: what is lost there says nothing of the peak.
    ring = [(v[0] + 3 * math.cos(a), v[1] + 3 * math.sin(a)) for a in np.arange(16) * math.pi / 8]
    wide = (x + 16, y + 16, dt)
    peak, *around = (_contrast(*wide, near, width + 32, height + 32, 1) for near in (v, *ring))
    clarity = 1 - max(around) / max(peak, 1e-12)
    return np.array(v), best / max(still, 1e-12), clarity


def _contrast(x, y, dt, v, width, height, level):
    """Variance of the image of warped events, of pixels 2^level px wide."""
    scale = 2.0**-level
    x, y = (x - dt * v[0] + 0.5) * scale - 0.5, (y - dt * v[1] + 0.5) * scale - 0.5
    columns, rows = -(-width >> level), -(-height >> level)
    # A border of one pixel takes the votes outside; those further out are put there.
    left, top = np.floor(x), np.floor(y)
    fx, fy = x - left, y - top
    left = np.clip(left, -2, columns).astype(np.int64) + 2
    top = np.clip(top, -2, rows).astype(np.int64) + 2
    cell = top * (columns + 4) + left
    pixels = (columns + 4) * (rows + 4)
    image = np.zeros(pixels)
    for offset, weight in (
        (0, (1 - fx) * (1 - fy)), (1, fx * (1 - fy)), (columns + 4, (1 - fx) * fy), (columns + 5, fx * fy),
    ):  # fmt: skip
        image += np.bincount(cell + offset, weight, minlength=pixels)[:pixels]
    return image.reshape(rows + 4, columns + 4)[2:-2, 2:-2].var()


# -------------------------------------------------------------------- proposals


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """An ROI, and batches in which its image moves by about 4 px per half batch.

    Parameters
    ----------
    roi : (int, int)
        Left column and top row, px.
    start_event : int
        Where the motion was measured: first event of the first batch.
    batch_events : int
        Events of the whole sensor.
    batch_us : int
        What they last there, µs.
    roi_events : int
        Of them, in the ROI.
    v : (float, float)
        Measured velocity, px per half batch.
    px_per_s : (float, float)
        The same, px/s.
    gain, clarity : float
        How much sharper the image is at v than at v = 0, and how clear its peak is; see :func:`estimate`.
    fields : dict
        Fields of the configuration that these batches need.
    """

    roi: tuple[int, int]
    start_event: int
    batch_events: int
    batch_us: int
    roi_events: int
    v: tuple[float, float]
    px_per_s: tuple[float, float]
    gain: float
    clarity: float
    fields: dict = field(default_factory=dict)

    @property
    def px(self):
        """|v|, px per half batch."""
        return math.hypot(*self.v)

    @property
    def text(self):
        """The proposal in one line."""
        return (
            f"ROI {self.roi[0]},{self.roi[1]} from event {self.start_event} on, {self.batch_events} events a batch: "
            f"{self.reason}"
        )

    @property
    def reason(self):
        """One sentence for people."""
        speed = math.hypot(*self.px_per_s)
        return (
            f"the image moves at {speed:,.0f} px/s there, so in {self.batch_events:,} events, "
            f"{self.batch_us / 1e3:,.3g} ms, it moves by {self.px:.1f} px per half batch; "
            f"{ALLOWED_PX[0]:g} to {ALLOWED_PX[1]:g} px are measured best"
        )


def propose(recording, survey, config, *, count=1, start_event=None, tick=lambda: None):
    """ROIs and batches for ``count`` objects that do not overlap, the clearest first.

    Parameters
    ----------
    recording : Recording
    survey : Survey or None
        Of the whole recording: its hot pixels are left out where places are looked for, and its number of events says
        where to look. Without it, only the recording's start is looked at.
    config : Config
        Gives the ROI's size and what the hardware holds.
    start_event : int, optional
        Look there only; by default at the recording's start and, if nothing moves clearly there, later.
    tick : callable
        Called now and then, with no arguments.

    Returns
    -------
    list of Proposal
        May be shorter than ``count``, or empty where nothing moves clearly. All have one ``start_event``.
    """
    if start_event is not None:
        starts = [start_event]
    else:
        events = survey.events if survey else 0
        starts = sorted({events * k // _STARTS for k in range(_STARTS)})
    hot = survey.hot_pixels() if survey else []
    best = []
    for start in starts:
        found = _from(recording, start, config, hot, count, tick)
        if len(found) == count:
            return found
        best = max(best, found, key=len)
    return best


def _from(recording, start, config, hot, count, tick):
    window = _Window(recording, start)
    found = []
    for place in _places(window.first(), config, hot, recording):
        tick()
        proposal = _try(window, place, config, tick)
        if proposal:
            found.append(proposal)
    chosen = []
    for proposal in sorted(found, key=lambda proposal: -proposal.clarity):
        if len(chosen) < count and not any(_overlap(proposal.roi, other.roi, config) for other in chosen):
            chosen.append(proposal)
    return chosen


def _overlap(a, b, config):
    return abs(a[0] - b[0]) < config.roi_width and abs(a[1] - b[1]) < config.roi_height


class _Window:
    """Events of a recording from one event on, read as they are asked for."""

    def __init__(self, recording, start):
        self.start = start
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
        self._events = Events.concatenate([self._events, chunk])
        return True

    def first(self):
        """The first events: enough to find places, at least."""
        while len(self._events) < 1 << 16 and self._grow():
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


def _places(events, config, hot, recording):
    """Corners of ROIs with many events, the busiest first."""
    columns = recording.width or config.sensor_width
    rows = recording.height or config.sensor_height
    # A short beginning, so that an object is seen where it is, not where it went.
    events = events[: max(len(events) // 8, 5000)]
    inside = (events.x < columns) & (events.y < rows)
    where = events.y[inside].astype(np.int64) * columns + events.x[inside]
    counts = np.bincount(where, minlength=columns * rows).reshape(rows, columns).astype(float)
    for x, y, _ in hot:
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


def _busiest(counts, width, height):
    sums = np.pad(counts, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    boxes = sums[height:, width:] - sums[:-height, width:] - sums[height:, :-width] + sums[:-height, :-width]
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


def _measure(window, place, begin_us, duration_us, config):
    """``(v, gain, clarity, ROI events, all events)`` of a window of time; None where there is none, or it is empty."""
    events = window.during(begin_us, duration_us)
    if events is None or len(events) < 2:
        return None
    span = int(events.t[-1] - events.t[0])
    x, y = events.x.astype(np.int64) - round(place[0]), events.y.astype(np.int64) - round(place[1])
    index = np.flatnonzero((x >= 0) & (x < config.roi_width) & (y >= 0) & (y < config.roi_height))
    if len(index) < _MIN_ROI_EVENTS or not span:
        return None
    used = index[:: math.ceil(len(index) / _USED_EVENTS)]
    dt = (2.0 * (events.t[used] - events.t[0]) - span) / span
    found = estimate(x[used].astype(float), y[used].astype(float), dt, config.roi_width, config.roi_height)
    return *found, len(index), len(events)


def _try(window, place, config, tick):
    """A :class:`Proposal` for an ROI at ``place``, or None if the motion in it is not clear."""
    duration = _first_duration(window, place, config)
    tried = set()
    for _ in range(_ROUNDS):
        tick()
        if duration is None or duration in tried:
            return None
        tried.add(duration)
        measured = _measure(window, place, 0, duration, config)
        if measured is None:
            return None
        v, gain, clarity, _, _ = measured
        px = math.hypot(*v)
        if abs(px - TARGET_PX) <= 0.6 and gain >= _MIN_GAIN and clarity >= _MIN_CLARITY:
            return _confirmed(window, place, duration, measured, config)
        if px > _REACH_PX - 1:
            factor = 0.4
        elif px < 1:
            factor = 3.0
        else:
            factor = min(max(TARGET_PX / px, 0.25), 3.0)
        duration = max(round(duration * factor), 2)
    return None


def _first_duration(window, place, config):
    """Time in which the ROI sees some hundred events, µs; None if it does not."""
    events = window.first()
    x, y = events.x.astype(np.int64) - place[0], events.y.astype(np.int64) - place[1]
    index = np.flatnonzero((x >= 0) & (x < config.roi_width) & (y >= 0) & (y < config.roi_height))
    if len(index) < _MIN_ROI_EVENTS:
        return None
    last = index[min(_FIRST_ROI_EVENTS, len(index)) - 1]
    return max(int(events.t[last] - events.t[0]), 2)


def _confirmed(window, place, duration, measured, config):
    """The proposal, if both halves of the window and the two behind it find the same motion; one of them may not."""
    v, gain, clarity, roi_events, all_events = measured
    half = duration // 2
    limits = (config.sensor_width - config.roi_width, config.sensor_height - config.roi_height)
    velocities, gains = [v], [gain]
    there, agree = 0, 0
    # Begin and length of each window, and by how many v the object has moved on until its middle.
    windows = ((0, half, -0.5), (half, half, 0.5), (duration, duration, 2), (2 * duration, duration, 4))
    for begin, length, moved in windows:
        at = np.clip(np.array(place) + moved * v, 0, limits)
        other = _measure(window, at, begin, length, config)
        if other is None and begin < duration:
            return None
        if other is None:  # the recording ends there
            continue
        there += 1
        scale = duration / length
        differs = math.dist(other[0] * scale, v) > _AGREE * math.hypot(*v) + 0.3 * scale
        if differs or other[1] < _MIN_GAIN ** (1 / scale):
            continue
        agree += 1
        if length == duration:
            velocities.append(other[0])
            gains.append(other[1])
    if agree < max(there - 1, 2):
        return None
    v = np.mean(velocities, axis=0)
    # Two digits are enough, and look like what they are.
    scale = TARGET_PX / math.hypot(*v)
    exact = all_events * scale
    unit = 10 ** max(math.floor(math.log10(max(exact, 1))) - 1, 0)
    batch_events = max(round(exact / unit) * unit, 2)
    share = batch_events / all_events
    roi_events = round(roi_events * share)
    fields = {}
    if batch_events > config.max_batch_events:
        fields["max_batch_events"] = (1 << batch_events.bit_length()) - 1
    # A reserve, because the rate is not the same in all batches.
    wanted = math.ceil(1.3 * roi_events / config.buffer_events)
    if wanted > config.thinning:
        fields["thinning"] = min(wanted, 255)
    half_s = duration / 2e6
    return Proposal(
        roi=tuple(map(int, place)),
        start_event=window.start,
        batch_events=batch_events,
        batch_us=round(duration * share),
        roi_events=roi_events,
        v=tuple((v * share).tolist()),
        px_per_s=tuple((v / half_s).tolist()),
        gain=float(np.median(gains)),
        clarity=clarity,
        fields=fields,
    )


def require(proposals, count, recording):
    """``proposals``, if there are ``count``; otherwise :exc:`ConfigError`, in one line."""
    if len(proposals) < count:
        what = "nothing moves" if not proposals else f"only {len(proposals)} of {count} objects move"
        raise ConfigError(f"{recording.name}: --roi auto: {what} clearly enough; --roi X,Y is needed")
    return proposals
