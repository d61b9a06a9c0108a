"""Tables that software fills: which rows are taken, which are refused, when they are written; and mutants of it."""

import pytest

from cmfpga.config import preset
from cmfpga.protocol.regions import STARTS
from cmfpga.protocol.registers import register_map
from cmfpga.protocol.tables import tables_of, window_of
from cmfpga.rtl.shell import tables
from support.bench import simulate
from support.mutation import break_blocks
from support.values import Port

CONFIG = preset("objects").replace(
    sensor_width=40, sensor_height=30, roi_width=16, roi_height=12, regions=5, undistortion="on", hot_pixels=1,
    bin_bits=3,
)  # fmt: skip
REGISTERS = register_map(CONFIG)
CYCLES = 7000


class Model:
    """The windows as software sees them; nothing of it is written while ``quiet`` is low."""

    def __init__(self):
        links = {name: [f.link for r in window_of(REGISTERS, name) for f in r.fields] for name in tables_of(CONFIG)}
        self.values = {name: dict.fromkeys(found, 0) for name, found in links.items()}
        self.wrong = {name: {} for name in tables_of(CONFIG)}
        self.waiting, self.known, self.written = {}, 0, []
        self.refused = self.cleared = 0

    def write(self, table, register, word, strobe):
        """A write, three cycles before anything else happens."""
        if table in self.waiting:
            self.refused += 1
            return
        fields = {f.link: f.unpack(word) for f in register.fields}
        ends = {f.link: (f.range if f.high is None else (f.low or 0, f.high)) for f in register.fields}
        self.wrong[table][register.name] = strobe != 15 or any(
            not low <= fields[link] <= high for link, (low, high) in ends.items()
        )
        self.values[table] |= fields
        if register is window_of(REGISTERS, table)[-1]:
            if any(self.wrong[table].values()) or not self.allowed(table):
                self.refused += 1
            else:
                self.waiting[table] = dict(self.values[table])

    def allowed(self, table):
        row = self.values[table]
        if table != "row":
            return True
        parent = row["row_start"] != STARTS.index("parent") or row["row_parent"] < row["number"]
        return parent and (row["number"] < self.known or (row["fresh"] and row["number"] == self.known))

    def be_quiet(self):
        for table, row in sorted(self.waiting.items(), reverse=True):  # as the block has them: row, node, mask
            self.written.append((table, row))
            self.known += table == "row" and row["fresh"] and row["number"] == self.known
        self.waiting.clear()


def some_word(rng, register):
    """Fields mostly within their range, at its end, or just beyond it."""
    word = 0
    for f in register.fields:
        low, high = f.range if f.high is None else (f.low or 0, f.high)
        value = int(rng.choice([low, high, rng.integers(low, high + 1), rng.integers(low, high + 1)]))
        if rng.random() < 0.02:
            value = high + 1
        elif rng.random() < 0.02:
            value = low - 1 if f.signed else value ^ 1 << f.width - 1
        word |= (value & (1 << f.width) - 1) << f.lsb
    return word


