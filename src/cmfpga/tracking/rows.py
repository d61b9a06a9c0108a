"""Hardware for several objects: each is a row of its table of regions."""

from ..config import preset
from ..errors import ConfigError

#: What a configuration without a table of regions takes from this preset; and how many events of the whole sensor its
#: store holds then.
PRESET, FIELDS, STORED_EVENTS = "objects", ("regions", "units", "bin_bits", "store_style"), 65535


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
