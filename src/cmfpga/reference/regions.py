"""Many regions of one batch, the same in raw integers and in real numbers: store, crop, start, ascend, follow."""

import collections
from dataclasses import dataclass

import torch

from ..imaging.camera import undistort
from ..protocol.flags import Flag
from ..protocol.results import BatchResult, RegionOutcome, fields_of, not_judged, thins
from ..protocol.trace import Trace
from .ingest import TakenIn, thinned_to_room
from .integer.filters import NoiseFilter
from .integer.roi_filter import roi_filter
from .sequence import move_within


@dataclass
class _State:
    """What is kept of a region between batches; numbers are those of the core."""

    position: tuple
    v: tuple
    followed: bool = False
    doubtful: bool = False


@dataclass(frozen=True)
class Stored:
    """A batch in the store: events bin by bin, those of a bin in the order of time."""

    t: torch.Tensor  # µs since t_1, [n]
    x: torch.Tensor  # raw with event_frac fraction bits, [n]
    y: torch.Tensor
    outside: int  # events that lie off the sensor, once undistorted
    counts: dict  # of the batch, by the names of the fields of BatchResult
    flags: Flag


def store(config, t, x, y, settings, dropped=(False, False)):
    """Undistort a batch, and put what lies on the sensor in the order of bins: :class:`Stored`."""
    x, y = undistort(config, settings.camera, x, y)
    size = config.geometry.size
    seen = roi_filter(config, t, x, y, roi=(0, 0), size=size, hot=dropped[0], noise=dropped[1])
    bits, frac = config.bin_bits, config.formats.event_frac
    half = (1 << frac) >> 1
    column, row = (((axis + half) >> frac) >> bits for axis in (seen.x, seen.y))
    order = torch.argsort(row * config.store.columns + column, stable=True)
    counts = {f.name: getattr(seen, f.name, None) for f in fields_of("batch")}
    counts["t_first"] = int(t[0]) & ((1 << config.time_bits) - 1)
    flags = Flag(0)
    for flag in (Flag.TIME_BACK, Flag.TIME_SPAN):
        flags |= flag if counts[flag.name.lower()] else Flag(0)
    return Stored(*(axis[order] for axis in (seen.t, seen.x, seen.y)), seen.outside, counts, flags)


