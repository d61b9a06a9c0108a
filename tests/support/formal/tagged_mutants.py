"""The tagged accumulator, broken on purpose: each of these must be found by the proof, and by simulation."""

from cmfpga.rtl.image import tagged_accumulator
from support.formal.accumulator_mutants import Mutant as AnyMutant


def Mutant(name, old, new):
    return AnyMutant(name, old, new, tagged_accumulator)


_YOUNGEST_LAST = "in ((3, 5), (2, 4), (1, 3)):"
_MATCH = "valid[stage - 1] & (address[stage - 1] == address[1])"
_SAME = "read_s2.tag == tag[2], same_s2)"
_RAM = "read_s2.tag == tag[2]"


BANK = [
    Mutant("youngest sum not forwarded", _YOUNGEST_LAST, "in ((3, 5), (2, 4)):"),
    Mutant("second sum not forwarded", _YOUNGEST_LAST, "in ((3, 5), (1, 3)):"),
    Mutant("third sum not forwarded", _YOUNGEST_LAST, "in ((2, 4), (1, 3)):"),
    Mutant("oldest sum wins", _YOUNGEST_LAST, "in ((1, 3), (2, 4), (3, 5)):"),
    Mutant("second sum wins over youngest", _YOUNGEST_LAST, "in ((3, 5), (1, 3), (2, 4)):"),
    Mutant("third sum wins over second", _YOUNGEST_LAST, "in ((2, 4), (3, 5), (1, 3)):"),
    Mutant("match ignores valid", _MATCH, "address[stage - 1] == address[1]"),
    Mutant("match one cycle early", _MATCH, "valid[stage - 1] & (address[stage - 1] == address[0])"),
    Mutant("match ignores an address bit", _MATCH, "valid[stage - 1] & (address[stage - 1][1:] == address[1][1:])"),
    Mutant("forwarded sums count with any tag", _SAME, _SAME.replace("same_s2", "1")),
    Mutant("sums forwarded from one stage too far", "Mux(low, words[3], words[2])", "Mux(low, words[2], words[3])"),
    Mutant("forwarded sums never count", _SAME, _SAME.replace("same_s2", "0")),
    Mutant("tags compared one cycle early", "tag[stage - 1] == tag[1]", "tag[stage - 1] == tag[0]"),
    Mutant("tags match in part", "tag[stage - 1] == tag[1]", "tag[stage - 1][0] == tag[1][0]"),
    Mutant("another tag is the match's end", _MATCH, f"{_MATCH} & (tag[stage - 1] == tag[1])"),
    Mutant("words count with any tag", _RAM, "1"),
    Mutant("words with any tag but zero count", _RAM, "read_s2.tag != 0"),
    Mutant("words compared with a younger tag", _RAM, _RAM.replace("tag[2]", "tag[1]")),
    Mutant("tag not written", "write.data.tag.eq(tag[3])", "write.data.tag.eq(0)"),
    Mutant("tag of a younger operation written", "write.data.tag.eq(tag[3])", "write.data.tag.eq(tag[2])"),
    Mutant("third sum is the second", "total[5].eq(total[4])", "total[5].eq(total[3])"),
    Mutant("write ignores valid", "write.en.eq(valid[3])", "write.en.eq(1)"),
    Mutant("write at a younger address", "write.addr.eq(address[3])", "write.addr.eq(address[2])"),
    Mutant("sum of the wrong operation", "add_s2[name] + base[name]", "add_s1[name] + base[name]"),
    Mutant("told of the wrong operation", "self.o.payload.add.eq(add_s2)", "self.o.payload.add.eq(add_s1)"),
    Mutant("told past the forwarding", "self.o.payload.i.eq(found.i)", "self.o.payload.i.eq(read_s2.i)"),
    Mutant("told of a word that does not count", "with m.If(~counts | ~valid[2]):", "with m.If(~valid[2]):"),
    Mutant("told early", "self.o.valid.eq(valid[3])", "self.o.valid.eq(valid[2])"),
]

_NEXT = "Mux(tag == (1 << config.tag_bits) - 1, 1, tag + 1)"

#: Only simulation and the proof of the accumulator can see these.
ACCUMULATOR = [
    Mutant(
        "sweep leaves a word out",
        "last = address == config.geometry.bank_depth - 1",
        "last = address == config.geometry.bank_depth - 2",
    ),
    Mutant("sweep writes nothing", "[bank.i.valid.eq(1), operation", "[bank.i.valid.eq(0), operation"),
    Mutant("sweep goes on under votes", "with m.If(~self.i.valid):", "with m.If(1):"),
    Mutant("pass over early", "self.swept.eq(~self.i.valid & last)", "self.swept.eq(address == 0)"),
    Mutant("one tag left out", _NEXT, _NEXT.replace("1, 1,", "1, 2,")),
    Mutant("tag of the sweep used", _NEXT, "tag + 1"),
    Mutant("tag stays", _NEXT, "tag"),
    Mutant("absent votes count", "bank.i.valid.eq(vote.valid)", "bank.i.valid.eq(1)"),
    Mutant("sweep told as votes", "bank.o.valid & voted[-1]", "bank.o.valid"),
    Mutant("votes of one bank in all", "vote = self.i.payload.banks[number]", "vote = self.i.payload.banks[0]"),
]
