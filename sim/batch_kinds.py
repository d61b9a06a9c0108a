"""The batches that are played into the core by tb_cmfpga_core.v: one kind for each thing that may go wrong."""

import dataclasses
from dataclasses import dataclass

import numpy as np

from cmfpga.config.schedule import FEWEST, Round, ScheduleEntry
from cmfpga.protocol.settings import BatchSettings, clamp_roi


@dataclass(kw_only=True)
class Batch:
    """One batch as it is played into the core."""

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    settings: BatchSettings
    gaps: np.ndarray  # idle cycles before each event
    stall: int = 0  # clock cycles for which the result is left waiting
    alone: bool = False  # offered when all results before are taken, not as soon as the core takes it
    by_count: bool = False  # ends by batch_events, or max_batch_events; no event is marked as the last
    reset_at: float = 0.0  # part of the cycles between the last event and the result after which a reset comes; 0: none


def schedule_table(config):
    """Iterations of the core's table of schedules: all levels, distances, strides; steps by which v saturates, too."""
    if not config.ascent_rule.has_table:
        return ()
    low, high = -config.formats.v.f, config.formats.v.i - 1
    entries = (  # level, log2 of the step, stride, distance
        (2, 1, 4, 12), (1, 0, 2, 8), (0, -2, 1, 6), (1, high, 4, 4), (2, -1, 4, 6), (0, -4, 2, 3), (0, low, 1, 3),
        (1, -2, 2, 4),
    )  # fmt: skip
    entries = [
        (min(level, config.max_level), max(low, min(high, step)), stride, distance)
        for level, step, stride, distance in entries[: config.schedule_entries]
    ]
    if config.ascent_rule.evaluations > 1:
        return tuple(Round(level, distance, 2.0**step) for level, step, _, distance in entries)
    return tuple(ScheduleEntry(*entry[:3]) for entry in entries)


