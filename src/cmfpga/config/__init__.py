"""The configuration that shapes hardware, models and tools. Imports neither Amaranth nor NumPy nor torch."""

from .config import ASCENTS, GRADIENTS, RAM_STYLES, START_MODES, Config, unread
from .presets import DEFAULT_PRESET, PRESETS, SLIDING_PRESET, preset
from .schedule import ScheduleEntry

__all__ = [
    "ASCENTS", "DEFAULT_PRESET", "GRADIENTS", "PRESETS", "RAM_STYLES", "SLIDING_PRESET", "START_MODES", "Config",
    "ScheduleEntry", "preset", "unread",
]  # fmt: skip
