"""Batches that are hard on the hardware: patterns of repeated addresses, borders, strange times, sizes; and tables."""

import dataclasses

import numpy as np

from cmfpga.config.schedule import DISTANCES, FEWEST, STRIDES, Round, ScheduleEntry
from cmfpga.errors import ConfigError
from cmfpga.events import Events
from cmfpga.imaging.camera import Camera
from cmfpga.protocol.regions import MOST_STRIDE, STARTS, Region
from cmfpga.protocol.settings import BatchSettings, clamp_roi


def _inside(config, rng, roi, n, order=slice(None)):
    """``n`` pixels of the ROI at random, in an ``order`` in which they may come again."""
    x, y = roi[0] + rng.integers(config.roi_width, size=n), roi[1] + rng.integers(config.roi_height, size=n)
    return x[order], y[order]


def _anywhere(config, rng, n):
    return rng.integers(config.geometry.width, size=n), rng.integers(config.geometry.height, size=n)


def _clipped(config, x, y):
    return np.clip(x, 0, config.geometry.width - 1), np.clip(y, 0, config.geometry.height - 1)


def _neighbours_2_by_2(config, rng, roi):
    """Around one corner of four pixels, where each event votes for all of them."""
    x, y = _inside(config, rng, roi, 1)
    step_x, step_y = rng.integers(2, size=(2, 150))
    right, bottom = roi[0] + config.roi_width - 1, roi[1] + config.roi_height - 1
    return np.minimum(x + step_x, right), np.minimum(y + step_y, bottom)


def _corners_and_edges(config, rng, roi):
    """On both sides of the ROI's border, corners included."""
    n = 160
    right, bottom = roi[0] + config.roi_width, roi[1] + config.roi_height
    x = rng.choice([roi[0] - 1, roi[0], roi[0] + 1, right - 2, right - 1, right], n)
    y = rng.integers(roi[1] - 1, bottom + 1, size=n)
    swap = rng.random(n) < 0.5
    y[swap] = rng.choice([roi[1] - 1, roi[1], bottom - 1, bottom], swap.sum())
    return _clipped(config, x, y)


def _everything_outside(config, rng, roi):
    x, y = _anywhere(config, rng, 80)
    inside = (x >= roi[0]) & (x < roi[0] + config.roi_width) & (y >= roi[1]) & (y < roi[1] + config.roi_height)
    return np.append(x[~inside], 0 if roi[0] else config.geometry.width - 1), np.append(y[~inside], 0)


def _few_events(config, rng, roi):
    """0, 1, 2, 3 or 5 events in the ROI, among some outside."""
    inside = _inside(config, rng, roi, int(rng.choice([0, 1, 2, 3, 5])))
    keep = slice(-max(2, len(inside[0])), None)
    both = [np.append(a, b[keep]) for a, b in zip(inside, _everything_outside(config, rng, roi), strict=True)]
    order = rng.permutation(len(both[0]))
    return tuple(axis[order] for axis in both)


def _moving_edge(config, rng, roi):
    """An edge that moves through the ROI, blurred: what the core is made for."""
    n = 240
    along = np.linspace(0, 1, n)
    x = roi[0] + config.roi_width / 3 + along * rng.uniform(-5, 5) + rng.normal(0, 0.6, n)
    y = roi[1] + rng.uniform(0, config.roi_height, n)
    return tuple(axis.astype(np.int64) for axis in _clipped(config, x, y))


def _overfull_buffer_on_one_pixel(config, rng, roi):
    x, y = _inside(config, rng, roi, 1)
    n = config.buffer_events + int(rng.integers(1, 50))
    return np.repeat(x, n), np.repeat(y, n)


