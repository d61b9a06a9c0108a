"""What windows that slide need."""

from ..errors import ConfigError
from .checks import check_size


def check_windows(config):
    """Raise :exc:`ConfigError` unless the hardware can hold and time such windows."""
    if not config.slides:
        return
    for name, needed in (("gradient", "one_pass"), ("ascent", "newton"), ("regions", 0)):
        if getattr(config, name) != needed:
            raise ConfigError(f"windows = sliding: {name} = {needed} is needed")
    check_size(config, "window_events", "buffer_events")
    check_size(config, "hop_events", "window_events")
    longest = 1 << (config.span_bits - 1)
    for name, most, why in (
        ("window_us", longest, "half of what span_bits counts to"), ("hop_us", config.window_us or longest, "window_us")
    ):  # fmt: skip
        if getattr(config, name) > most:
            raise ConfigError(f"{name} = {getattr(config, name)}: at most {most} is allowed ({why})")
