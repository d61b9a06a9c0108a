"""Configurations by name, and what every tool assumes where the user says nothing."""

from ..errors import ConfigError, one_of
from .config import Config

#: Engines that run here, and need no board and no AXI; the first is the usual one.
ENGINES = ("rtl", "model", "float")

#: Events of a batch.
BATCH_EVENTS = 5000

#: The clock that the article reports for its design on the KV260, MHz. Which one this core reaches is not known.
CLOCK_MHZ = 210.0

# border: else what leaves the image there pulls v towards 0. Not 2048 events, and not 8 bits of tags: then a pixel of
# the banks has 54 bits, which three halves of a block RAM hold.
_FAST = Config(
    gradient="one_pass", ascent="newton", border="whole", buffer_events=2047, when_full="thin", tag_bits=7, buffers=2,
    max_batch_events=(1 << 18) - 1, max_level=2, dt_frac=8, v_frac=6, position_frac=4, weight_frac=4, derivative_frac=4,
    dither_frac=4, confidence=1, reciprocal_bits=12,
)  # fmt: skip

PRESETS = {
    "paper": Config(),
    # An image four times as deep, in slices that fill block RAMs.
    "fast": _FAST.replace(ram_style="block"),
    # An event in every cycle, for four.
    "quad": _FAST.replace(evaluators=4),
    # The newest events, again after every few of them.
    "sliding": _FAST.replace(evaluators=4, windows="sliding", buffer_events=8191),
    # Images as large lie in UltraRAM, which holds four as well as one that is four times as deep.
    "fast-128": _FAST.replace(
        evaluators=4, roi_width=128, roi_height=128, buffer_events=4095, tag_bits=9, ram_style="ultra"
    ),
    "similarity": _FAST.replace(
        motion="similarity", ascent="sign", confidence_limit=100.0, roi_width=128, roi_height=128, buffer_events=8191,
        tag_bits=9, schedule_entries=64,
    ),
    "rotation": _FAST.replace(
        motion="rotation", ascent="sign", confidence_limit=150.0, roi_width=240, roi_height=180, buffer_events=32767,
        tag_bits=10, schedule_entries=64, max_level=3, undistortion="on", ram_style="ultra",
    ),
    # warm: from the coarse tile's v to a tile's own; the limit: what a tile of few events can reach. Figures:
    # docs/flow.md.
    "flow": _FAST.replace(
        evaluators=4, regions=192, units=5, store_style="ultra", undistortion="on", max_batch_events=32767,
        min_roi_events=30, warm="0:1:1 0:3/4:1/2 0:3/4:1/4", confidence_limit=12.0,
    ),
    "objects": _FAST.replace(regions=32, units=2, max_batch_events=32767, bin_bits=5, store_style="ultra"),
    "full-frame": _FAST.replace(
        evaluators=4, roi_width=240, roi_height=180, buffer_events=8192, tag_bits=10, ram_style="ultra"
    ),
}  # fmt: skip

#: What the commands take if no preset is given; what ``track`` takes, unless something asks for batches.
DEFAULT_PRESET, SLIDING_PRESET = "fast", "sliding"


def preset(name=DEFAULT_PRESET):
    """The preset called ``name``."""
    try:
        return PRESETS[name]
    except (KeyError, TypeError):  # TypeError: a list, say
        raise ConfigError(f"preset {name!r}: {one_of(name, PRESETS)}") from None
