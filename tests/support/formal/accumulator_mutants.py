"""The accumulator, broken on purpose: each of these must be found by the proof, and by simulation."""

import inspect
import types
from dataclasses import dataclass

from cmfpga.rtl.image import accumulator


@dataclass(frozen=True)
class Mutant:
    """One replacement in the source of a module."""

    name: str
    old: str
    new: str
    original: types.ModuleType = accumulator

    def module(self):
        """The mutated module. Fails where the source has changed so that the mutant means nothing any more."""
        source = inspect.getsource(self.original)
        count = source.count(self.old)
        assert count == 1, f"mutant {self.name!r} has to be rewritten: its pattern occurs {count} times:\n{self.old}"
        module = types.ModuleType(f"{self.original.__name__}_mutant")
        module.__package__ = self.original.__package__
        exec(compile(source.replace(self.old, self.new), f"<mutant {self.name}>", "exec"), module.__dict__)
        return module

    def __str__(self):
        return self.name.replace(" ", "-")


_PRIORITY = "for stage in (5, 4, 3):"
_MATCH = "valid[stage - 1] & (address[stage - 1] == address[1])"
_CLEAR = "with m.If(operation_s2.clear):\n            m.d.sync += total[3].eq(0)\n"
_CLEAR_IN_RAM_ONLY = """clear_s3 = Signal()
        m.d.sync += clear_s3.eq(operation_s2.clear)
        with m.If(clear_s3):
            m.d.comb += [write.data.eq(0) for _, write in ports.values()]
"""

READ_ADD_WRITE = [
    Mutant("youngest sum not forwarded", _PRIORITY, "for stage in (5, 4):"),
    Mutant("second sum not forwarded", _PRIORITY, "for stage in (5, 3):"),
    Mutant("third sum not forwarded", _PRIORITY, "for stage in (4, 3):"),
    Mutant("oldest sum wins", _PRIORITY, "for stage in (3, 4, 5):"),
    Mutant("second sum wins over youngest", _PRIORITY, "for stage in (5, 3, 4):"),
    Mutant("third sum wins over second", _PRIORITY, "for stage in (4, 5, 3):"),
    Mutant("match ignores valid", _MATCH, "address[stage - 1] == address[1]"),
    Mutant("match one cycle early", _MATCH, "valid[stage - 1] & (address[stage - 1] == address[0])"),
    Mutant("match ignores an address bit", _MATCH, "valid[stage - 1] & (address[stage - 1][1:] == address[1][1:])"),
    Mutant("third sum is the second", "total[5].eq(total[4])", "total[5].eq(total[3])"),
    Mutant("clear lost", _CLEAR, "pass\n"),
    Mutant("clear not forwarded", _CLEAR, _CLEAR_IN_RAM_ONLY),
    Mutant("write ignores valid", "write.en.eq(valid[3])", "write.en.eq(1)"),
    Mutant("write at a younger address", "write.addr.eq(address[3])", "write.addr.eq(address[2])"),
    Mutant("sum of the wrong operation", "base[name] + operation_s2.add[name]", "base[name] + operation_s1.add[name]"),
    Mutant(
        "answer past the forwarding", "self.o.payload[name].eq(base[name])", "self.o.payload[name].eq(read_s2[name])"
    ),
    Mutant("answer announced early", "self.o.valid.eq(valid[2])", "self.o.valid.eq(valid[1])"),
]

ACCUMULATOR = [
    Mutant("votes of absent banks count", "(self.i.valid & vote.valid)", "self.i.valid"),
    Mutant("votes count without an event", "(self.i.valid & vote.valid)", "vote.valid"),
    Mutant("sweep does not clear", "bank.i.payload.clear.eq(self.sweep.valid)", "bank.i.payload.clear.eq(0)"),
    Mutant(
        "sweep address ignored",
        "bank.i.payload.address.eq(self.sweep.payload.address)",
        "bank.i.payload.address.eq(vote.address)",
    ),
]
