"""Random configurations, small enough to be compiled and simulated in seconds."""

import dataclasses
from fractions import Fraction
from types import SimpleNamespace

import numpy as np

from cmfpga.config import Config, unread
from cmfpga.config.motion import MOTIONS, needs
from cmfpga.config.schedule import AUTO, DISTANCES, STRIDES
from cmfpga.errors import ConfigError
from cmfpga.fixed import Q
from cmfpga.protocol.registers import check
from cmfpga.verilog.compiler import cannot_compile

from .batches import random_lens

#: Largest values that are drawn, where the field's own would take too long to simulate, or be refused nearly always.
LARGEST = {
    "roi_width": 64, "roi_height": 48, "buffer_events": 2100, "iterations": 60, "min_roi_events": 20,
    "thin_target": 300, "background_us": 2000, "gradient_int": 14, "gradient_frac": 26,
}  # fmt: skip
#: The same of hardware with a table of regions: a sensor has bins, an iteration is that of every region.
LARGEST_OF_REGIONS = {
    "sensor_width": 300, "sensor_height": 200, "roi_width": 32, "roi_height": 24, "buffer_events": 600,
    "max_batch_events": 1 << 13, "schedule_entries": 40, "regions": 12, "units": 5, "slices": 5,
}  # fmt: skip
_FIELDS = {field.name: field for field in dataclasses.fields(Config)}
OF_REGIONS = ("regions", "units", "slices", "bin_bits", "store_style")
#: What such hardware, and the AXI top, cannot be without.
NEEDED = {"gradient": "one_pass", "ascent": "newton", "buffers": 2, "thinning": 1, "thin_target": 0}


def kind_of(seed):
    """What the configuration of a seed is made for: every third has regions, every fifth is played through the AXI top.

    Without a compiler all are cores of one ROI.
    """
    compiled = not cannot_compile()
    return {"regions": compiled and seed % 3 == 0, "shell": compiled and seed % 5 == 1}


def random_config(rng, *, regions=False, shell=False):
    """``(config, refused)``: a random :class:`Config`, and how many before it were refused.

    With ``regions`` it has a table of them; with ``shell`` the AXI top can be made of it.
    """
    refused = 0
    while True:
        try:
            config = Config(**_fields(rng, regions, shell))
            if shell:
                check(config)
            return config, refused
        except ConfigError:
            refused += 1


def assignments(config):
    """The options by which a command line gets ``config``."""
    values = {name: getattr(config, name) for name in _FIELDS}
    changed = (f"--set '{name}={one}'" for name, one in values.items() if one != _FIELDS[name].default)
    return " ".join(("--preset paper", *changed))


