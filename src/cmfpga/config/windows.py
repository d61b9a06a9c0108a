"""What windows that slide need."""

from ..errors import ConfigError

#: A window's events where nothing says how many; how many hops its length has.
USUAL_EVENTS, HOPS = 1000, 16


def window_events(config):
    """Most events of a window."""
    return config.window_events or min(USUAL_EVENTS, config.buffer_events)


def hop_events(config):
    """Most events of a hop."""
    return config.hop_events or hop_of(window_events(config))


def hop_of(count):
    """Most events of a hop, where a window has so many."""
    return max(1, round(count / HOPS))


def check_lengths(config, given):
    """Raise :exc:`ConfigError` unless windows and hops may be as long as the settings ``given`` to a run say."""
    longest = 1 << (config.span_bits - 1)
    for name, low, high in (
        ("window_events", 1, config.buffer_events),
        ("hop_events", 1, given.window_events),
        ("window_us", 0, longest),
        ("hop_us", 0, given.window_us or longest),
    ):
        if not low <= (value := getattr(given, name)) <= high:
            raise ConfigError(f"{name} = {value}: {low} to {high} is needed")


def needs_batches(config, what):
    """Raise :exc:`ConfigError` where windows slide, for ``what`` knows batches alone."""
    if config.slides:
        raise ConfigError(f"{what}: windows = batches is needed; windows = sliding has none")
