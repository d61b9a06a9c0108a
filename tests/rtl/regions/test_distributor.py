"""Distributor: each row is given out once, in order, to a unit that is free, when what it starts with is there.

All patterns of three rows and two units, of which each is busy, can be loaded, or is idle; one batch a pattern, some
batches of one row, and outcomes that come soon or late, so that those of two batches are under way.
"""

import functools
import itertools

import pytest

from cmfpga.rtl.regions import distributor
from support.bench import simulate
from support.mutation import break_blocks
from support.regions import CONFIGS

CONFIG = CONFIGS["two units"].replace(regions=4)
BUSY, READY, IDLE = range(3)
ROWS = 3
#: Left column, top row, width and height of each row; each has other bins.
PLACES = ((0, 0, 8, 4), (9, 6, 3, 3), (38, 20, 8, 12))
#: The parent of each row, or none.
FAMILIES = ((None, None, None), (None, 0, 0), (None, 0, 1))
PATIENCE = 20  # cycles after which units that are all busy can be loaded


def bins(place):
    x, y, width, height = place
    bits, store = CONFIG.bin_bits, CONFIG.store
    columns = range(x >> bits, min(x + width - 1 >> bits, store.columns - 1) + 1)
    rows = range(y >> bits, min(y + height - 1 >> bits, store.rows - 1) + 1)
    return [row << store.column_bits | column for row in rows for column in columns]


class Surroundings:
    """What a distributor sees, and what must hold of what it does."""

    def __init__(self, family):
        self.family = family
        self.turns = [0] * CONFIG.regions  # kept of each region: the batch that it was measured in last
        self.pending = []  # (cycle, batch, row): outcomes that will come
        self.batch, self.row, self.rows, self.given = 0, 0, 0, None
        self.reads, self.waited, self.cleared = [], 0, True
        self.overlaps = 0  # rows that were given out while outcomes of the batch before were missing

    def take(self):
        """The next batch; rows that were not in the one before are written fresh."""
        assert self.row == self.rows and not self.missing(self.batch - 1) and self.cleared, "a batch too many"
        for row in range(self.rows, CONFIG.regions):
            self.turns[row] = self.batch % 2
        self.batch, self.row, self.waited, self.cleared = self.batch + 1, 0, 0, False
        self.rows = 1 if self.batch % 4 == 3 else ROWS

    def units(self, pattern):
        """Which can be loaded, and which are idle, for this row."""
        states = pattern[self.row] if self.row < self.rows else (BUSY, BUSY)
        if {*states} == {BUSY} and self.waited > PATIENCE:
            states = (READY, READY)
        return tuple(sum((state in wanted) << k for k, state in enumerate(states)) for wanted in ((1, 2), (2,)))

    def outcomes(self, cycle):
        """Those that come now; one a cycle."""
        due = [one for one in self.pending if one[0] <= cycle][:1]
        for one in due:
            self.pending.remove(one)
            self.turns[one[2]] = one[1] % 2

    def missing(self, batch):
        """Rows of a batch, or of an earlier one, whose outcomes have not come."""
        return {row for _, of, row in self.pending if of <= batch}

    def begins(self, begin, ready, idle):
        assert self.given is None and self.row < self.rows, "a unit begins while another one is loaded"
        free = (ready & idle) or ready
        assert begin == free & -free, "not to the unit that is free"
        assert self.row not in self.missing(self.batch - 1), "its outcome of the batch before has not come"
        parent = self.family[self.row]
        assert parent is None or parent not in self.missing(self.batch), "its parent's outcome has not come"
        self.given, self.reads = begin, []
        self.overlaps += bool(self.missing(self.batch - 1))

    def commits(self, commit, job, cycle, delay, busy):
        assert commit == self.given and not busy, "to another unit, or while its events come"
        assert (job.number, job.turn) == (self.row, self.batch % 2), "another row"
        assert self.reads == bins(PLACES[self.row]), "other bins"
        self.pending.append((cycle + delay, self.batch, self.row))
        self.given, self.row, self.waited = None, self.row + 1, 0


