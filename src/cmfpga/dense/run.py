"""Windows of a recording, one after the other, for all tiles: the loop of :mod:`cmfpga.tracking.loop`."""

from ..errors import ConfigError
from ..events import BatchCutter
from ..tracking.fit import LOST_BATCHES, FittedCutter, fit
from ..tracking.loop import Table
from ..tracking.loop import windows as measured
from .window import Window

#: Events of the first window that is tried, where their number is to suit the motion, on a sensor of so many pixels;
#: on a larger one as many more.
FIRST_EVENTS, FIRST_PIXELS = 4000, 240 * 180


class FieldCutter(FittedCutter):
    """Cuts windows in half of which the image moves by 3 to 5 px, in the median of the trusted tiles.

    Attributes
    ----------
    limited : bool
        Some window would have been longer, had the hardware room for its events.
    """

    def __init__(self, source, config, start_event):
        super().__init__(source, config, start_event=start_event, max_events=config.slice_events)
        self.limited, self._doubtful = False, LOST_BATCHES

    def survey(self, trial, *_):
        """Choose the first length, or the next one of a motion that is lost.

        Windows on trial grow until the image moves far enough: ``trial(events)`` says how far, in px, or None.
        """
        if not self._doubtful or self._doubtful % LOST_BATCHES:
            return
        share = max(1, self._config.sensor_width * self._config.sensor_height // FIRST_PIXELS)
        count = min(FIRST_EVENTS * share, self.max_events)
        while True:
            ahead = yield from self.ahead(count)
            moved = trial(ahead)
            wanted = 2 * count if moved is None else fit(count, (moved,), True)
            if len(ahead) < count or count == self.max_events or (moved is not None and wanted <= count):
                self.limited |= len(ahead) == count == self.max_events < wanted
                self.size = max(1, min(wanted, len(ahead)))
                return
            count = min(wanted, self.max_events)

    def add(self, window):
        """Take a :class:`~.window.Window`, and choose the length of the next ones."""
        self._doubtful = 0 if window.moved is not None else self._doubtful + 1
        wanted = fit(len(window.events), (window.moved or 0.0,), window.moved is not None)
        self.limited |= wanted > self.max_events
        self.size = min(wanted, self.max_events)


class Run(Table):
    """Measures the windows of a source; with ``slices`` a new one ends with every slice, and has the last so many.

    Parameters
    ----------
    source : EventSource
        Not a stream: the events of the first windows are looked at before they are cut.
    engine : Engine
    tiles : Tiles
    window_events, window_us : int, optional
        Events, or µs, of each window; without either as many events as suit the motion, as far as ``max_batch_events``
        allows; not with slices.
    start_event : int
        Index of the first event.
    windows : int, optional
        Stop after these.
    """

    def __init__(self, source, engine, tiles, *, window_events=None, window_us=None, start_event=0, windows=None):
        super().__init__(engine)
        config = self.config
        self._source, self._tiles, self._count = source, tiles, windows
        mode, size, unit = ("duration_us", window_us, "µs") if window_us else ("events", window_events or 0, "events")
        if mode == "events" and size > (most := config.slice_events * config.slices):
            raise ConfigError(f"windows of {size} events: at most {most} are allowed (max_batch_events)")
        if config.slices > 1 and (not size or size % config.slices):
            wanted = f"a multiple of {config.slices} {unit}" if size else "a length (window_events, window_us)"
            raise ConfigError(f"windows of {config.slices} slices: {wanted} is needed")
        if size:
            size = {mode: size // config.slices}
            self.cutter = BatchCutter(source, start_event=start_event, max_events=config.slice_events, **size)
        else:
            self.cutter = FieldCutter(source, config, start_event)
        engine.write(tiles.regions)

    @property
    def leftover(self):
        """Events after the last window, as far as their number can be known without reading them all."""
        extent = None if self.cutter.leftover else self._source.extent()
        return extent[0] - self.cutter.position if extent else self.cutter.leftover

    @property
    def limited(self):
        """Whether some window would have been longer, had the hardware room for its events."""
        return isinstance(self.cutter, FieldCutter) and self.cutter.limited

    def __iter__(self):
        return measured(self.engine, self.cutter, self, self._count)

    def trial(self, events, settings):
        return self.window(0, events, self.measure(events, settings)).moved

    def window(self, index, events, result):
        return Window(index, self.config, events, result, self._tiles, self.engine.cycles)
