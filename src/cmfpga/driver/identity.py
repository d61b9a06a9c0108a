"""Who answers: the discovery registers, and whether this driver fits what they say."""

from .. import __version__
from ..config import PRESETS, Config
from ..errors import ConfigError, WrongHardware
from ..protocol.registers import ID, MAP_VERSION, check, register_map


def identify(backend, config=None):
    """The configuration of the hardware.

    Parameters
    ----------
    backend : Backend
        Only registers are read.
    config : Config, optional
        What it should be; by default what the back end knows, or else whichever preset it is.

    Raises
    ------
    WrongHardware
        Not the accelerator; another version of the package or of the register map; another configuration.
    """
    check_version(backend)
    build = _field(backend, "BUILD", "HASH")
    config = config or backend.config
    presets = wrapped_presets()
    names = {name: preset for name, preset in presets.items() if _hash(preset) == build}
    if config is None:
        if not names:
            raise WrongHardware(
                f"{backend.name}: the hardware has the configuration {build:08x}, which is none of the presets "
                f"{', '.join(presets)}; give config=, from the build-info.json beside its Verilog"
            )
        return next(iter(names.values()))
    if _hash(config) != build:
        is_preset = f" (preset {', '.join(names)})" if names else ""
        raise WrongHardware(
            f"{backend.name}: the hardware has the configuration {build:08x}{is_preset}, "
            f"not {_hash(config):08x}, which was asked for"
        )
    return config


def wrapped_presets():
    """``{name: Config}`` of the presets that the AXI top can be made with."""
    return {name: config for name, config in PRESETS.items() if _fits(config)}


def _fits(config):
    try:
        check(config)
    except ConfigError:
        return False
    return True


def check_version(backend):
    """Raise :exc:`WrongHardware` unless it is an accelerator that this version of the package made."""
    found = _field(backend, "ID", "MAGIC")
    if found != ID:
        raise WrongHardware(
            f"{backend.name}: ID reads {found:#010x}, not {ID:#010x}; "
            f"is the bitstream loaded, and is the address right? {backend.hint()}".rstrip()
        )
    map_version = _field(backend, "CAPS", "MAP")
    if map_version != MAP_VERSION:
        raise WrongHardware(
            f"{backend.name}: the hardware has version {map_version} of the register map, this driver {MAP_VERSION}"
        )
    version = ".".join(str(_field(backend, "VERSION", part)) for part in ("MAJOR", "MINOR", "PATCH"))
    if version != ".".join(__version__.split(".")[:3]):
        raise WrongHardware(
            f"{backend.name}: the hardware was made by cmfpga {version}, this driver is {__version__}; "
            f"install cmfpga {version}, or build the hardware anew"
        )


def _hash(config):
    return register_map(config)["BUILD"]["HASH"].reset


def _field(backend, register, field):
    """A discovery register's field; these are at the same place in every configuration."""
    declared = register_map(Config())[register]
    return declared[field].unpack(backend.read32(declared.offset))
