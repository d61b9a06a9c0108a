"""Proposals: an ROI, and batches in which its image moves by about 4 px per half batch.

The motion in an ROI is the contrast's highest peak over a grid of velocities, coarse to fine. Positions are dithered;
no start value is needed.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from ...config.regions import MOST_STORED
from ...errors import ConfigError
from ...waiting import waiting
from ..iwe import dithered, events_in_roi, image_of_warped_events
from .statistics import Window, busy_places, surveyed

REACH_PX = 10  # velocities that the grid holds, px per half window


def estimate(x, y, dt, width, height):
    """``(v, gain, clarity)``: the velocity at which the image of warped events is sharpest, float64 [2], and how sharp.

    ``x``, ``y``, float64 [n], are positions in an ROI of ``width`` × ``height`` px, ``dt`` scaled times, −1 … 1; v is
    in px per half window. ``gain`` is the contrast at v over the one at v = 0. ``clarity`` is the share of the contrast
    that is lost 3 px away in the direction in which least is, in an image of pixels twice as wide: near 0 where all
    edges have one direction, along which the motion cannot be seen.
    """
    x, y = dithered(x, y)

    def contrast(v, level, border=0):
        size = {"width": width + 2 * border, "height": height + 2 * border}
        return image_of_warped_events(x + border, y + border, dt, v, **size, level=level).var()

    grid = np.arange(-REACH_PX, REACH_PX + 1.0)
    v = max(((vx, vy) for vx in grid for vy in grid), key=lambda v: contrast(v, 2))
    for level, step in ((1, 1.0), (1, 0.5), (0, 0.5), (0, 0.25), (0, 0.125)):
        best = contrast(v, level)
        while True:
            around = [(v[0] + a * step, v[1] + b * step) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]
            values = [contrast(near, level) for near in around]
            if max(values) <= best:
                break
            best, v = max(values), around[int(np.argmax(values))]
            if max(map(abs, v)) > REACH_PX + 2:
                break
    still = contrast((0.0, 0.0), 0)
    # With a border that no event leaves: what is lost there says nothing of the peak.
    ring = [(v[0] + 3 * math.cos(a), v[1] + 3 * math.sin(a)) for a in np.arange(16) * math.pi / 8]
    peak, *around = (contrast(near, 1, border=16) for near in (v, *ring))
    clarity = 1 - max(around) / max(peak, 1e-12)
    return np.array(v), best / max(still, 1e-12), clarity


#: Motion that the proposal aims at, px per half batch, and what is accepted.
TARGET_PX = 4.0
ALLOWED_PX = (3.0, 5.0)

_STARTS = 8  # starts, evenly over the recording's events
_ROUNDS = 8  # changes of the window's length
_USED_EVENTS = 2000  # of the ROI, thinned evenly
_MIN_ROI_EVENTS = 150
_FIRST_ROI_EVENTS = 600
_MIN_GAIN = 1.08  # contrast at the peak, to that at v = 0
_MIN_CLARITY = 0.03  # see estimate
_AGREE = 0.35  # how far the velocity of other windows may differ, relative
_ALIKE_PX = 0.6  # how far halves of an ROI that is one motion are apart in the median, px per half batch
_HALF_EVENTS = 100  # of the ROI: fewer in one half tell nothing


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """An ROI, and batches in which its image moves by about 4 px per half batch."""

    roi: tuple[int, int]  # left column and top row, px
    start_event: int  # where the motion was measured: first event of the first batch
    batch_events: int  # of the whole sensor
    batch_us: int  # what they last there, µs
    roi_events: int  # of them, in the ROI
    v: tuple[float, float]  # measured velocity, px per half batch
    px_per_s: tuple[float, float]
    gain: float  # of the contrast at v, and how clear its peak is; see `estimate`
    clarity: float
    #: How far the velocities of the ROI's left, right, upper and lower half are from that of the whole, in the median,
    #: px per half batch. Where two motions or depths are in the ROI the contrast's peak is a blend of them.
    apart: float = 0.0
    fields: dict = field(default_factory=dict)  # of the configuration, that these batches need

    def suited(self, config, given):
        """``config`` with the fields that these batches need, but for those whose names are in ``given``."""
        return config.replace(**{name: value for name, value in self.fields.items() if name not in given})

    @property
    def alike(self):
        """Whether most halves of the ROI move as the whole does."""
        return self.apart <= _ALIKE_PX

    @property
    def px(self):
        """|v|, px per half batch."""
        return math.hypot(*self.v)

    @property
    def text(self):
        """The proposal in one line."""
        x, y = self.roi
        return f"ROI {x},{y} from event {self.start_event} on, {self.batch_events} events a batch: {self.reason}"

    @property
    def reason(self):
        """One sentence for people."""
        apart = f"; its halves are {self.apart:.1f} px apart: there may be two motions or depths in it"
        return (
            f"the image moves at {math.hypot(*self.px_per_s):,.0f} px/s there, so in {self.batch_events:,} events, "
            f"{self.batch_us / 1e3:,.3g} ms, it moves by {self.px:.1f} px per half batch; "
            f"{ALLOWED_PX[0]:g} to {ALLOWED_PX[1]:g} px are measured best{'' if self.alike else apart}"
        )


def propose(recording, survey, config, *, count=1, start_event=None, tick=lambda: None):
    """List of :class:`Proposal` for up to ``count`` objects that do not overlap, the clearest first.

    Empty where nothing moves clearly. All have one ``start_event``: the one that is given, or the recording's start or,
    if nothing moves clearly there, later. Hot pixels of the ``survey`` of the whole recording are left out, and its
    number of events says where to look; without it, only the start is looked at. ``tick()`` is called now and then.
    """
    if config.binning:
        raise ConfigError(f"binning = {config.binning}: an ROI is proposed in the sensor's pixels; --roi X,Y is needed")
    starts = [start_event]
    if start_event is None:
        starts = sorted({(survey.events if survey else 0) * k // _STARTS for k in range(_STARTS)})
    hot = survey.hot_pixels() if survey else []
    best = []
    for start in starts:
        found = _from(recording, start, config, hot, count, tick)
        if len(found) == count and all(one.alike for one in found):
            return found
        best = max(best, found, key=lambda found: (len(found), sum(one.alike for one in found)))
    return best


def _from(recording, start, config, hot, count, tick):
    window = Window(recording, start, config)
    tried = [_try(window, place, config, tick) for place in busy_places(window.first(), config, hot, recording)]
    chosen = []
    for one in sorted(filter(None, tried), key=lambda one: (0, -one.clarity) if one.alike else (1, one.apart)):
        apart = [np.abs(np.subtract(one.roi, other.roi)) >= (config.roi_width, config.roi_height) for other in chosen]
        if len(chosen) < count and all(map(np.any, apart)):
            chosen.append(one)
    return chosen


def _found(x, y, dt, config):
    """:func:`estimate` of some of so many events, evenly."""
    used = slice(None, None, math.ceil(len(x) / _USED_EVENTS))
    return estimate(x[used], y[used], dt[used], config.roi_width, config.roi_height)


def _measure(window, place, begin_us, duration_us, config):
    """``(v, gain, clarity, all events, (x, y, dt) in the ROI)`` of a window of time; None where it is almost empty."""
    events = window.during(begin_us, duration_us)
    if events is None or len(events) < 2:
        return None
    span = int(events.t[-1] - events.t[0])
    index, x, y = events_in_roi(events, np.round(place).astype(int), config.roi_width, config.roi_height)
    if len(index) < _MIN_ROI_EVENTS or not span:
        return None
    inside = x, y, (2 * (events.t[index] - events.t[0]) - span) / span
    return *_found(*inside, config), len(events), inside


def _apart(x, y, dt, v, config):
    """How far the ROI's halves move from ``v``, in the median, px per half window; 0.0 where they have few events."""
    width, height = config.roi_width // 2, config.roi_height // 2
    halves = [half for half in (x < width, x >= width, y < height, y >= height) if half.sum() >= _HALF_EVENTS]
    apart = [math.dist(_found(x[half], y[half], dt[half], config)[0], v) for half in halves]
    return float(np.median(apart)) if apart else 0.0


