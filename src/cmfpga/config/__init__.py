"""The configuration that shapes hardware, models and tools. Imports neither Amaranth nor NumPy nor torch."""

from .config import ASCENTS, DEFAULT_PRESET, GRADIENTS, PRESETS, RAM_STYLES, START_MODES, Config, preset
from .schedule import ScheduleEntry

__all__ = [
    "ASCENTS",
    "DEFAULT_PRESET",
    "GRADIENTS",
    "PRESETS",
    "RAM_STYLES",
    "START_MODES",
    "Config",
    "ScheduleEntry",
    "preset",
]
