"""Both accumulators, broken on purpose: each mutant must be found by the proof."""

import types
from dataclasses import dataclass

from cmfpga.rtl import read_modify_write
from cmfpga.rtl.image import accumulator, sliced_memory, tagged_accumulator
from support.mutation import mutated


@dataclass(frozen=True)
class Mutant:
    """One replacement in the source of a module."""

    name: str
    old: str
    new: str
    original: types.ModuleType = accumulator

    def module(self):
        return mutated(self.original, self.old, self.new)

    def __str__(self):
        return self.name.replace(" ", "-")


def tagged(name, old, new):
    return Mutant(name, old, new, tagged_accumulator)


def bank(name, old, new):
    return Mutant(name, old, new, read_modify_write)


#: The stages whose sums are forwarded, the oldest first, counted from that of the write.
_FORWARDED = {
    "youngest sum not forwarded": (2, 1),
    "second sum not forwarded": (2, 0),
    "third sum not forwarded": (1, 0),
    "oldest sum wins": (0, 1, 2),
    "second sum wins over youngest": (2, 0, 1),
    "third sum wins over second": (1, 2, 0),
}


def _match(compared):
    return f"valid[stage - 1] & (address[stage - 1] == address[{compared}])"


def _in_both(make, write, compared, written):
    """Mutants of what both banks have: one that writes and compares at those stages; how stages stand in the source."""
    match = _match(compared)

    def stages(offsets):
        return written(tuple(write + offset for offset in offsets))

    second, third = f"total[{write + 1}]", f"total[{write + 2}]"
    return [
        *(make(name, stages((2, 1, 0)), stages(offsets)) for name, offsets in _FORWARDED.items()),
        make("match ignores valid", match, f"address[stage - 1] == address[{compared}]"),
        make("match of another cycle", match, _match(1 - compared)),
        make("match ignores an address bit", match, match.replace("] ==", "][1:] ==").replace("])", "][1:])")),
        make("third sum is the second", f"{third}.eq({second})", f"{third}.eq(total[{write}])"),
        make("write ignores valid", f"write.en.eq(valid[{write}])", "write.en.eq(1)"),
        make("write at a younger address", f"write.addr.eq(address[{write}])", f"write.addr.eq(address[{write - 1}])"),
    ]


_CLEAR = "with m.If(operation_s2.clear):\n            m.d.sync += total[3].eq(0)\n"
_CLEAR_IN_RAM_ONLY = """clear_s3 = Signal()
        m.d.sync += clear_s3.eq(operation_s2.clear)
        with m.If(clear_s3):
            m.d.comb += [write.data.eq(0) for _, write in ports.values()]
"""

READ_ADD_WRITE = [
    *_in_both(bank, 3, 1, lambda stages: f"for stage in {stages}:"),
    bank("clear lost", _CLEAR, "pass\n"),
    bank("clear not forwarded", _CLEAR, _CLEAR_IN_RAM_ONLY),
    bank("sum of the wrong operation", "base[name], operation_s2.add)", "base[name], operation_s1.add)"),
    bank("answer past the forwarding", "self.o.payload[name].eq(base[name])", "self.o.payload[name].eq(read_s2[name])"),
    bank("answer announced early", "self.o.valid.eq(valid[2])", "self.o.valid.eq(valid[1])"),
]

_RAM = "read_s2.tag == tag[2]"
_BEHIND = "behind_s2.eq(match[2] & same[2])"

