"""What the hardware can be built with or without, and the fields that only each choice reads."""

from .ascent import ASCENTS

#: Gradient architectures.
GRADIENTS = {"sweep": (), "one_pass": ("tag_bits", "confidence")}
#: Whether positions are undistorted.
UNDISTORTION = {"off": (), "on": ("undistortion_cell", "undistortion_frac", "camera")}
#: What is evaluated: batches out of event buffers, or a ring's newest events again and again.
WINDOWS = {
    "batches": ("buffers", "when_full", "thin_target", "start", "cold_after_doubtful"),
    "sliding": ("window_events", "window_us", "hop_events", "hop_us", "follow", "after"),
}

#: ``{field: {its value: the fields that only this value reads}}``.
CHOICES = {
    "gradient": GRADIENTS,
    "ascent": {name: rule.fields for name, rule in ASCENTS.items()},
    "confidence": {0: (), 1: ("judge", "confidence_limit", "cold_after_doubtful")},
    "windows": WINDOWS,
    "undistortion": UNDISTORTION,
    "hot_pixels": {0: (), 1: ("hot_mask",)},
    "background": {0: (), 1: ("background_cell", "background_us")},
}