def _fields(rng, regions, shell):
    """Values of some fields, each by itself within its limits."""
    largest = LARGEST | (LARGEST_OF_REGIONS if regions else {})
    defaults = {name: field.default for name, field in _FIELDS.items()}
    values = {
        field.name: field.type(rng.choice(choices))
        if (choices := field.metadata["choices"])
        else _integer(field, rng, largest)
        for field in _FIELDS.values()
        if field.name not in (*OF_REGIONS, "evt3", "binning")
        and (field.type is int or field.metadata["choices"])
        and rng.random() < 0.7
    }
    for axis in ("width", "height"):  # a sensor smaller than the default ROI would nearly always be refused
        values.setdefault(f"roi_{axis}", _integer(_FIELDS[f"roi_{axis}"], rng, largest))
    if values.get("background"):  # or a reset would sweep millions of cells
        values["background_cell"] = max(values.get("background_cell", 1), 4)
    values["motion"] = str(rng.choice([*MOTIONS], p=[0.7, 0.15, 0.15]))
    if regions:
        values |= _of_regions(rng, largest) | {"motion": values["motion"].replace("rotation", "translation")}
    values |= needs(values["motion"])
    if not regions and not shell and values["motion"] == "translation" and rng.random() < 0.2:
        values |= _of_windows(rng, {**defaults, **values})
    else:
        values["windows"] = "batches"
    if values["motion"] == "translation":
        rounds = values.get("ascent", "constant") != "constant"
        values |= {"ascent": "newton", "gradient": "one_pass", "border": "whole"} if rounds else {}
    known = defaults | values
    sensor = known["sensor_width"], known["sensor_height"]
    # Or the table that undistorts would have millions of nodes, which take minutes to emit.
    pixels = int(np.prod(sensor))
    values["undistortion_cell"] = max(known["undistortion_cell"], (pixels.bit_length() - 15) // 2)
    marked = ";".join("{},{}".format(*rng.integers(sensor)) for _ in range(rng.integers(4)))
    values["hot_mask"] = "" if shell else marked
    values["camera"] = ",".join(map(repr, random_lens(SimpleNamespace(**known | values), rng)))
    v = Q(known["v_int"], known["v_frac"])
    values |= {name: v.real(int(rng.integers(v.min, v.max + 1))) for name in ("v_start_x", "v_start_y")}
    limit = _FIELDS["confidence_limit"].metadata
    values["confidence_limit"] = float(np.exp(rng.uniform(np.log(limit["low"]), np.log(limit["high"]))))
    for name in ("eta", "roi_gain"):
        fmt = Q(known[f"{name}_int"], known[f"{name}_frac"], signed=False)
        values[name] = fmt.real(int(rng.integers(fmt.max + 1) >> rng.integers(fmt.width)))
    for name in ("cold", "warm", "follow", "after"):
        if values["motion"] == "translation":
            given = _rounds(rng, known["max_level"], v, longest=1 if name == "after" else 7)
        else:
            given = _schedule(rng, known["max_level"], v, known["confidence"])
        values[name] = AUTO if rng.random() < 0.3 else given
        if name in ("follow", "after") and rng.random() < 0.3:
            values[name] = ""
    values["evt3"] = int(shell and rng.integers(2))
    values["binning"] = int(rng.integers(1, 4)) if rng.random() < 0.2 else 0
    idle = unread(defaults | values)
    return {name: value for name, value in values.items() if name not in idle}


def _of_regions(rng, largest):
    """A table of regions, and a sensor and a batch small enough; the smallest batches often, for widths follow them."""
    drawn = ("regions", "units", "slices", "bin_bits", "sensor_width", "sensor_height")
    values = {name: _integer(_FIELDS[name], rng, largest) for name in drawn}
    values["regions"] = max(1, values["regions"])
    values["slices"] = values["slices"] if rng.random() < 0.4 else 1
    values["max_batch_events"] = int(np.exp(rng.uniform(0, np.log(largest["max_batch_events"]))))
    values["store_style"] = str(rng.choice(_FIELDS["store_style"].metadata["choices"]))
    return values | NEEDED


def _integer(field, rng, largest):
    """Often a limit; wide ranges are drawn by their logarithm."""
    low, high = field.metadata["low"], largest.get(field.name, field.metadata["high"])
    kind = rng.random()
    if kind < 0.16:
        return low if kind < 0.08 else high
    if high - low < 64:
        return int(rng.integers(low, high + 1))
    return int(np.exp(rng.uniform(np.log(max(1, low)), np.log(high + 1))))


def _schedule(rng, max_level, v, judged):
    """Where a batch is judged, the last step has all events: nothing else is allowed."""
    words = []
    for left in reversed(range(rng.integers(1, 8))):
        count = int(rng.choice([1, 1, 1, 2, 4]))
        stride = rng.choice(STRIDES) if left or not judged else 1
        step = f"{rng.integers(max_level + 1)}:{rng.integers(-v.f, v.i)}/{stride}"
        words.append(step + (f"*{count}" if count > 1 else ""))
    return " ".join(words)


def _of_windows(rng, known):
    """Windows that slide, and what they cannot be without."""
    count = int(rng.integers(1, min(known["buffer_events"], 300) + 1))
    oldest = int(rng.integers(0, 1 << min(known["span_bits"] - 1, 13)))
    lengths = {
        "window_events": count, "hop_events": int(rng.integers(1, count + 1)), "window_us": oldest,
        "hop_us": int(rng.integers(0, oldest + 1)),
    }  # fmt: skip
    return {"windows": "sliding", "ascent": "newton"} | lengths


def _rounds(rng, max_level, v, longest=7):
    """A schedule of rounds; limits are 2^k or 3·2^k."""
    words = []
    for _ in range(rng.integers(1, longest + 1)):
        limit = Fraction(2) ** int(rng.integers(-v.f, v.i)) * Fraction(3, 2) ** int(rng.integers(2))
        words.append(f"{rng.integers(max_level + 1)}:{Fraction(int(rng.choice(DISTANCES)), 4)}:{limit}")
    return " ".join(words)
