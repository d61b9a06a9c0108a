"""Which settings an engine used for each batch of a track, found from the results of the batches before it."""

from ..protocol.flags import Flag
from ..protocol.settings import BatchSettings
from ..reference.integer.thinner import next_thinning


class Replay:
    """Keeps what the engines keep between batches, apart from v and the ROI."""

    def __init__(self, config):
        self._config = config
        self._following = False  # the batch before measured v, so the warm schedule applies
        self._thinning = None  # what the batch before asks for

    def settings_of(self, result, settings=None):
        """``(plan, thinning)`` of the next batch, whose :class:`BatchResult` this is; by default as configured.

        ``plan`` has a ``ScheduleEntry`` per iteration; the engine stored one ROI event in
        ``thinning``.
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
