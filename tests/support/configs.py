"""Configurations of blocks under test."""

from cmfpga.config import Config, preset
from cmfpga.driver.control import wrapped_presets

NARROW = {
    "dt_frac": 8, "v_frac": 6, "position_frac": 4, "weight_frac": 4, "derivative_frac": 4,
    "sensor_width": 100, "sensor_height": 50, "roi_width": 32, "roi_height": 16, "buffer_events": 100,
}  # fmt: skip
ODD = {"sensor_width": 40, "sensor_height": 30, "roi_width": 24, "roi_height": 10, "buffer_events": 96}
TINY = {"sensor_width": 9, "sensor_height": 7, "roi_width": 2, "roi_height": 2, "buffer_events": 33}
SENSOR = {"roi_width": 240, "roi_height": 180}

CONFIGS = {
    "default": Config(),
    "narrow": Config(**NARROW),
    "odd": Config(**ODD),
    "tiny": Config(**TINY),
    # Weights and derivatives finer than the products they are rounded from: nothing to round.
    "fine": Config(**ODD, dt_frac=2, v_frac=1, position_frac=4, weight_frac=10, derivative_frac=9),
    "sensor": Config(**SENSOR),
}

#: The presets that the AXI top can be made with.
WRAPPED = [*wrapped_presets()]

#: With coarse levels and dither, sizes that are odd or no power of two among them.
LEVELS = {
    "fast": preset("fast"),
    "fast odd": preset("fast").replace(
        sensor_width=40, sensor_height=30, roi_width=23, roi_height=13, buffer_events=96, max_level=3
    ),
    "fast tiny": preset("fast").replace(
        sensor_width=9, sensor_height=7, roi_width=3, roi_height=2, buffer_events=33, dither_frac=1
    ),
    # As the article's formats, with one coarse level, and a dither finer than a warped position.
    "fast wide": Config(
        **ODD | {"roi_width": 21, "roi_height": 10}, gradient="one_pass", max_level=1, dither_frac=8, position_frac=5
    ),
}

#: Of rounds: few tags; sizes that are odd, and a P that is no power of two; other formats; no levels and no dither.
ROUNDS = {
    "fast": preset("fast").replace(
        sensor_width=40, sensor_height=30, roi_width=16, roi_height=8, buffer_events=48, tag_bits=3
    ),
    "fast odd": LEVELS["fast odd"],
    "fast wide": LEVELS["fast wide"].replace(ascent="newton", border="whole", cold="1:1:1", warm="0:1:1", confidence=1),
    "flat": Config(
        **ODD, gradient="one_pass", ascent="newton", border="whole", v_int=1, confidence=1, cold="0:1:1", warm="0:1:1"
    ),
}

#: Of steps by signs.
SIGNS = {
    "similarity": preset("similarity"),
    "rotation": preset("rotation"),
    # A v of few bits; one level, and a table whose length is no power of two.
    "few bits": preset("similarity").replace(
        v_int=2, v_frac=3, max_level=0, schedule_entries=17, cold="0:0", warm="0:-1"
    ),
}
