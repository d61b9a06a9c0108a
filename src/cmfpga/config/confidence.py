"""What hardware needs that tells how sure v is."""

from ..errors import ConfigError

#: Bits of ΣI, which is squared bit by bit while the probes are summed.
MOST_SUM_BITS = 28


def check_confidence(config):
    """Raise :exc:`ConfigError` unless v can be probed."""
    for name in ("cold", "warm"):
        if (stride := getattr(config.schedules, name)[-1].stride) > 1:
            raise ConfigError(
                f"confidence = 1: the last iteration of {name} has stride {stride}: it needs all events, as the probes"
            )
    check_beside(config, "confidence = 1")
    if config.widths.sum_i_bits > MOST_SUM_BITS:
        raise ConfigError(
            f"confidence = 1: ΣI needs {config.widths.sum_i_bits} bits, at most {MOST_SUM_BITS} are allowed: "
            "a smaller buffer_events or weight_frac is needed"
        )


def check_beside(config, why):
    """Raise :exc:`ConfigError` unless velocities ¾ px beside v can be written."""
    if config.v_frac < 2:
        raise ConfigError(f"{why}: v_frac = {config.v_frac}: 2 or more is needed, for v is probed ¾ px beside it")
