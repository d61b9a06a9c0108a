"""How long batches are chosen: so that the image moves by 3 to 5 px in half of one.

In shorter batches v is measured too large and scatters, in longer ones objects turn and deform. A track begins with a
:meth:`~FittedCutter.survey`; from then on each batch says how long the next one is (:func:`fit`): of several objects
that share it, the fastest to be trusted. Equal events and results give equal lengths. Figures: docs/track.md.
"""

import functools
import math

from ..config.presets import BATCH_EVENTS
from ..events import WAITING, BatchCutter, LiveSource
from ..imaging.camera import extent, seen
from ..imaging.iwe import events_in_roi
from ..protocol.confidence import confidence, is_judged, is_sure
from ..protocol.flags import Flag

#: Motion of the image that is aimed at, and between what a batch keeps its length, px per half batch.
TARGET_PX, ALLOWED_PX = 4.0, (3.0, 5.0)

#: Batches in a row that are not to be trusted, after which an object counts as lost.
LOST_BATCHES = 3

#: So many events at most are surveyed for windows that slide: no batch of hardware has them.
SURVEYED_EVENTS = 1 << 21

_SURVEY_US = 500_000  # of events, at most, so that a camera's first answer comes soon
_SURVEY_S = 0.7  # after the first event a survey waits no longer for a stream that comes more slowly than recorded
_FIRST_ROI_EVENTS = 150  # of the survey's first window
_GROWTH = 1.6  # from window to window
_AGREE = 0.25  # how far the velocities of two windows may differ, relative
_AGREE_SURE = 0.55  # where both have twice the confidence that is trusted: it is the object that speeds up
STILL_PX, _MIN_PX = 0.5, 2.0  # of a survey's window: from here on it moves, and far enough
_WINDOWS = 9  # of one length, of which two that follow each other may agree
_TRIALS = 6  # of a first length of another motion than translation
_FULL = 0.95  # so far a buffer is to be filled by a shorter batch, where the image moves by FILLED_PX in half of it
FILLED_PX = 2.8
_REACH = 16  # no batch becomes longer, times the last that was to be trusted, or else the survey's first window


def fit(events, moved, trusted):
    """Number of events of the next batch, by the ``events`` of the whole sensor of the one that is over.

    In half of that the image ``moved`` so far, px. As many where this is not ``trusted``, or is :data:`ALLOWED_PX`;
    else so many that it moves by :data:`TARGET_PX`, but no less than half and no more than twice as many.
    """
    if not trusted or ALLOWED_PX[0] <= moved <= ALLOWED_PX[1]:
        return events
    return max(round(events * min(max(TARGET_PX / max(moved, 1e-9), 0.5), 2.0)), 1)