def play(rng):
    """What differs between block and model, as a list of texts; what the model refused, and wrote of each table."""
    block, model, wrong = tables.Tables(CONFIG, REGISTERS), Model(), []
    registers = {name: window_of(REGISTERS, name) for name in tables_of(CONFIG)}

    async def bench(ctx):
        ports = {name: Port(getattr(block, name)) for name in ("quiet", "opened", "clear")}
        found, since, quiet, rows = [], 0, 1, 1
        for cycle in range(CYCLES):
            since += 1
            ctx.set(block.bus.write.valid, 0)
            opened = clear = 0
            if since > 3 and not quiet and rng.random() < 0.2:
                quiet = 1
            elif since > 3 and quiet and rng.random() < 0.05 and not model.waiting:
                rows = int(rng.integers(1, CONFIG.regions + 1))
                ctx.set(block.settings.rows, rows)
                await ctx.delay(0)
                if ctx.get(block.rows_missing) != (rows > model.known):
                    wrong.append(f"cycle {cycle}: rows_missing, {rows} of {model.known}")
                opened, quiet = int(rows <= model.known), 0
                model.known = rows if opened else model.known
                since = 0
            elif since > 3 and rng.random() < 0.9:
                name = str(rng.choice(list(registers)))
                k = int(rng.integers(len(registers[name])))
                register = registers[name][k if rng.random() < 0.6 else -1]
                word, strobe = some_word(rng, register), 15 if rng.random() < 0.99 else int(rng.integers(15))
                if register.name == "ROW_WRITE" and rng.random() < 0.8:
                    word = register.pack(NUMBER=min(model.known, CONFIG.regions - 1), FRESH=1)
                address = register.offset // 4 if rng.random() < 0.97 else 3
                ctx.set(block.bus.write.valid, 1)
                ctx.set(block.bus.write.payload, {"address": address, "data": word, "strobe": strobe})
                if address != 3:
                    model.write(name, register, word, strobe)
                since = 0
            elif since > 3 and rng.random() < 0.2:
                clear, model.cleared, model.refused, since = 1, model.cleared + model.refused, 0, 0
            if since == 3:
                if ctx.get(block.pending) != bool(model.waiting):
                    wrong.append(f"cycle {cycle}: pending")
                if ctx.get(block.refused) != model.refused:
                    wrong.append(f"cycle {cycle}: refused {ctx.get(block.refused)}, {model.refused}")
            for name, value in {"quiet": quiet and since >= 3, "opened": opened, "clear": clear}.items():
                ports[name].set(ctx, int(value))
            await ctx.delay(0)
            for name in registers:
                flow = getattr(block, f"{name}_write")
                if ctx.get(flow.valid):
                    leaves = tables.leaves_of(flow.payload)
                    found.append((name, {link: ctx.get(signal) for link, signal in leaves.items()}))
            if quiet and since >= 3:
                model.be_quiet()
            if len(wrong) > 3:
                return
            await ctx.tick()
        if found != model.written:
            wrong.append("what was written")

    simulate(block, bench)
    return wrong, model


def test_against_a_model(rng):
    wrong, model = play(rng)
    assert not wrong
    names = [name for name, _ in model.written]
    assert names.count("row") > 20 and names.count("node") > 20 and model.cleared > 20


MUTANTS = {
    "written in a batch": ("waiting & self.quiet", "waiting"),
    "does not wait": ("self.pending.eq(asked | waiting)", "self.pending.eq(asked)"),
    "taken while another waits": ("here[k] & ~self.pending", "here[k]"),
    "a part of a word counts": ("write.strobe != 0b1111", "write.strobe == 0"),
    "one too many": ("word[:width] > f.high", "word[:width] > f.high + 1"),
    "upper bits forgotten": ("word[width:].any() | more", "more"),
    "negative is too large": ("upper.any() & ~upper.all()", "upper.any()"),
    "one wrong word alone matters": ("self.allowed & ~wrong.any()", "self.allowed & ~wrong[0]"),
    "any row": ("self.allowed & ~wrong.any()", "~wrong.any()"),
    "refused is not counted": ("(asked & ~good) |", ""),
    "refused while waiting is not counted": ("| (here.any() & self.pending)", ""),
    "a row behind a gap": ("write.number == known", "write.number >= known"),
    "not fresh": ("write.fresh & (write.number", "(write.number"),
    "its own parent": ("row.parent < write.number", "row.parent <= write.number"),
    "rows out of use stay known": ("known.eq(self.rows)", "known.eq(known)"),
    "nothing is missing": ("self.rows > known", "self.rows > known + 1"),
    "counted on": ("Mux(self.clear, 0, ", "Mux(0, 0, "),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_a_broken_block_is_noticed(name, monkeypatch, rng):
    break_blocks(monkeypatch, tables, *MUTANTS[name])
    assert play(rng)[0]
