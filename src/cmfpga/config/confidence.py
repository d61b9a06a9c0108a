"""What hardware needs that tells how sure v is."""

from ..errors import ConfigError


def check_confidence(config):
    """Raise :exc:`ConfigError` unless the last iteration's sums can be compared with those beside v."""
    for name in ("cold", "warm"):
        if (stride := getattr(config.schedules, name)[-1].stride) > 1:
            raise ConfigError(
                f"confidence = 1: the last iteration of {name} has stride {stride}: it needs all events, as the probes"
            )


def check_beside(config):
    """Raise :exc:`ConfigError` unless velocities ¾ px beside v can be written."""
    if config.v_frac < 2:
        raise ConfigError(
            f"ascent = {config.ascent}: v_frac = {config.v_frac}: 2 or more is needed for what lies ¾ px beside v"
        )
