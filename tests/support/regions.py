"""Hardware with a table of regions: small configurations, random tables and batches, and the check against the model."""

import dataclasses

import numpy as np

from cmfpga.config import preset
from cmfpga.protocol.regions import MOST_STRIDE, STARTS, Region
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.reference.regions import RegionSequence
from support.core_batches import PLANS, moving_points, settings

_SMALL = preset("fast").replace(
    sensor_width=40, sensor_height=30, roi_width=16, roi_height=12, buffer_events=37, max_batch_events=150,
    max_iterations=7, tag_bits=3, cold="2:1 1:0 0:-1 0:-3", warm="1:0 1:-1 0:-2 0:-4", regions=9, units=2, bin_bits=2,
)  # fmt: skip

CONFIGS = {
    "two units": _SMALL,
    "one unit": _SMALL.replace(units=1, confidence=0, when_full="drop"),
    # More units than regions; bins as large as the sensor; a camera, a hot pixel's mask and the background's filter.
    "five units, front": _SMALL.replace(
        units=5, regions=4, bin_bits=6, undistortion="on", hot_pixels=1, background=1, camera="36,35,18.3,16.8,-0.3,0.1,0,0,0",
        hot_mask="20,15;3,4", background_us=1 << 22,
    ),
}  # fmt: skip


def random_regions(config, rng, count=None):
    """A table: regions anywhere, of any size, some of them over the sensor's edge, some off every event."""
    regions, plans = [], [None, (), *(plan for plan in PLANS if not config.confidence or plan[-1].stride == 1)]
    for number in range(int(rng.integers(1, config.regions + 1)) if count is None else count):
        width, height = int(rng.integers(1, config.roi_width + 1)), int(rng.integers(1, config.roi_height + 1))
        margin = int(rng.integers(config.roi_width - width + 1)), int(rng.integers(config.roi_height - height + 1))
        starts = STARTS if number else STARTS[:2]
        regions.append(
            Region(
                x=int(rng.integers(config.sensor_width)),
                y=int(rng.integers(config.sensor_height)),
                width=width,
                height=height,
                margin=margin if rng.random() < 0.5 else None,
                start=str(rng.choice(starts)),
                parent=int(rng.integers(max(1, number))),
                cold=plans[int(rng.integers(3))] if rng.random() < 0.3 else None,
                warm=PLANS[3] if rng.random() < 0.3 and not config.confidence else None,
                stride=1 << int(rng.integers(MOST_STRIDE + 1)) if rng.random() < 0.3 else 1,
                moves=bool(rng.random() < 0.5),
            )
        )
    return regions


def random_window(config, rng, kind="any"):
    """Events ``(t, x, y)``: of a few points that move and of noise, some with wrong times; or all in one bin."""
    count = int(rng.choice([1, 2, 30, 100, config.max_batch_events]))
    events = np.array(moving_points(config, rng, count, bad_times=0.1), np.int64).T
    if kind == "one bin":
        events[1:] = events[1:] % 4
    return tuple(events)


def random_settings(config, rng):
    chosen = settings(config, min_roi_events=int(rng.integers(1, 4)), roi_gain=int(rng.integers(1 << 6)))
    if config.confidence:
        chosen = dataclasses.replace(
            chosen, judge=int(rng.random() < 0.8), confidence_limit=int(rng.choice([1, 20, 90, 1000])),
            cold_after_doubtful=int(rng.integers(2)),
        )  # fmt: skip
    return chosen


def model_of(config):
    return RegionSequence(IntegerCore(config))


def without_clock(result):
    """A result as the model gives it: without cycles."""
    return dataclasses.replace(
        result, regions=tuple(dataclasses.replace(region, cycles=None) for region in result.regions)
    )