#: ``{name: function(config, rng, roi)}`` of sensor coordinates (x, y) of a batch's events.
PATTERNS = {
    "random_everywhere": lambda config, rng, roi: _anywhere(config, rng, int(rng.integers(1, 400))),
    "random_inside": lambda config, rng, roi: _inside(config, rng, roi, int(rng.integers(1, 300))),
    # Every operation collides with the ones before.
    "one_pixel": lambda *batch: _inside(*batch, 1, [0] * 120),
    "two_cells_alternating": lambda *batch: _inside(*batch, 2, [0, 1] * 60),
    # A pixel that comes back after so many events, in turn: one for each stage that forwards.
    "repeats_at_distances_1_to_5": lambda *batch: _inside(
        *batch, 6, np.concatenate([np.tile(np.arange(distance), 12) for distance in range(1, 7)])
    ),
    "neighbours_2_by_2": _neighbours_2_by_2,
    "corners_and_edges": _corners_and_edges,
    "everything_outside": _everything_outside,
    "few_events": _few_events,
    "moving_edge": _moving_edge,
    "full_buffer": lambda config, rng, roi: _inside(config, rng, roi, config.buffer_events),
    # One more or less: where a stride begins to count.
    "as_many_as_a_stride_needs": lambda config, rng, roi: _inside(
        config, rng, roi, FEWEST * int(rng.choice(STRIDES[1:])) + int(rng.integers(-1, 2))
    ),
    "many_times_the_buffer": lambda config, rng, roi: _inside(
        config, rng, roi, int(rng.integers(1, min(10 * config.buffer_events, 6000) + 1))
    ),
    "overfull_buffer_on_one_pixel": _overfull_buffer_on_one_pixel,
}


