"""Windows of a recording, one after the other: cut, measured by the hardware, the next one's length chosen."""

import collections
import itertools

from ..errors import ConfigError
from ..events import BatchCutter, Events
from ..events.batches import Batch
from ..protocol.settings import BatchSettings
from ..tracking.fit import LOST_BATCHES, fit
from .window import Window

#: Events of the first window that is tried, where their number is to suit the motion, on a sensor of so many pixels;
#: on a larger one as many more.
FIRST_EVENTS, FIRST_PIXELS = 4000, 240 * 180


class Run:
    """Measures the windows of a source; with ``slices`` a new one ends with every slice, and has the last so many.

    Parameters
    ----------
    source : EventSource
        Not a stream: the events of the first windows are looked at before they are cut.
    engine : Engine
    tiles : Tiles
    window_events, window_us : int, optional
        Events, or µs, of each window; without either as many events as suit the motion: the image moves by 3 to 5 px
        in half a window, in the median of the trusted tiles, as far as ``max_batch_events`` allows; not with slices.
    start_event : int
        Index of the first event.
    windows : int, optional
        Stop after these.

    Attributes
    ----------
    cutter : BatchCutter
    limited : bool
        Some window would have been longer, had the hardware room for its events.
    passed_over : int
        Slices without events.
    """

    def __init__(self, source, engine, tiles, *, window_events=None, window_us=None, start_event=0, windows=None):
        config = engine.config
        self._engine, self._tiles, self._count = engine, tiles, windows
        self._slices = collections.deque(maxlen=config.slices)
        self._limit, self._settings = config.slice_events, BatchSettings.from_config(config, roi=(0, 0))
        self._fitted = not (window_events or window_us)
        mode, size, unit = ("duration_us", window_us, "µs") if window_us else ("events", window_events or 1, "events")
        most = self._limit * config.slices
        if mode == "events" and size > most:
            raise ConfigError(f"windows of {size} events: at most {most} are allowed (max_batch_events)")
        if config.slices > 1 and (self._fitted or size % config.slices):
            wanted = "a length (window_events, window_us)" if self._fitted else f"a multiple of {config.slices} {unit}"
            raise ConfigError(f"windows of {config.slices} slices: {wanted} is needed")
        size = {mode: size // config.slices}
        self._source, self.cutter = source, BatchCutter(source, start_event=start_event, max_events=self._limit, **size)
        self.limited, self.passed_over = False, 0
        engine.write(tiles.regions)

    @property
    def leftover(self):
        """Events after the last window, as far as their number can be known without reading them all."""
        extent = None if self.cutter.leftover else self._source.extent()
        return extent[0] - self.cutter.position if extent else self.cutter.leftover

    def __iter__(self):
        lost = LOST_BATCHES
        for index in itertools.count() if self._count is None else range(self._count):
            if self._fitted and lost and lost % LOST_BATCHES == 0:
                self.cutter.size = self._first_size()
            window = self._next(index)
            if window is None:
                break
            if self._fitted:
                lost = 0 if window.moved is not None else lost + 1
                self.cutter.size = self._next_size(len(window.events), window.moved)
            yield window

    def _next(self, index):
        """The window that ends with the next batch, or slice; at the begin, with the last of the first slices."""
        while (part := self.cutter.next()) is not None:
            if not len(part) and self._slices.maxlen > 1:
                self.passed_over += 1  # nothing to send: the hardware's windows know nothing of it
                continue
            self._slices.append(part)
            every = Events.concatenate(self._slices)
            window = Batch(every.t, every.x, every.y, every.p, self._slices[0].first_event)
            found = self._measure(index, part, window)
            if len(self._slices) == self._slices.maxlen:
                return found
        return None

    def _measure(self, index, events, window):
        (result,) = self._engine.run(events, self._settings)
        return Window(index, self._engine.config, self._tiles, window, result, self._engine.cycles)

    def _next_size(self, count, moved):
        wanted = fit(count, (moved or 0.0,), moved is not None)
        self.limited |= wanted > self._limit
        return min(wanted, self._limit)

    def _first_size(self):
        """Events ahead, ever more of them, until the image moves far enough in what is to be trusted."""
        config = self._engine.config
        share = max(1, config.sensor_width * config.sensor_height // FIRST_PIXELS)
        count = min(FIRST_EVENTS * share, self._limit)
        while True:
            ahead = self.cutter.peek(count)
            moved = self._measure(0, ahead, ahead).moved
            wanted = 2 * count if moved is None else fit(count, (moved,), True)
            if len(ahead) < count or count == self._limit or (moved is not None and wanted <= count):
                self.limited |= len(ahead) == count == self._limit < wanted
                return max(1, min(wanted, len(ahead)))
            count = min(wanted, self._limit)
