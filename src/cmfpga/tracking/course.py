"""One object of a track: where its ROI goes after a doubtful batch, and with which settings each batch was run."""

from ..imaging.camera import seen
from ..imaging.iwe import events_in_roi
from ..protocol.confidence import is_sure
from ..protocol.flags import Flag
from ..protocol.regions import MOST_STRIDE, Region
from ..protocol.results import thins
from ..protocol.settings import BatchSettings, clamp_roi
from ..reference.integer.filters import next_thinning
from .fit import LOST_BATCHES

_RESERVE = 1.3  # of events that a stride leaves room for: the rate is not the same in all batches


class Course:
    """One object: where its ROI goes after a doubtful batch.

    On at the last trusted velocity; nowhere once the object is lost. With ``cold_after_doubtful=0`` a doubtful batch is
    like any other.
    """

    def __init__(self, config, roi):
        self._config, self.replay = config, Replay(config)
        self.start = roi  # left column and top row of the next batch's ROI, px; None where the engine moves it
        self.row = None  # of the engine's table, a Region
        self._doubtful, self._speed = 0, (0.0, 0.0)  # batches not trusted in a row; px per half µs

    def begin(self, events, place):
        """A new row at a place; of the events in it every so many are stored, so that the buffer holds them."""
        config, stride = self._config, 1
        if config.regions and not thins(config):
            inside, _, _ = events_in_roi(seen(config, events), place, config.roi_width, config.roi_height)
            while len(inside) * _RESERVE > stride * config.buffer_events and stride < 1 << MOST_STRIDE:
                stride *= 2
        self.row = Region.roi(config, place, stride)

    def go_on(self, result):
        """Choose ``start`` by the last batch's result, and return it."""
        self.start = None
        if Flag.DEGENERATE in result.flags:  # not to be trusted either, but nothing moves
            self._doubtful += 1
            return None
        if Flag.DOUBTFUL not in result.flags or not self._config.cold_after_doubtful:
            self._doubtful = 0
            if is_sure(result):
                moved = zip(self._config.motion_model.parameters[:2], result.v, strict=False)
                self._speed = tuple(axis / result.span if one.moves_roi else 0.0 for one, axis in moved)
            return None
        self._doubtful += 1
        share = self._config.roi_gain * result.span * (self._doubtful < LOST_BATCHES)
        ahead = (round(at + share * axis) for at, axis in zip(result.roi, self._speed, strict=True))
        self.start = clamp_roi(self._config, tuple(ahead))[0]
        return self.start


class Replay:
    """Which settings an engine used for each batch: what it keeps between batches, apart from v and the ROI."""

    def __init__(self, config):
        self._config = config
        self._following = False  # the batch before measured v, so the warm schedule applies
        self._thinning = None  # what the batch before asks for

    def settings_of(self, result, settings=None):
        """``(plan, thinning)`` of the next batch, whose :class:`BatchResult` this is; by default as configured.

        ``plan`` has a ``ScheduleEntry`` per iteration; the engine stored one ROI event in ``thinning``.
        """
        config, rule = self._config, self._config.ascent_rule
        settings = settings or BatchSettings.from_config(config)
        self._following &= settings.roi is None
        warm = rule.warm(settings, self._following) and not result.restarted
        plan = rule.plan(settings, warm)[: result.iterations]
        thinning = self._thinning if config.thin_target and self._thinning else config.thinning
        if result.events:
            self._following = Flag.DEGENERATE not in result.flags
            found = result.roi_events + result.overflow + result.thinned
            self._thinning = next_thinning(found, config.thin_target)
        return plan, thinning
