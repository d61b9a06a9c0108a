"""The grid of tiles: every pixel is in one, the table is the hardware's, parents are near."""

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.dense import grid
from cmfpga.errors import ConfigError
from cmfpga.protocol.regions import tables
from cmfpga.protocol.settings import BatchSettings


@pytest.mark.parametrize("sensor", [(240, 180), (190, 180), (130, 97), (64, 64)])
@pytest.mark.parametrize(("tile", "step"), [(32, None), (24, 12), (20, 20), (64, 32), (5, 3)])
def test_every_pixel_is_in_a_tile_and_in_one_coarse_tile_at_least(sensor, tile, step):
    config = preset("flow").replace(sensor_width=sensor[0], sensor_height=sensor[1])
    tiles = grid(config, tile, step)
    coarse = tiles.regions[: len(tiles.regions) - len(tiles)]
    assert bool(coarse) == (tile < 64)
    for level in filter(None, (coarse, tiles.regions[len(coarse) :])):
        count = np.zeros(sensor[::-1], int)
        for region in level:
            assert region.x + region.width <= sensor[0] and region.y + region.height <= sensor[1]
            count[region.y : region.y + region.height, region.x : region.x + region.width] += 1
        assert count.min() >= 1
    # None is so narrow that few events see all of its motion; where none has to be, no event is in two.
    assert all(min(region.width, region.height) >= 48 for region in coarse)
    if coarse and sensor == (240, 180):
        assert sum(region.width * region.height for region in coarse) == 240 * 180
    assert [(region.x, region.y) for region in tiles.regions[len(coarse) :]] == tiles.corners


def test_the_usual_grid_fits_the_preset():
    config = preset("flow")
    tiles = grid(config)
    assert (len(tiles), len(tiles.regions)) == (14 * 11, 14 * 11 + 12)
    rows, plans = tables(config, tiles.regions, BatchSettings.from_config(config, roi=(0, 0)))
    assert len(rows) == len(tiles.regions) <= config.regions and len(plans) <= config.schedule_entries


def test_a_tile_begins_where_the_coarse_tile_with_the_nearest_middle_ended():
    tiles = grid(preset("flow"), 32, 16)
    coarse = tiles.regions[:12]

    def away(region, other):
        return max(abs(2 * (getattr(region, a) - getattr(other, a)) + getattr(region, s) - getattr(other, s))
                   for a, s in (("x", "width"), ("y", "height")))  # fmt: skip

    for region in tiles.regions[12:]:
        assert region.start == "parent"
        assert away(region, coarse[region.parent]) == min(away(region, one) for one in coarse)
    assert {region.parent for region in tiles.regions[12:]} == set(range(12))
    assert all(region.start == "given" for region in coarse)  # each window stands on its own


@pytest.mark.parametrize("tile, step, fields, why", [
    (65, None, {}, "4 to 64 px"), (3, None, {}, "4 to 64 px"), (32, 33, {}, "1 to 32 px"), (32, 0, {}, "1 to 32"),
    (32, None, {"motion": "similarity", "ascent": "sign", "warm": "auto", "schedule_entries": 64},
     r"^motion = similarity: translation is needed.*; --fit similarity finds"),
])  # fmt: skip
def test_what_does_not_fit(tile, step, fields, why):
    with pytest.raises(ConfigError, match=why):
        grid(preset("flow").replace(**fields), tile, step)
