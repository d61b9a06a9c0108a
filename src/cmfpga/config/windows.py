"""What windows that slide need."""

from ..errors import ConfigError
from .checks import check_size

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


def check_windows(config):
    """Raise :exc:`ConfigError` unless the hardware can hold and time such windows."""
    if not config.slides:
        return
    for name, needed in (("gradient", "one_pass"), ("ascent", "newton"), ("regions", 0)):
        if getattr(config, name) != needed:
            raise ConfigError(f"windows = sliding: {name} = {needed} is needed")
    check_size(config, "window_events", "buffer_events")
    if config.hop_events > window_events(config):
        raise ConfigError(
            f"hop_events = {config.hop_events}: at most {window_events(config)} is allowed (window_events)"
        )
    longest = 1 << (config.span_bits - 1)
    for name, most, why in (
        ("window_us", longest, "half of what span_bits counts to"), ("hop_us", config.window_us or longest, "window_us")
    ):  # fmt: skip
        if getattr(config, name) > most:
            raise ConfigError(f"{name} = {getattr(config, name)}: at most {most} is allowed ({why})")