def times(config, rng, n):
    """Time stamps of ``n`` events: steady, in bursts, wrapping, stepping back, all equal, or too long."""
    kind = rng.choice(
        ["steady", "burst", "wrap", "back", "equal", "long", "tiny"], p=[0.4, 0.2, 0.1, 0.1, 0.05, 0.1, 0.05]
    )
    step = rng.integers(0, 40, size=n)
    if kind == "burst":
        step = step * 20 * (rng.random(n) < 0.1)
    if kind == "tiny":
        step = rng.random(n) < 2 / n
    if kind == "equal":
        step[:] = 0
    if kind == "long":
        step = step * ((1 << config.span_bits) // (10 * n))
    t = np.cumsum(step) + int(rng.integers(1 << 30))
    if kind == "wrap":
        t += (1 << config.time_bits) - int(rng.integers(1, 200)) - t[0]
    if kind == "back":
        at = rng.integers(n, size=3)
        t[at] -= rng.integers(1, 500, size=3)
    return t


def on_the_sensor(config, rng, x, y):
    """Pixels of the sensor, any of those that a binned one is made of; a last one may be made of fewer."""
    if not config.binning:
        return x, y
    axes = zip((x, y), (config.sensor_width, config.sensor_height), strict=True)
    return tuple(
        np.minimum((at << config.binning) + rng.integers(config.pixel, size=len(at)), size - 1) for at, size in axes
    )


def random_events(config, rng, roi, name=None):
    """``(name, events)`` of a pattern, by default a random one; no longer than a batch may be."""
    name = name or str(rng.choice(list(PATTERNS)))
    x, y = on_the_sensor(config, rng, *PATTERNS[name](config, rng, roi))
    columns = (times(config, rng, len(x)), x, y, np.zeros(len(x)))
    return name, Events(*(column[: config.slice_events] for column in columns))


def random_settings(config, rng, previous_roi):
    """Settings that change from batch to batch, and the ROI that the patterns are made for."""
    roi = None
    if rng.random() < 0.6:
        roi = (int(rng.integers(config.geometry.roi_x_max + 1)), int(rng.integers(config.geometry.roi_y_max + 1)))
    settings = BatchSettings(
        roi=roi,
        iterations=min(config.max_iterations, int(rng.choice([0, 1, 2, 3, 7, 12], p=[0.03, 0.17, 0.2, 0.2, 0.2, 0.2]))),
        eta=min(config.formats.eta.max, int(rng.choice([0, 1, 500, 1024, 5000, config.formats.eta.max]))),
        roi_gain=int(rng.integers(config.formats.roi_gain.max + 1)),
        start_last=bool(rng.random() < 0.5),
        v_start=tuple(
            int(rng.integers(parameter.fmt.min, parameter.fmt.max + 1) >> rng.integers(0, 12))
            for parameter in config.motion_model.parameters
        ),
        min_roi_events=min(config.buffer_events, int(rng.choice([1, 1, 1, 4]))),
        thinning=int(rng.choice([1, 1, 1, 2, 3, 255])),
        thin_target=int(rng.choice([0, 0, 1, 7, 100, config.buffer_events]).clip(0, config.buffer_events)),
        judge=int(rng.random() < 0.8),
        cold_after_doubtful=int(rng.random() < 0.8),
        confidence_limit=int(rng.choice([1, 20, 90, 90, 1023])),
        hot_mask=random_mask(config, rng, roi or previous_roi),
        camera=random_lens(config, rng, image=config.geometry),
        background_us=min(config.widths.background_us_max, int(rng.choice([0, 1, 30, 300, 5000, 1 << 31]))),
        **(random_schedules(config, rng) if config.ascent_rule.has_table else {}),
    )
    return settings, clamp_roi(config, roi or previous_roi)[0]


def random_mask(config, rng, roi):
    """No pixel, some of the ROI, or of the whole sensor."""
    if not config.hot_pixels or rng.random() < 0.3:
        return ()
    count = int(rng.choice([1, 5, 100]))
    if rng.random() < 0.3:
        x, y = rng.integers(config.sensor_width, size=count), rng.integers(config.sensor_height, size=count)
    else:
        x, y = on_the_sensor(config, rng, *_inside(config, rng, clamp_roi(config, roi)[0], count))
    return tuple(sorted(set(zip(x.tolist(), y.tolist(), strict=True))))


def random_lens(config, rng, image=None):
    """None, or a camera with any distortion that can be undone, its centre near the sensor's, or that of its ``image``.

    A rotation always has one, with square pixels and a focal length that its format holds.
    """
    turning = config.motion == "rotation"
    if config.undistortion == "off" or (rng.random() < 0.3 and not turning):
        return ()
    size = np.array([image.width, image.height] if image else [config.sensor_width, config.sensor_height])
    focus = size.max() * rng.uniform(0.9, 2.0, 2)
    if turning:
        focus = max(33, focus[0]) * rng.uniform(1, 1.04, 2)
    centre = size * rng.uniform(0.4, 0.6, 2)
    distortion = rng.uniform(-1, 1, 5) * (0.35, 0.1, 0.01, 0.01, 0.02)
    lens = tuple(np.concatenate([focus, centre, distortion]).tolist())
    try:
        Camera(*lens).rays(*np.meshgrid(*((0, side - 1) for side in size)))
    except ConfigError:
        return random_lens(config, rng, image)
    return lens


def random_schedules(config, rng):
    """Two schedules of random length, also empty; where there are regions, half the table is left for theirs."""
    most = config.schedule_entries // (4 if config.regions else 2)
    return {name: random_plan(config, rng, most) for name in ("cold", "warm")}


def random_plan(config, rng, most):
    """Up to ``most`` iterations with any level, step and stride, or distance and limit."""

    def entry():
        level, power = int(rng.integers(config.max_level + 1)), rng.integers(-config.formats.v.f, config.formats.v.i)
        if config.ascent_rule.evaluations == 1:
            return ScheduleEntry(level, int(power), int(rng.choice(STRIDES)))
        return Round(level, int(rng.choice(DISTANCES)), 2.0 ** int(power))

    return tuple(entry() for _ in range(rng.integers(0, most + 1)))


def random_regions(config, rng, count=None):
    """A table: regions anywhere, of any size, some of them over the sensor's edge, some off every event."""
    plans = [random_plan(config, rng, config.schedule_entries // 6) for _ in range(3)]
    if config.confidence and config.ascent_rule.evaluations == 1:  # the last iteration needs all events
        plans = [plan[:-1] + tuple(last._replace(stride=1) for last in plan[-1:]) for plan in plans]
    plans += [None] * 7
    regions = []
    for number in range(int(rng.integers(1, config.regions + 1)) if count is None else count):
        width, height = int(rng.integers(1, config.roi_width + 1)), int(rng.integers(1, config.roi_height + 1))
        margin = int(rng.integers(config.roi_width - width + 1)), int(rng.integers(config.roi_height - height + 1))
        regions.append(Region(
            x=int(rng.integers(config.geometry.width)), y=int(rng.integers(config.geometry.height)),
            width=width, height=height, margin=margin if rng.random() < 0.5 else None,
            start=str(rng.choice(STARTS if number else STARTS[:2])), parent=int(rng.integers(max(1, number))),
            cold=plans[rng.integers(len(plans))], warm=plans[rng.integers(len(plans))],
            stride=1 << int(rng.integers(MOST_STRIDE + 1)) if rng.random() < 0.3 else 1,
            moves=bool(rng.random() < 0.5),
        ))  # fmt: skip
    return regions


def some_changed(config, rng, regions):
    """The table with another last row, or one row less; a parent stays in front of its children."""
    last = dataclasses.replace(random_regions(config, rng, 1)[0], cold=None, warm=None)
    return ([*regions[:-1], last] if rng.random() < 0.5 else regions[:-1]) or regions