async def play(ctx, dut, family, patterns):
    """One batch a pattern."""
    around, answers, busy, clears = Surroundings(family), [0] * 3, 0, 0
    begin = [{"x": (CONFIG.roi_width - w) // 2, "y": (CONFIG.roi_height - h) // 2} for _, _, w, h in PLACES]
    fraction = CONFIG.v_frac + CONFIG.roi_gain_frac
    ctx.set(dut.divided, 1)
    ctx.set(dut.read.ready, 1)
    for cycle in range(150 * len(patterns)):
        pattern = patterns[max(0, around.batch - 1)]
        around.outcomes(cycle)
        number = min(answers[1], ROWS - 1)  # two cycles later
        x, y, width, height = PLACES[number]
        parent = family[number]
        ctx.set(dut.row.begin, begin[number])
        ctx.set(dut.row.end, {"x": begin[number]["x"] + width, "y": begin[number]["y"] + height})
        ctx.set(dut.row.start, 0 if parent is None else 2)
        ctx.set(dut.row.parent, parent or 0)
        ctx.set(dut.state.position, {"x": x << fraction, "y": y << fraction})
        ctx.set(dut.state.turn, around.turns[number])
        ready, idle = around.units(pattern)
        ctx.set(dut.ready, ready)
        ctx.set(dut.idle, idle)
        ctx.set(dut.busy, busy > 0)
        ctx.set(dut.begun, not around.missing(around.batch - 1))
        ctx.set(dut.cleared, clears == 0)
        takes = ctx.get(dut.free)
        if takes and around.batch == len(patterns):
            assert around.overlaps > len(patterns) // 2, "a batch waits for all of the one before"
            return
        ctx.set(dut.take, takes)
        if begun := ctx.get(dut.begin):
            around.begins(begun, ready, idle)
        if ctx.get(dut.read.valid):
            assert around.given is not None, "bins are read for no unit"
            around.reads.append(ctx.get(dut.read.payload))
            busy = 12
        if committed := ctx.get(dut.commit):
            around.commits(committed, ctx.get(dut.job), cycle, (3, 60, 30)[(around.batch + around.row) % 3], busy)
        if ctx.get(dut.clear):
            assert around.row == around.rows, "the events are forgotten too early"
            around.cleared, clears = True, 4
        busy, clears = max(0, busy - 1), max(0, clears - 1)
        answers = [ctx.get(dut.number), answers[0]]
        around.waited += 1
        if takes:
            around.take()
            ctx.set(dut.settings.rows, around.rows)
        await ctx.tick()
    raise AssertionError(f"{around.batch} batches, {around.row} rows of the last one")


def check(family, patterns):
    dut = distributor.Distributor(CONFIG)
    simulate(dut, functools.partial(play, dut=dut, family=family, patterns=patterns))


EVERY = [*itertools.product(itertools.product((BUSY, READY, IDLE), repeat=2), repeat=ROWS)]


@pytest.mark.usefixtures("long_tools")  # patterns without end
@pytest.mark.parametrize(("family", "step"), [*zip(FAMILIES, (10, 10, 1), strict=True)])
def test_each_row_once_and_in_order(family, step):
    assert len(EVERY) == 9**ROWS
    check(family, EVERY[::step])


MUTANTS = {
    "a busy unit": ("with m.If(free.any() & self.may):", "with m.If(1):"),
    "not the idle one": ("free = Mux(idle.any(), idle, ready)", "free = ready"),
    "two units": ("chosen = free & (~free + 1)[: config.units]", "chosen = free"),
    "handed to another unit": ("self.commit.eq(unit)", "self.commit.eq(~unit)"),
    "a row again and again": ("current.eq(current + store.readers)", "current.eq(current)"),
    "a row left out": ("current.eq(current + store.readers)", "current.eq(current + 2)"),
    "the last row left out": ("current + store.readers >= settings.rows", "current + 2 >= settings.rows"),
    "a row too many": ("current + store.readers >= settings.rows", "current >= settings.rows"),
    "before its outcome of the batch before": ("there.eq(source.turn != self.turn)", "there.eq(1)"),
    "before its parent": ("Mux(of_parent, measured & ~there", "Mux(of_parent, 1"),
    "the row that was looked up before": ("timer.eq(3), measured.eq(0)", "timer.eq(3)"),
    "before its events": ("with m.If(self.busy):", "with m.If(0):"),
    "one batch like the next": ("self.turn.eq(~self.turn)", "self.turn.eq(self.turn)"),
    "three batches under way": ("with m.If(self.begun):", "with m.If(1):"),
    "never forgotten": ("m.d.comb += self.clear.eq(1)", "m.d.comb += self.clear.eq(0)"),
    "a bin too few": ("eq((column >= last", "eq((column + 1 >= last"),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_a_broken_one_is_noticed(name, monkeypatch):
    break_blocks(monkeypatch, distributor, *MUTANTS[name])
    with pytest.raises(AssertionError):
        for family in FAMILIES:
            check(family, EVERY[::60])
