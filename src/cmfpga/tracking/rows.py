"""Several objects on one accelerator: each is a row of its table of regions, its result one outcome of the batch."""

from ..config import preset
from ..errors import ConfigError
from ..imaging.camera import seen
from ..imaging.iwe import events_in_roi
from ..protocol.regions import MOST_STRIDE, Region
from ..protocol.results import BatchResult, fields_of, thins
from ..protocol.settings import BatchSettings
from ..protocol.trace import Trace

#: What a configuration without a table of regions takes from this preset; and how many events of the whole sensor its
#: store holds then.
PRESET, FIELDS, STORED_EVENTS = "objects", ("regions", "units", "bin_bits", "store_style"), 65535

_RESERVE = 1.3  # of events that a stride leaves room for: the rate is not the same in all batches


def with_rows(config, count, given):
    """``config`` with a table that has a row for each of ``count`` objects.

    Parameters
    ----------
    config : Config
        Stays as it is where it has regions.
    count : int
    given : dict
        Fields that the user gives; none of these is changed.

    Raises
    ------
    ConfigError
        The hardware cannot have regions, or has too few.
    """
    if not config.regions:
        usual = preset(PRESET)
        fields = {name: getattr(usual, name) for name in FIELDS} | {"max_batch_events": STORED_EVENTS}
        fields["regions"] = max(count, usual.regions)
        try:
            config = config.replace(**{name: value for name, value in fields.items() if name not in given})
        except ConfigError as error:
            raise ConfigError(
                f"several objects are regions of one hardware, which this cannot have: {error}; without --preset and "
                "--set it can, and with one --roi it need not"
            ) from None
    if config.slices > 1:
        raise ConfigError(f"slices = {config.slices}: windows that overlap are for cmfpga flow; 1 is needed")
    if count > config.regions:
        raise ConfigError(f"regions = {config.regions}: {count} objects need as many; --set regions={count}")
    return config


class Rows:
    """Runs batches of all objects, as :func:`~.loop.follow` asks for them.

    An object's row is an ROI like a core's: as large as the image, it begins at its own last v, and moves by it. What
    is to begin elsewhere, or cold, becomes a new row.

    Parameters
    ----------
    engine : RegionEngine
    count : int
        Of the objects.

    Attributes
    ----------
    places : list of pair of int
        Left column and top row of the ROI that each object's next batch is cropped with, px.
    strides : list of int
        Of the events in each object's ROI every so many are stored: as the first batch of its row needs it, unless the
        buffer thins out by itself.
    cycles : int or None
        Clock cycles of the last batch, all objects together; None without a clock, or without events.
    """

    def __init__(self, engine, count):
        self.config, self._engine = engine.config, engine
        self._settings = BatchSettings.from_config(engine.config, roi=(0, 0))
        self._rows, self._last = [None] * count, [None] * count
        self.places, self.strides, self.cycles = [(0, 0)] * count, [1] * count, None

    def run(self, events, settings):
        """A :class:`BatchResult` for each object, of the :class:`BatchSettings` of each."""
        anew = {k for k, one in enumerate(settings) if one.roi or one.start_last != self._settings.start_last}
        for k in anew:
            self.places[k] = settings[k].roi or self.places[k]
            self.strides[k] = self._stride(events, self.places[k])
            self._rows[k] = self._row(*self.places[k], self.strides[k])
        self._engine.write(self._rows, anew)
        if not len(events):
            self.cycles = None
            return [self._nothing(*told) for told in zip(self.places, self._last, strict=True)]
        found = self._engine.run(events, self._settings)
        self.cycles = self._engine.cycles
        shared = {field.name: getattr(found, field.name) for field in fields_of("batch")}
        self._last = [BatchResult(**shared, regions=(outcome,)) for outcome in found.regions]
        self.places = [result.roi_next for result in self._last]
        return self._last

    def _row(self, x, y, stride):
        config = self.config
        start = "last" if self._settings.start_last else "given"
        size = {"width": config.roi_width, "height": config.roi_height}
        return Region(x=x, y=y, **size, start=start, stride=stride, moves=True)

    def _stride(self, events, place):
        config, stride = self.config, 1
        if thins(config):
            return stride
        inside, _, _ = events_in_roi(seen(config, events), place, config.roi_width, config.roi_height)
        while len(inside) * _RESERVE > stride * config.buffer_events and stride < 1 << MOST_STRIDE:
            stride *= 2
        return stride

    def _nothing(self, place, last):
        """A batch without events never reaches the hardware."""
        still = (0,) * len(self.config.motion_model.names)
        v, path = (last.v, last.trace) if last else (still, None)
        trace = Trace.without_iterations(self.config, tuple(path.v[-1].tolist()) if path else still)
        return BatchResult.nothing(roi=place, roi_next=place, v=v, trace=trace)