def _try(window, place, config, tick):
    """A :class:`Proposal` for an ROI at ``place``, or None if the motion in it is not clear."""
    tick()
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
        v, gain, clarity, *_ = measured
        px = math.hypot(*v)
        if abs(px - TARGET_PX) <= 0.6 and gain >= _MIN_GAIN and clarity >= _MIN_CLARITY:
            return _confirmed(window, place, duration, measured, config)
        factor = 0.4 if px > REACH_PX - 1 else min(TARGET_PX / max(px, 1), 3.0)
        duration = max(round(duration * factor), 2)
    return None


def _first_duration(window, place, config):
    """Time in which the ROI sees some hundred events, µs; None if it does not."""
    events = window.first()
    index, _, _ = events_in_roi(events, place, config.roi_width, config.roi_height)
    if len(index) < _MIN_ROI_EVENTS:
        return None
    last = index[min(_FIRST_ROI_EVENTS, len(index)) - 1]
    return max(int(events.t[last] - events.t[0]), 2)


def _confirmed(window, place, duration, measured, config):
    """The proposal, if both halves of the window and the two behind it find the same motion; one of them may not."""
    v, gain, clarity, all_events, inside = measured
    apart = _apart(*inside, v, config)
    half = duration // 2
    limits = (config.geometry.roi_x_max, config.geometry.roi_y_max)
    velocities, gains, there, agree = [v], [gain], 0, 0
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
    batch_events = round(exact / unit) * unit
    if (there := len(window.first(batch_events))) < batch_events:  # no batch is longer than the recording
        batch_events = there // unit * unit
    batch_events = max(batch_events, 2)
    share = batch_events / all_events
    roi_events = round(len(inside[0]) * share)
    fields = {}
    if batch_events > config.max_batch_events:
        fields["max_batch_events"] = (1 << batch_events.bit_length()) - 1
        if config.regions:
            fields["max_batch_events"] = min(fields["max_batch_events"], MOST_STORED)
    # A reserve, because the rate is not the same in all batches.
    wanted = math.ceil(1.3 * roi_events / config.buffer_events)
    if wanted > config.thinning and not config.regions:  # of these each has a stride
        fields["thinning"] = min(wanted, config.widths.thinning_max)
    half_s = duration / 2e6
    return Proposal(
        roi=tuple(map(int, place)), start_event=window.start, batch_events=batch_events,
        batch_us=round(duration * share), roi_events=roi_events, v=tuple((v * share).tolist()),
        px_per_s=tuple((v / half_s).tolist()), gain=float(np.median(gains)), clarity=clarity, apart=apart,
        fields=fields,
    )  # fmt: skip


def survey_and_propose(recording, config, *, count=1, start_event=None):
    """:func:`propose` after a survey; :exc:`ConfigError` for fewer proposals, or events that come once."""
    survey = surveyed(recording, "--roi auto", "--roi X,Y is needed")
    with waiting("Looking for motion") as bar:
        found = propose(recording, survey, config, count=count, start_event=start_event, tick=bar.update)
    return require(found, count, recording)


def require(proposals, count, recording):
    """``proposals``, if there are ``count``; otherwise :exc:`ConfigError`, in one line."""
    if len(proposals) < count:
        what = "nothing moves" if not proposals else f"only {len(proposals)} of {count} objects move"
        far = f"clearly and far enough ({TARGET_PX:g} px in half of a batch)"
        raise ConfigError(f"{recording.name}: --roi auto: {what} {far}; --roi X,Y is needed")
    return proposals