class FittedCutter(BatchCutter):
    """Cuts batches of as many events as suit the motion; ``size`` is that of the next one.

    The first has ``first`` events; without, a :meth:`survey` chooses it. Where the confidence is not measured, these
    are those of the survey's first trial. None has more than ``max_events`` of the whole sensor.
    """

    way = TARGET_PX  #: how far the survey expects the image to move in half a batch, px

    def __init__(self, source, config, *, start_event=0, first=None, max_events):
        size = min(first or 1, max_events)
        super().__init__(
            source, start_event=start_event, events=size, max_events=max_events, seen=functools.partial(seen, config)
        )
        self._config, self._surveyed = config, first is not None and not config.motion_model.basis
        self._shortest = self._sure = self.size
        self._doubtful = 0  # batches in a row
        self._answer_by = None  # of a stream

    def survey(self, trial, *rois):
        """Choose the first length by batches on trial; their events stay, and are cut afterwards.

        Two windows, one after the other, grow until one is to be trusted and the other nearly, their velocities agree,
        and the image moves far enough; of several objects, in one of them. Where the first two do not agree, those
        after them are tried: an object may rest at first. Where no two agree before the events or ``max_events`` end,
        the shortest window counts that is to be trusted and moves far enough, or else the longest that is to be trusted
        and moves at all. If none is, batches are up to 16 times as long as the first window, and no longer than an
        eighth of the events.

        ``trial(events)`` gives of each object the :class:`BatchResult` of these events in a batch that starts cold;
        ``rois`` are (x, y, width, height) of each. Yields None where the source has no events yet.
        """
        if self._surveyed:
            return
        self._surveyed, found, alone = True, None, None  # (length, px): of two that agree, and of a trusted window
        if self._config.motion_model.basis:
            return (yield from self._trials(trial, *rois))
        length = self._shortest = self._sure = yield from self._first_length(rois)
        while True:
            half = min(length, len((yield from self.ahead(2 * length))) // 2)
            agreed, sure = yield from self._windows(trial, half, _WINDOWS if half == length else 2)
            found = (half, agreed) if agreed >= _MIN_PX else found
            if sure:
                self._sure = half
                alone = alone if sure < STILL_PX or (alone and alone[1] >= ALLOWED_PX[0]) else (half, sure)
            if half < length or length == self.max_events or (found and found[1] >= ALLOWED_PX[0]):
                break
            length = min(int(length * _GROWTH) + 1, self.max_events)
        if found or alone:
            count, moved = found or alone
            self.size = min(fit(count, moved, True), self.max_events)
            self.way = moved * self.size / count
        else:
            self.size = max(min(_REACH * self._shortest, half // 4), self._shortest)
        ahead = yield from self.ahead(self.size)
        self.size = max(len(ahead), 1)
        if (found or alone) and len(rois) == 1:
            (roi,) = rois
            inside = len(events_in_roi(self._seen(ahead), roi[:2], *roi[2:])[0])
            length = self._filling(self.size, inside, self.way)
            self.size, self.way = length, self.way * length / self.size

    def _windows(self, trial, length, count):
        """How far the image moves in windows of this length, one after the other, up to two that agree, px.

        In the first two that agree; the farthest in any that is to be trusted. 0 where there are none.
        """
        last, agreed, sure = (), 0.0, 0.0
        for k in range(count if length else 0):
            ahead = yield from self.ahead((k + 1) * length)
            if agreed or len(ahead) < (k + 1) * length or len(ahead) > 2 * self.max_events:
                break
            window = trial(ahead[k * length :])
            sure = max([sure, *(math.hypot(*one.v) for one in window if is_sure(one))])
            pairs = [pair for pair in zip(last, window, strict=False) if any(map(is_sure, pair)) and self._agree(*pair)]
            agreed, last = max([0.0, *(math.hypot(*one.v) for one, _ in pairs)]), window
        return agreed, sure

    def _trials(self, trial, *rois):
        """The same of another motion than translation: a batch is tried until the image moves far enough.

        Of several objects the farthest counts, of those that are to be trusted where there are any.
        """
        for _ in range(_TRIALS):
            ahead = yield from self.ahead(self.size)
            results = trial(ahead)
            self.size = len(ahead) or 1
            known = [one for one in zip(results, rois, strict=True) if Flag.DEGENERATE not in one[0].flags]
            known = [one for one in known if is_sure(one[0])] or known
            moved = max((extent(self._config, result.v, roi[:2]) for result, roi in known), default=0.0)
            length = min(fit(self.size, moved, bool(known)), self.max_events)
            if length == self.size:
                return
            self.size = max(len((yield from self.ahead(length))), 1)

    def ahead(self, count):
        """:meth:`peek`, once the events are there.

        Of a stream none that come later than :data:`_SURVEY_US`, or :data:`_SURVEY_S` after the first came.
        """
        while (first := self.peek(1)) is WAITING:
            yield None
        if not (isinstance(self._source, LiveSource) and len(first)):
            while (ahead := self.peek(count)) is WAITING:
                yield None
            return ahead
        self._source.answer_by = self._answer_by = self._answer_by or self._source.came + _SURVEY_S
        ahead = self.peek(count, int(first.t[0]) + _SURVEY_US)
        self._source.answer_by = None
        return self.waiting if ahead is WAITING else ahead

    def _agree(self, *windows):
        """Whether two windows, one after the other, one of them to be trusted, saw the same motion."""
        if not all(map(is_judged, windows)) or math.hypot(*windows[0].v) < STILL_PX:
            return False
        share = min(confidence(self._config, window) for window in windows) / self._config.confidence_limit
        if share < 0.5:
            return False
        one, two = ((window.v[0] / window.span, window.v[1] / window.span) for window in windows)
        allowed = _AGREE if share < 2 else _AGREE_SURE
        return math.dist(one, two) <= allowed * max(math.hypot(*one), math.hypot(*two))

    def _first_length(self, rois):
        """Events of the whole sensor among which some are in one of the ROIs."""
        length = min(2 * _FIRST_ROI_EVENTS, self.max_events)
        while True:
            ahead = yield from self.ahead(length)
            inside = [events_in_roi(self._seen(ahead), roi[:2], *roi[2:])[0] for roi in rois]
            last = [int(one[_FIRST_ROI_EVENTS - 1]) for one in inside if len(one) >= _FIRST_ROI_EVENTS]
            if last:
                return min(last) + 1
            if len(ahead) < length or length == self.max_events:
                return length
            length = min(2 * length, self.max_events)

    def add(self, batches):
        """Take a :class:`~cmfpga.tracking.loop.TrackedBatch` of each object, and choose the length of the next ones."""
        judges, results = _judges(self._config), [one.result for one in batches]
        trusted = [one for one in results if (is_sure(one) if judges else Flag.DEGENERATE not in one.flags)]
        self._doubtful = 0 if trusted else self._doubtful + 1
        self._sure = self.size if trusted else self._sure
        moved = max((extent(self._config, one.v, one.roi) for one in trusted), default=0.0)
        self.size = min(fit(self.size, moved, bool(trusted)), self.max_events)
        if trusted and len(batches) == 1 and not results[0].overflow:
            share = self.size / max(len(batches[0].events), 1)
            inside = share * (results[0].roi_events + results[0].thinned)
            self.size = self._filling(self.size, inside, moved * share)
        if self._doubtful and self._doubtful % LOST_BATCHES == 0:
            self.size = 2 * self.size if 2 * self.size <= min(_REACH * self._sure, self.max_events) else self._shortest

    def _filling(self, size, inside, moved):
        """``size``, in which so many events come in the ROI and the image moves so far, px; or less, if more are kept.

        More events than the buffer holds are thinned by halves. The confidence counts pairs of events: of a few events
        too many it would be a quarter. The image is still to move by :data:`FILLED_PX`.
        """
        ahead = inside / self._config.buffer_events
        if ahead <= 1:
            return size
        shorter = _FULL * 2 ** math.floor(math.log2(ahead)) / ahead
        return max(round(size * shorter), 1) if shorter * moved >= FILLED_PX else size


def _judges(config):
    """Whether each batch says how far it is to be trusted."""
    return config.confidence and config.judge


def batch_cutter(source, config, *, start_event=0, first=None, usual=BATCH_EVENTS, most=None, **size):
    """What cuts a track's batches: as ``size``, an argument of :class:`BatchCutter`, says; or else as suits the motion.

    Where the length is chosen, the first batch has ``first`` events, and none more than ``most``, the configuration's
    ``max_batch_events``, or :data:`SURVEYED_EVENTS` of windows that slide. Where it cannot be chosen because the
    confidence is not measured, each has ``usual`` events, fewer where the hardware does not count so far.
    """
    if isinstance(source, LiveSource) and source.width is None:
        source.width, source.height = config.sensor_width, config.sensor_height
    limit = SURVEYED_EVENTS if config.slides else config.max_batch_events
    if not size and (config.motion_model.basis or _judges(config)):
        first = first or (config.buffer_events // 2 if config.motion_model.basis else None)
        return FittedCutter(source, config, start_event=start_event, first=first, max_events=min(limit, most or limit))
    size, placed = size or {"events": first or min(usual, limit)}, functools.partial(seen, config)
    return BatchCutter(source, start_event=start_event, max_events=limit, seen=placed, **size)