TAGGED_BANK = [
    *_in_both(tagged, 4, 0, lambda stages: f"in {tuple((stage - 3, stage - 1) for stage in stages)}:"),
    tagged("forwarded sums count with any tag", "match[stage], same[stage], sum_counts", "match[stage], 1, sum_counts"),
    tagged("sums forwarded from one stage too far", "Mux(low, words[3], words[2])", "Mux(low, words[2], words[3])"),
    tagged("forwarded sums never count", "counts = sum_counts_s2 | (", "counts = ("),
    tagged("tags compared one cycle late", "tag[stage - 1] == tag[0]", "tag[stage - 1] == tag[1]"),
    tagged("tags match in part", "tag[stage - 1] == tag[0]", "tag[stage - 1][0] == tag[0][0]"),
    tagged("another tag is the match's end", _match(0), f"{_match(0)} & (tag[stage - 1] == tag[0])"),
    tagged("sum right before not forwarded", _BEHIND, "behind_s2.eq(0)"),
    tagged("sum right before forwarded to any row", _BEHIND, "behind_s2.eq(same[2])"),
    tagged("sum right before counts with any tag", _BEHIND, "behind_s2.eq(match[2])"),
    tagged("sum right before never counts", "behind_s3.eq(behind_s2)", "behind_s3.eq(0)"),
    tagged("older sums stay under the one right before", "sum_counts & ~match[2]", "sum_counts"),
    tagged("words stay under the sum right before", "(forwarded == 0) & ~match[2]", "forwarded == 0"),
    tagged("words stay under a forwarded sum", "(forwarded == 0) & ~match[2]", "~match[2]"),
    tagged("words count with any tag", _RAM, "1"),
    tagged("words with any tag but zero count", _RAM, "read_s2.tag != 0"),
    tagged("words compared with a younger tag", "tag == tag[2]", "tag == tag[1]"),
    tagged("tag not written", "write.data.tag.eq(tag[4])", "write.data.tag.eq(0)"),
    tagged("tag of a younger operation written", "write.data.tag.eq(tag[4])", "write.data.tag.eq(tag[3])"),
    tagged("sum of the wrong operation", "add[3][name] + base[name]", "add[2][name] + base[name]"),
    tagged("told of the wrong operation", "self.o.payload.add.eq(add[3])", "self.o.payload.add.eq(add[2])"),
    tagged("told of the sum before", "self.o.payload.i.eq(base.i)", "self.o.payload.i.eq(total[4].i)"),
    tagged("told of a word that does not count", "counts_s3.eq(counts)", "counts_s3.eq(~behind_s2)"),
    tagged("told early", "self.o.valid.eq(valid[4])", "self.o.valid.eq(valid[3])"),
]

SLICED_MEMORY = [
    Mutant(name, old, new, sliced_memory)
    for name, old, new in (
        ("lowest slice in all", "eq(given[low:high])", "eq(given[: high - low])"),
        ("last slice left out", "range(0, bits, width)", "range(0, bits - width, width)"),
        ("a bit of each slice left out", "found[low:high].eq(read.data)", "found[low : high - 1].eq(read.data)"),
        ("an address bit ignored in reading", "eq(self.read.addr)", "eq(self.read.addr[1:] << 1)"),
        ("written at the row that is read", "eq(self.write.addr)", "eq(self.read.addr)"),
        ("always written", "eq(self.write.en)", "eq(1)"),
    )
]

ACCUMULATOR = [
    Mutant("votes of absent banks count", "(self.i.valid & vote.valid)", "self.i.valid"),
    Mutant("votes count without an event", "(self.i.valid & vote.valid)", "vote.valid"),
    Mutant("sweep does not clear", "bank.i.payload.clear.eq(self.sweep.valid)", "bank.i.payload.clear.eq(0)"),
    Mutant("sweep address ignored", "address.eq(self.sweep.payload.address)", "address.eq(vote.address)"),
]

_NEXT = "Mux(tag == (1 << config.tag_bits) - 1, 1, tag + 1)"

TAGGED_ACCUMULATOR = [
    tagged("sweep leaves a word out", "config.geometry.bank_depth - 1\n", "config.geometry.bank_depth - 2\n"),
    tagged("sweep writes nothing", "valid_s1.eq(sweeps if config.slides else 1)", "valid_s1.eq(0)"),
    tagged("sweep goes on under votes", "with m.If(sweeps if config.slides else ~self.i.valid):", "with m.If(1):"),
    tagged("pass over early", "sync += self.swept.eq(sweeps & last)", "comb += self.swept.eq(address == 0)"),
    tagged("one tag left out", _NEXT, _NEXT.replace("1, 1,", "1, 2,")),
    tagged("tag of the sweep used", _NEXT, "tag + 1"),
    tagged("tag stays", _NEXT, "tag"),
    tagged("absent votes count", "valid_s1.eq(vote.valid)", "valid_s1.eq(1)"),
    tagged("sweep told as votes", "bank.o.valid & voted[-1]", "bank.o.valid"),
    tagged("votes of one bank in all", "vote = self.i.payload.banks[number]", "vote = self.i.payload.banks[0]"),
]
