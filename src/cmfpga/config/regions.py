"""What hardware needs that measures many regions of one batch."""

from ..errors import ConfigError
from ..fixed import bits_for

#: Events of a page of the store; a bin's last page may be part empty.
PAGE_EVENTS = 32

#: Units that one reader of the store keeps busy.
READER_UNITS = 4

#: Largest batch that a store holds, in events.
MOST_STORED = 1 << 18


class Regions:
    """Sizes of the store of events and of the table of regions, of a :class:`~cmfpga.config.Config`."""

    def __init__(self, config):
        side = 1 << config.bin_bits
        self.columns, self.rows = (-(-size // side) for size in config.geometry.size)  #: of bins
        self.column_bits = bits_for(self.columns - 1)  #: of a bin's address; the row stands above them
        self.bins = self.rows << self.column_bits  #: words of a table of bins, those unused included
        #: Pages that no batch can exceed: each bin leaves at most one of them part empty.
        self.pages = (config.max_batch_events + self.columns * self.rows * (PAGE_EVENTS - 1)) // PAGE_EVENTS
        self.readers = -(-config.units // READER_UNITS)  #: distributors, each with a store of its own
        self.number_bits = bits_for(max(1, config.regions) - 1)  #: of a region's number


def check_one_region(config):
    """Raise :exc:`ConfigError` of hardware with a table of regions, where one ROI is wanted."""
    if config.regions:
        cure = "many regions: cmfpga track, flow and build"
        raise ConfigError(f"regions = {config.regions}: this is for one ROI; {cure}")
