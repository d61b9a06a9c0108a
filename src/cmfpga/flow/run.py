"""Windows of a recording, one after the other: cut, measured by the hardware, the next one's length chosen."""

import itertools

from ..errors import ConfigError
from ..events import BatchCutter
from ..protocol.settings import BatchSettings
from ..tracking.fit import LOST_BATCHES, fit
from .window import Window

#: Events of the first window that is tried, where their number is to suit the motion.
FIRST_EVENTS = 4000


class Run:
    """Measures the windows of a source.

    Parameters
    ----------
    source : EventSource
        Not a stream: the events of the first windows are looked at before they are cut.
    engine : RegionEngine
    tiles : Tiles
    window_events, window_us : int, optional
        Events, or µs, of each window; without either as many events as suit the motion: the image moves by 3 to 5 px
        in half a window, in the median of the trusted tiles, as far as ``max_batch_events`` allows.
    start_event : int
        Index of the first event.
    windows : int, optional
        Stop after these.

    Attributes
    ----------
    cutter : BatchCutter
        Tells the events that are left over.
    limited : bool
        Some window would have been longer, had the hardware room for its events.
    """

    def __init__(self, source, engine, tiles, *, window_events=None, window_us=None, start_event=0, windows=None):
        config = engine.config
        self._engine, self._tiles, self._count = engine, tiles, windows
        self._limit, self._settings = config.max_batch_events, BatchSettings.from_config(config, roi=(0, 0))
        self._fitted = not (window_events or window_us)
        size = {"duration_us": window_us} if window_us else {"events": window_events or 1}
        if size.get("events", 0) > self._limit:
            raise ConfigError(
                f"windows of {window_events} events: at most {self._limit} are allowed (max_batch_events)"
            )
        self.cutter = BatchCutter(source, start_event=start_event, max_events=self._limit, **size)
        self.limited = False
        engine.write(tiles.regions)

    def __iter__(self):
        lost = LOST_BATCHES
        for index in itertools.count() if self._count is None else range(self._count):
            if self._fitted and lost and lost % LOST_BATCHES == 0:
                self.cutter.size = self._first_size()
            events = self.cutter.next()
            if events is None:
                break
            window = self._measure(index, events)
            if self._fitted:
                lost = 0 if window.moved is not None else lost + 1
                self.cutter.size = self._next_size(len(events), window.moved)
            yield window

    def _measure(self, index, events):
        result = self._engine.run(events, self._settings) if len(events) else None
        return Window(index, self._engine.config, self._tiles, events, result)

    def _next_size(self, count, moved):
        wanted = fit(count, (moved or 0.0,), moved is not None)
        self.limited |= wanted > self._limit
        return min(wanted, self._limit)

    def _first_size(self):
        """Events ahead, ever more of them, until the image moves far enough in what is to be trusted."""
        count = min(FIRST_EVENTS, self._limit)
        while True:
            ahead = self.cutter.peek(count)
            moved = self._measure(0, ahead).moved
            wanted = 2 * count if moved is None else fit(count, (moved,), True)
            if len(ahead) < count or count == self._limit or (moved is not None and wanted <= count):
                self.limited |= len(ahead) == count == self._limit < wanted
                return max(1, min(wanted, len(ahead)))
            count = min(wanted, self._limit)