class RegionSequence:
    """What a table of regions does to each batch, as :mod:`cmfpga.rtl.regions` does.

    Parameters
    ----------
    core : cmfpga.reference.sequence.Sequence
        Ascends; what it keeps between batches is not used.

    Attributes
    ----------
    regions : list of Region
    """

    def __init__(self, core):
        self.core, self.config = core, core.config
        self.regions, self._states = [], []
        self._slices = collections.deque(maxlen=self.config.slices)
        self.noise_filter = NoiseFilter(self.config)
        self._pixel = core.follower.pixel

    def write(self, regions, anew=()):
        """Replace the table. A row that changes, or is one of ``anew``, forgets what it measured and where it moved."""
        regions = list(regions)
        for number, region in enumerate(regions):
            region.check(self.config, number)
        states = []
        for number, region in enumerate(regions):
            kept = number not in anew and self.regions[number : number + 1] == [region]
            states.append(self._states[number] if kept else self._fresh(region))
        self.regions, self._states = regions, states

    def _fresh(self, region):
        none = self.core.number(self.config.formats.v, 0)
        return _State((region.x * self._pixel, region.y * self._pixel), (none,) * len(self.config.motion_model.names))

    def run(self, t, x, y, settings, *, cut=False):
        """Process one batch, or slice of a window: a :class:`BatchResult` with an outcome for each region.

        Parameters
        ----------
        t, x, y : integer arrays
            All events of the batch, or slice, at least one.
        settings : BatchSettings
            Run-time inputs; ``roi``, ``thinning``, ``thin_target`` and ``start_last`` mean nothing here.
        cut : bool
            Whether the batch ended because it reached ``max_batch_events``.
        """
        self._slices.append((t, x, y))
        t, x, y = (torch.cat([torch.as_tensor(one) for one in axis]) for axis in zip(*self._slices, strict=True))
        stored = store(self.config, t, x, y, settings, self.noise_filter.judge(t, x, y, settings))
        flags = stored.flags | (Flag.CUT if cut else Flag(0))
        outcomes = tuple(self._measure(number, stored, settings, flags) for number in range(len(self.regions)))
        return BatchResult(regions=outcomes, **stored.counts)

    def crop(self, number, stored):
        """The events of a region, :class:`TakenIn`, and its left column and top row."""
        config, region = self.config, self.regions[number]
        place = self._corner(self._states[number])
        begin, frac = region.corner(config), config.formats.event_frac
        x, y = (axis - ((at - by) << frac) for axis, at, by in zip((stored.x, stored.y), place, begin, strict=True))
        half = (1 << frac) >> 1
        inside = torch.ones(len(x), dtype=torch.bool)
        for axis, at, side in ((x, begin[0], region.width), (y, begin[1], region.height)):
            nearest = (axis + half) >> frac
            inside &= (nearest >= at) & (nearest < at + side)
        events = tuple(axis[inside] for axis in (stored.t, x, y))
        found = len(events[0])
        factor = thinned_to_room(config, found, region.stride)
        kept, used = -(-found // factor), {"thinning_used": factor} if thins(config) else {}
        n = min(kept, config.buffer_events)
        counts = {
            "roi_events": n,
            "outside": len(x) - found + stored.outside,
            "overflow": kept - n,
            "thinned": found - kept,
            **used,
        }
        counts["span"] = stored.counts["span"]
        return TakenIn(*(axis[::factor][:n] for axis in events), counts, Flag(0), None), place

    def _measure(self, number, stored, settings, flags):
        config, core = self.config, self.core
        region, state = self.regions[number], self._states[number]
        batch, place = self.crop(number, stored)
        source = {"given": None, "last": state, "parent": self._states[region.parent]}[region.start]
        warm = source is not None and source.followed
        restarted = bool(warm and source.doubtful and settings.cold_after_doubtful)
        warm, judged = warm and not restarted, not_judged(config)
        plan = region.warm if warm else region.cold
        if plan is None:
            plan = settings.warm if warm else settings.cold
        state.followed = batch.enough(settings) and bool(plan)
        for flag in (Flag.OVERFLOW, Flag.THINNED):
            flags |= flag if batch.counts[flag.name.lower()] else Flag(0)
        clamped = False
        if state.followed:
            cold = (core.number(config.formats.v, axis) for axis in settings.v_start)
            core.v = tuple(source.v) if warm else tuple(cold)
            trace, found, fields = core.ascend(batch, settings, plan, place, region.middle(config))
            flags |= found
            judged |= fields | ({"restarted": int(restarted)} if config.confidence else {})
            core.v = state.v = tuple(trace.v[-1].tolist())
            flags |= core.short
            if region.moves:
                size = (region.width, region.height)
                sides = zip(config.geometry.size, size, strict=True)
                limits = tuple(max(0, sensor - side) * self._pixel for sensor, side in sides)
                state.position, clamped = move_within(state.position, core.step(settings), limits)
        else:
            core.v = state.v
            trace = Trace.without_iterations(config, state.v)
            flags |= Flag.DEGENERATE
        state.doubtful = Flag.DOUBTFUL in flags
        flags |= Flag.ROI_CLAMPED if clamped else Flag(0)
        counts = {name: batch.counts[name] for name in ("roi_events", "outside", "overflow", "thinned")}
        more = {"thinning_used": batch.counts["thinning_used"]} if thins(config) else {}
        return RegionOutcome(
            **counts,
            **more,
            roi=place,
            roi_next=self._corner(state),
            v=core.velocity,
            iterations=len(trace.sum_i),
            flags=flags,
            **judged,
            trace=trace,
        )

    def _corner(self, state):
        return tuple(int((p + self._pixel / 2) // self._pixel) for p in state.position)
