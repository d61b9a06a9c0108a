"""Blocks of the regions broken on purpose, one at a time: a few batches notice each."""

import dataclasses
import functools

import numpy as np
import pytest

from cmfpga.config import regions as sizes
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.regions import Region
from cmfpga.rtl.regions import collector, distributor, regions, store, unit
from support.core_batches import settings
from support.mutation import break_blocks
from support.regions import CONFIGS, check_amaranth, model_of

CONFIG = CONFIGS["two units"].replace(regions=5, buffer_events=12, max_batch_events=64, bin_bits=5)
TABLE = [
    Region(x=4, y=4, width=12, height=10, start="last", moves=True),
    Region(x=24, y=12, width=16, height=12),
    Region(x=2, y=3, width=9, height=9),
    Region(x=4, y=4, width=8, height=8, margin=(1, 2), start="parent", parent=0, stride=8),
    Region(x=30, y=20, width=12, height=12, start="parent", parent=1, moves=True),
]
MUTANTS = {  # module, old, new
    "pages never linked": (store, "stored & fresh & (before.count != 0)", "stored & fresh & 0"),
    "a bin's first page forgotten": (store, 'write["head"].data.eq(allocated)', 'write["head"].data.eq(0)'),
    "a page given twice": (store, "m.d.sync += bins.page.eq(bins.page + 1)", "m.d.sync += bins.page.eq(bins.page)"),
    "the last event of a bin": (store, "count.eq(of_bin - 2)", "count.eq(of_bin - 3)"),
    "the next bin too early": (store, "known & (~walking | left[-1])", "known"),
    "bins not forgotten": (store, "operation.clear.eq(clearing)", "operation.clear.eq(0)"),
    "the half that is filled": (store, "m.d.sync += reading.eq(filling)", "m.d.sync += reading.eq(~filling)"),
    "cropped by a column too many": (distributor, "whole < row.end[axis]", "whole <= row.end[axis]"),
    "the stride forgotten": (distributor, "((found & skipped) == 0)", "1"),
    "a parent not waited for": (distributor, "Mux(of_parent, measured & ~there", "Mux(of_parent, 1"),
    "an outcome of the batch before not waited for": (distributor, "there.eq(source.turn", "there.eq(1 | source.turn"),
    "times of the next batch": (unit, "self._times.eq(times)", "self._times.eq(self.times)"),
    "a bin too few": (distributor, "eq((column >= last", "eq((column + 1 >= last"),
    "started where it was not measured": (distributor, "source.followed & ~given", "~given"),
    "doubt does not matter": (distributor, "source.doubtful & settings", "0 & settings"),
    "another unit's events": (unit, "self.i.valid & loading", "self.i.valid"),
    "handed over too early": (unit, "waiting & handover.free & ~take", "waiting & ~take"),
    "a degenerate region forgets v": (collector, "Mux(outcome.degenerate, state.v.as_value(), outcome.v.as_value())",
                                      "outcome.v"),
    "a region does not move": (collector, "Mux(bit, v, 0)", "0"),
    "never doubtful": (collector, "verdict.doubtful & asked", "verdict.doubtful & 0"),
    "the last one is not": (collector, "done + 1 >= batch", "done >= batch"),
    "a row keeps its state": (regions, "write.valid & write.payload.fresh", "0"),
}  # fmt: skip
#: Of two distributors, each with a store.
SEVERAL = {
    "two begin the same unit": (distributor, "free.any() & self.may", "free.any()"),
    "a turn too early": (regions, "turn == 2 * number", "turn == number"),
    "another one's events": (regions, "loads.eq(which)", "loads.eq(0)"),
    "rows given out twice": (distributor, "current.eq(self._first)", "current.eq(0)"),
    "a row for one that has none": (distributor, "settings.rows <= self._first", "0"),
}


def windows():
    """Two clouds that move, one of them not in the second batch; all other events anywhere."""
    rng, found = np.random.default_rng(8), []
    for number in range(3):
        count = 44
        t = np.sort(rng.integers(0, 4000, count))
        t[0], t[-1] = 0, 4000
        moved = (t / 4000 - 0.5) * 4
        clouds = [(9, 8, 1), (31, 17, -1)][: 1 if number == 1 else 2]
        x, y = rng.integers(0, 40, count), rng.integers(0, 30, count)
        for k, (column, row, way) in enumerate(clouds):
            mine = (np.arange(count) % 3) == k
            x[mine] = np.round(column + rng.integers(-2, 3, count) + way * moved)[mine]
            y[mine] = np.round(row + rng.integers(-2, 3, count))[mine]
        found.append((t * (2 + number) // 2, x, y))  # batches of different times
    return found


NAMES = ("v", "roi", "roi_next", "roi_events", "outside", "thinned", "flags", "sums", "curvature", "restarted")
SETTINGS = dataclasses.replace(settings(CONFIG, roi_gain=CONFIG.formats.roi_gain.raw(1.0)), confidence_limit=2)


@functools.cache
def wanted(rows=None):
    model = model_of(CONFIG)
    model.write(TABLE[:rows])
    return [model.run(*window, SETTINGS).regions for window in windows()]


def run(config=CONFIG, rows=None):
    check_amaranth(config, TABLE[:rows], windows(), SETTINGS, wanted(rows), names=NAMES, limit=4_500, stalls=2)


def test_without_a_mutant():
    run()
    assert {Flag.DOUBTFUL in region.flags for result in wanted() for region in result} == {False, True}


@pytest.mark.parametrize("name", MUTANTS)
def test_a_broken_block_is_noticed(name, monkeypatch):
    break_blocks(monkeypatch, *MUTANTS[name])
    with pytest.raises(AssertionError):
        run()


@pytest.fixture
def run_several(monkeypatch):
    """One row, which the second distributor has no part of, then five."""
    monkeypatch.setattr(sizes, "READER_UNITS", 1)

    def play():
        for rows in (1, None):
            config = CONFIG.replace(min_roi_events=2)
            assert config.store.readers == config.units == 2
            run(config, rows)

    return play


def test_several_without_a_mutant(run_several):
    run_several()


@pytest.mark.parametrize("name", SEVERAL)
def test_a_broken_one_of_several_is_noticed(name, monkeypatch, run_several):
    break_blocks(monkeypatch, *SEVERAL[name])
    with pytest.raises(AssertionError):
        run_several()
