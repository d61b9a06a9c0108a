"""Many regions of one batch, in raw integers and in real numbers: store, crop, start, ascend, follow."""

import collections
from dataclasses import dataclass

import torch

from ..fixed import round_half_up
from ..imaging.camera import undistort
from ..protocol.flags import Flag
from ..protocol.results import BatchResult, RegionOutcome
from .ingest import TakenIn, flags_of, to_buffer
from .integer.filters import NoiseFilter
from .integer.roi_filter import Filtered, inside, roi_filter
from .sequence import corner_of, move_within


@dataclass
class _State:
    """What is kept of a region between batches; numbers are those of the core."""

    position: tuple
    v: tuple
    followed: bool = False
    doubtful: bool = False
    plan: tuple = ()


class RegionSequence:
    """A table of regions, and what it does to each batch, as :mod:`cmfpga.rtl.regions` does.

    ``core``, a :class:`~cmfpga.reference.sequence.Sequence`, ascends; what it keeps between batches is not used.
    """

    def __init__(self, core):
        self.core, self.config = core, core.config
        self.regions, self._states = [], []
        self._slices = collections.deque(maxlen=self.config.slices)
        self.noise_filter = NoiseFilter(self.config)
        self._pixel = core.follower.pixel

    def write(self, regions, anew=()):
        """Replace the table. A row that changes, or is one of ``anew``, forgets what it measured and where it moved."""
        regions, states = list(regions), []
        for number, region in enumerate(regions):
            region.check(self.config, number)
            kept = number not in anew and self.regions[number : number + 1] == [region]
            states.append(self._states[number] if kept else self._fresh(region))
        self.regions, self._states = regions, states

    def _fresh(self, region):
        none = self.core.number(self.config.formats.v, 0)
        return _State((region.x * self._pixel, region.y * self._pixel), (none,) * len(self.config.motion_model.names))

    def run(self, t, x, y, settings, *, cut=False):
        """Process one batch, or slice of a window: a :class:`BatchResult` with an outcome for each region.

        Parameters are as of :meth:`Sequence.run <cmfpga.reference.sequence.Sequence.run>`, of one event or more. Of the
        settings ``roi``, ``thinning``, ``thin_target`` and ``start_last`` mean nothing here.
        """
        self._slices.append((t, x, y))
        t, x, y = (torch.cat([torch.as_tensor(one) for one in axis]) for axis in zip(*self._slices, strict=True))
        stored = self._store(t, x, y, settings)
        flags = flags_of(stored.counts, Flag.TIME_BACK, Flag.TIME_SPAN) | (Flag.CUT if cut else Flag(0))
        outcomes = tuple(self._measure(number, stored, settings, flags) for number in range(len(self.regions)))
        del stored.counts["outside"]  # of each region
        return BatchResult(regions=outcomes, **stored.counts)

    def _store(self, t, x, y, settings):
        """Undistort a batch, and put what lies on the sensor in the order of bins, those of a bin in that of time."""
        config, (hot, noise) = self.config, self.noise_filter.judge(t, x, y, settings)
        x, y = undistort(config, settings.camera, x, y)
        t, x, y, counts = roi_filter(config, t, x, y, roi=(0, 0), size=config.geometry.size, hot=hot, noise=noise)
        column, row = (round_half_up(axis, config.formats.event_frac) >> config.bin_bits for axis in (x, y))
        order = torch.argsort(row * config.store.columns + column, stable=True)
        return Filtered(t[order], x[order], y[order], counts)

    def crop(self, number, stored):
        """The events of a region, :class:`TakenIn`, and its left column and top row."""
        config, region = self.config, self.regions[number]
        place = corner_of(self._states[number].position, self._pixel)
        begin, frac = region.corner(config), config.formats.event_frac
        x, y = (axis - ((at - by) << frac) for axis, at, by in zip((stored.x, stored.y), place, begin, strict=True))
        here = inside(config, x, y, begin, (region.width, region.height))
        kept, counts = to_buffer(config, [axis[here] for axis in (stored.t, x, y)], region.stride)
        counts |= {"outside": int((~here).sum()) + stored.counts["outside"], "span": stored.counts["span"]}
        return TakenIn(*kept, counts, flags_of(counts, Flag.OVERFLOW, Flag.THINNED)), place

    def _measure(self, number, stored, settings, flags):
        config, core = self.config, self.core
        region, state = self.regions[number], self._states[number]
        batch, place = self.crop(number, stored)
        source = {"given": None, "last": state, "parent": self._states[region.parent]}[region.start]
        source = source if source and source.followed else None

        def plan(warm):
            own, usual = (region.warm, settings.warm) if warm else (region.cold, settings.cold)
            return usual if own is None else own

        flags, middle = flags | batch.flags, region.middle(config)
        found = core.measure(state, source, batch, settings, plan, place, flags, middle)
        if state.followed and region.moves:
            sides = zip(config.geometry.size, (region.width, region.height), strict=True)
            limits = tuple(max(0, sensor - side) * self._pixel for sensor, side in sides)
            state.position, clamped = move_within(state.position, core.step(settings), limits)
            found["flags"] |= Flag.ROI_CLAMPED if clamped else Flag(0)
        counts = {name: count for name, count in batch.counts.items() if name != "span"}
        return RegionOutcome(**counts, roi=place, roi_next=corner_of(state.position, self._pixel), **found)