class Maker:
    """Makes the batches one after the other; knows where the model's ROI is by then."""

    def __init__(self, config, rng):
        self.config, self.rng = config, rng
        # Events that a batch may have in the ROI, so that only the batch that shall overfill the buffer does; a
        # simulator of Verilog takes a millisecond for each in each iteration, so most batches have fewer.
        self.most = max(1, 3 * config.buffer_events // 4)
        self.n = min(64, self.most)
        self.table = schedule_table(config)

    def inside(self, n, roi):
        """``n`` random pixels of the ROI."""
        size = self.config.roi_width, self.config.roi_height
        return tuple(corner + self.rng.integers(side, size=n) for corner, side in zip(roi, size, strict=True))

    def anywhere(self, n):
        """``n`` random pixels of the image."""
        width, height = self.config.geometry.size
        return self.rng.integers(width, size=n), self.rng.integers(height, size=n)

    def mixed(self, n, roi):
        """``n`` pixels, half of them in the ROI for sure."""
        order = self.rng.permutation(n)
        pixels = zip(self.inside(n - n // 2, roi), self.anywhere(n // 2), strict=True)
        return [np.concatenate(axis)[order] for axis in pixels]

    def times(self, n):
        """Rising times, the first anywhere."""
        t = np.cumsum(self.rng.integers(0, 40, size=n)) + int(self.rng.integers(1 << (self.config.time_bits - 1)))
        t[-1] += 1  # no batch without a duration by accident
        return t

    def settings(self):
        """Settings unlike the batch before."""
        config, rng, v = self.config, self.rng, self.config.formats.v
        roi = (int(rng.integers(config.geometry.roi_x_max + 1)), int(rng.integers(config.geometry.roi_y_max + 1)))
        return BatchSettings(
            roi=roi if rng.random() < 0.5 else None,
            iterations=min(config.max_iterations, int(rng.integers(1, 5))),
            eta=min(config.formats.eta.max, int(rng.choice([1, 500, 1024, 5000, 1 << 20]))),
            roi_gain=int(rng.integers(config.formats.roi_gain.max + 1)),
            start_last=bool(rng.random() < 0.5),
            v_start=(
                *(rng.integers(v.min, v.max + 1, 2) >> rng.integers(0, 9)).tolist(),
                *(int(rng.integers(p.fmt.min, p.fmt.max + 1)) for p in config.motion_model.parameters[2:]),
            ),
            min_roi_events=1,
            camera=config.lens,
        )

    def scheduled(self, settings):
        """With as many iterations as ``settings`` says, from anywhere in the table of schedules; one fewer if warm."""
        count = settings.iterations
        if not self.table:
            return settings
        start = self.rng.integers(max(1, len(self.table) - count + 1), size=2)
        plans = (self.table[k : k + max(n, min(count, 1))] for k, n in zip(start, (count, count - 1), strict=True))
        return dataclasses.replace(settings, **dict(zip(("cold", "warm"), plans, strict=True)))

    def make(self, name, roi):
        """A batch of kind ``name``; ``roi`` is where the core's ROI stands."""
        settings = self.settings()
        changes = KINDS[name](self, clamp_roi(self.config, settings.roi or roi)[0])
        x, y = (axis << self.config.binning for axis in changes.pop("pixels"))
        fields = {
            "t": self.times(len(x)),
            "gaps": np.zeros(len(x), np.int64),
            "stall": int(self.rng.integers(4)),
            "settings": self.scheduled(dataclasses.replace(settings, **changes.pop("settings", {}))),
            "alone": bool(self.rng.random() < 0.4),
        }
        return Batch(x=x, y=y, **{**fields, **changes})


def hesitant(make, roi):
    """Gaps between the events, and a result that waits for long."""
    gaps = make.rng.integers(0, 6, make.n) * (make.rng.random(make.n) < 0.4)
    gaps[0] = 20
    return {"pixels": make.inside(make.n, roi), "gaps": gaps, "stall": 40}


def repeated(make, roi):
    """The same few pixels again after 1, 2, … 6 events, for the forwarding, and a step as large as can be."""
    x, y = make.inside(6, roi)
    order = np.concatenate([np.tile(np.arange(distance), 7) for distance in range(1, 7)])[: make.most]
    settings = {"eta": make.config.formats.eta.max, "start_last": False}
    settings["v_start"] = (0,) * len(make.config.motion_model.names)
    return {"pixels": (x[order], y[order]), "settings": settings}


def degenerate(make, roi):
    """Fewer ROI events than asked for: neither v nor the ROI changes."""
    least = min(8, make.config.buffer_events)
    return {"pixels": make.inside(max(1, least - 1), roi), "settings": {"min_roi_events": least}}


def borders(make, roi):
    """Events on both sides of the ROI's border, and a v that throws many of them out."""
    config, rng, n = make.config, make.rng, make.n
    x, y = make.inside(n, roi)
    edge = np.arange(n) % 8
    left, top, right, bottom = roi[0], roi[1], roi[0] + config.roi_width, roi[1] + config.roi_height
    x = np.select([edge == 0, edge == 1, edge == 2, edge == 3], [left - 1, left, right - 1, right], x)
    y = np.select([edge == 4, edge == 5, edge == 6, edge == 7], [top - 1, top, bottom - 1, bottom], y)
    order = rng.permutation(n)
    pixels = np.clip(x, 0, config.geometry.width - 1)[order], np.clip(y, 0, config.geometry.height - 1)[order]
    v = (config.formats.v.max, config.formats.v.min, *(p.fmt.min for p in config.motion_model.parameters[2:]))
    return {"pixels": pixels, "settings": {"start_last": False, "v_start": v}}


def reset_in_iterations(make, roi):
    """A reset while the banks hold votes."""
    pixels, settings = make.inside(make.n, roi), {"iterations": min(3, make.config.max_iterations)}
    return {"pixels": pixels, "settings": settings, "reset_at": make.rng.uniform(0.3, 0.9), "alone": True}


def odd_times(make, roi):
    """Time stamps that wrap, step back, and lie beyond the span."""
    config, rng, n = make.config, make.rng, make.n
    t = np.cumsum(rng.integers(0, 40, size=n)) + (1 << config.time_bits) - 10 * n
    t[rng.integers(n, size=4)] -= 300
    t[rng.integers(n // 2, n, size=4)] += 1 << config.span_bits
    return {"pixels": make.mixed(n, roi), "t": t}


def counted(make, roi):
    """A batch that ends by its length: the largest one, where that does not take long."""
    most = make.config.max_batch_events
    return {"pixels": make.inside(most if most < 3000 else make.n, roi), "by_count": True}


def outside_the_sensor(make, roi):
    """An ROI that is asked for where it does not fit, and followed with the largest gain."""
    config = make.config
    corner = ((1 << config.geometry.x_bits) - 1, (1 << config.geometry.y_bits) - 1)
    gain = config.formats.roi_gain.max
    # The corner is limited to the sensor, so the events have to lie there.
    return {"pixels": make.inside(make.n, clamp_roi(config, corner)[0]), "settings": {"roi": corner, "roi_gain": gain}}


#: ``{name: function(make, roi)}``, a dictionary of a :class:`Batch`'s fields, with ``pixels`` for x and y.
KINDS = {
    "steady": lambda make, roi: {"pixels": make.mixed(make.n, roi)},
    "thinned": lambda make, roi: {"pixels": make.mixed(make.n, roi), "settings": {"thinning": 3}},
    **{make.__name__: make for make in (hesitant, repeated, degenerate, borders, reset_in_iterations)},
    # No ROI is loaded and v is the last one: both must be zero.
    "after_reset": lambda make, _: {
        "pixels": make.inside(make.n, (0, 0)), "settings": {"roi": None, "start_last": True}, "alone": True,
    },
    "overfull": lambda make, roi: {
        "pixels": make.inside(make.config.buffer_events + 10, roi), "settings": {"iterations": 1},
    },
    "strided": lambda make, roi: {"pixels": make.inside(min(4 * FEWEST, make.config.buffer_events), roi)},
    "odd_times": odd_times,
    "counted": counted,
    "nothing_to_iterate": lambda make, roi: {"pixels": make.inside(20, roi), "settings": {"iterations": 0}},
    # The range that everything is divided by is zero.
    "one_instant": lambda make, roi: {"pixels": make.inside(20, roi), "t": np.full(20, 5)},
    "outside_the_sensor": outside_the_sensor,
}  # fmt: skip
