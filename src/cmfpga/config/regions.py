"""What hardware needs that measures many regions of one batch."""

from ..errors import ConfigError
from ..fixed import bits_for

#: Events of a page of the store; a bin's last page may be part empty.
PAGE_EVENTS = 32

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
        self.number_bits = bits_for(max(1, config.regions) - 1)  #: of a region's number


def check_regions(config):
    """Raise :exc:`ConfigError` unless the hardware for regions can be built."""
    if not config.regions:
        for name in ("units", "slices", "bin_bits", "store_style"):
            if getattr(config, name) != config.__dataclass_fields__[name].default:
                raise ConfigError(f"{name} = {getattr(config, name)}: regions of 1 or more are needed")
        return
    beyond = {"gradient": ("one_pass",), "ascent": ("sign", "newton"), "buffers": (2,)}
    for name, values in beyond.items():
        if getattr(config, name) not in values:
            raise ConfigError(f"regions = {config.regions}: {name} = {' or '.join(map(str, values))} is needed")
    if config.motion == "rotation":
        raise ConfigError(
            f"regions = {config.regions}: motion = rotation: a region sees too little of the field to tell a turn from "
            "a shift; cmfpga flow --fit rotation finds it from all regions of a translation"
        )
    for name in ("thinning", "thin_target"):
        if getattr(config, name) != config.__dataclass_fields__[name].default:
            raise ConfigError(f"regions = {config.regions}: {name}: each region has a stride of its own instead")
    if config.slices > 1 and config.background:
        raise ConfigError(f"slices = {config.slices}: background = 0 is needed, or an event would support itself later")
    if config.slices > config.max_batch_events:
        raise ConfigError(f"slices = {config.slices}: at most max_batch_events = {config.max_batch_events} are allowed")
    if config.max_batch_events > MOST_STORED:
        raise ConfigError(
            f"max_batch_events = {config.max_batch_events}: at most {MOST_STORED} are allowed, for the store holds "
            "them all"
        )


def check_one_region(config):
    """Raise :exc:`ConfigError` of hardware with a table of regions, where one ROI is wanted."""
    if config.regions:
        raise ConfigError(
            f"regions = {config.regions}: this is for one ROI; many regions: cmfpga track, flow and build"
        )
