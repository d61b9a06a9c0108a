"""The table of regions of dense flow: a grid of tiles in two levels.

Coarse tiles, as large as the hardware's image and side by side, begin anew in each window. The last ones are narrower
where that costs them a quarter at most, or events would be read and iterated twice; else they overlap. Fine tiles
overlap and begin where the nearest coarse one ended, so that their schedule is short; the image around them keeps the
votes of events that leave them.
"""

from dataclasses import dataclass

import numpy as np

from ..errors import ConfigError
from ..imaging.survey.statistics import box_sums
from ..protocol.regions import Region

#: Width and height of a tile, px; the next one begins half of that further on.
TILE = 32

#: Sizes of a tile, of which the first one is taken that a table of regions holds: HD has 48 px.
SIZES = (TILE, 48, 64)

#: Up to so many pixels: events of the largest window, the width of the store's bins, 2^bits px, and units at most.
#: They take at most the 64 UltraRAMs of a KV260: a store has 2 memories of events of 4096 words, where each bin leaves
#: a page part empty; more than four units need two stores, and their event buffers lie in UltraRAM, too.
STORES = ((1 << 16, 32_767, 4, 5), (1 << 17, 65_535, 4, 4), (1 << 21, 98_303, 5, 4))


@dataclass(frozen=True)
class Tiles:
    """A grid of tiles."""

    columns: tuple  # left columns of the fine tiles, px
    rows: tuple  # top rows, px
    width: int  # of a fine tile, px, as the height
    height: int
    regions: tuple  # the hardware's table of Region: the coarse tiles, then the fine ones, row by row

    def __len__(self):
        return len(self.columns) * len(self.rows)

    @property
    def corners(self):
        """Left column and top row of each fine tile, px."""
        return [(x, y) for y in self.rows for x in self.columns]

    def of(self, result):
        """The outcomes of the fine tiles of a batch's result."""
        return result.regions[len(self.regions) - len(self) :]

    def sums(self, *images):
        """Sums of images [rows, columns] of the sensor over each fine tile: float64 [n] of each."""
        left, top = np.array(self.corners).T
        return [box_sums(image, self.width, self.height)[top, left] for image in images]

    def of_pixels(self, width, height):
        """Number of the tile whose middle is nearest to each pixel, int64 [height, width]; and whether it has it."""
        row, in_row = _along(np.array(self.rows), self.height, height)
        column, in_column = _along(np.array(self.columns), self.width, width)
        return row[:, None] * len(self.columns) + column, in_row[:, None] & in_column


def grid(config, tile=TILE, step=None):
    """The :class:`Tiles` of a sensor. The last column and row of tiles end where the sensor does.

    ``tile``: width and height of a fine one, px, no larger than the image; ``step``: from one to the next, px, by
    default half a tile. Raises :exc:`ConfigError` where a size, or the motion, is not allowed; ``regions`` need not be
    large enough.
    """
    if config.motion != "translation":
        raise ConfigError(
            f"motion = {config.motion}: translation is needed, for a tile is too small for more; --fit {config.motion} "
            "finds that of the whole field"
        )
    if config.binning:
        raise ConfigError(f"binning = {config.binning}: flow is in the sensor's pixels: 0 is needed")
    sensor = config.sensor_width, config.sensor_height
    coarse = tuple(map(min, sensor, (config.roi_width, config.roi_height)))
    if not 4 <= tile <= min(coarse):
        raise ConfigError(f"tile = {tile}: 4 to {min(coarse)} px are allowed (roi_width, roi_height, sensor)")
    step = max(1, tile // 2) if step is None else step
    if not 1 <= step <= tile:
        raise ConfigError(f"step = {step}: 1 to {tile} px are allowed, or events would be in no tile")
    columns, rows = ((*range(0, size - tile, step), size - tile) for size in sensor)
    first, parents = [], ()
    if tile < min(coarse):
        parents = tuple(map(_side_by_side, sensor, coarse))
        first = [Region(x=x, y=y, width=width, height=height) for y, height in parents[1] for x, width in parents[0]]

    def fine(x, y):
        if not parents:
            return Region(x=x, y=y, width=tile, height=tile)
        column, row = (_nearest(at, places, tile) for at, places in zip((x, y), parents, strict=True))
        return Region(x=x, y=y, width=tile, height=tile, start="parent", parent=row * len(parents[0]) + column)

    return Tiles(columns, rows, tile, tile, (*first, *(fine(x, y) for y in rows for x in columns)))


def fitting(config, most, tile=None, step=None):
    """The :class:`Tiles` that a table of ``most`` regions holds: tiles as small, and as near, as it has room for.

    ``tile`` and ``step`` as of :func:`grid`; without, one of :data:`SIZES`, every half of it, three quarters or all.
    """
    side = min(config.sensor_width, config.sensor_height, config.roi_width, config.roi_height)
    sizes = [size for size in SIZES if size <= side] or [side] if tile is None else [tile]
    for size in sizes:
        for every in (max(1, size // 2), 3 * size // 4, size) if step is None else (step,):
            tiles = grid(config, size, every)
            if len(tiles.regions) <= most:
                return tiles
    px = f"{config.sensor_width}×{config.sensor_height} px"
    raise ConfigError(
        f"tiles of {size} px every {every} px: {len(tiles.regions)} regions on {px}; at most {most} are allowed "
        f"(regions): {'a larger --tile or --step is' if tile or step else 'a smaller sensor is'} needed"
    )


def store_fields(config, given):
    """The fields of the store that suit a sensor, as of :data:`STORES`, without those ``given``."""
    pixels = config.sensor_width * config.sensor_height
    events, bits, units = next((tuple(rest) for most, *rest in STORES if pixels <= most), STORES[-1][1:])
    fields = {"max_batch_events": max(events, config.max_batch_events), "bin_bits": max(bits, config.bin_bits)}
    fields["units"] = min(units, config.units)
    return {name: value for name, value in fields.items() if name not in given}


def _along(starts, side, pixels):
    at = np.arange(pixels)
    index = np.searchsorted((starts[1:] + starts[:-1] + side - 1) / 2, at)
    return index, (at >= starts[index]) & (at < starts[index] + side)


def _side_by_side(size, side):
    """Places and sides of tiles that hold a size."""
    *full, last = range(0, size, side)
    last = (last, size - last) if 4 * (size - last) >= 3 * side else (size - side, side)
    return (*((at, side) for at in full), last)


def _nearest(at, places, own):
    """Number of the place whose middle is nearest."""
    return min(range(len(places)), key=lambda k: abs(2 * places[k][0] + places[k][1] - 2 * at - own))
