"""Mutants of the core whose windows slide: what :mod:`test_core` compares notices each of them."""

from contextlib import closing

import pytest

from cmfpga.protocol.settings import BatchSettings
from cmfpga.rtl.image import tagged_accumulator
from cmfpga.rtl.sliding import hop_control, hop_evaluation, ring, walker
from cmfpga.rtl.top import VerilogSliding
from cmfpga.verilog.simulation import VerilatedCore
from support.hops import CORNER
from support.mutation import break_blocks

from .test_core import CASES, compared, compared_with_changes

SHORT = CASES["both"].replace(buffer_events=127, window_us=2500)
FULL = SHORT.replace(window_us=4000)
EMPTY = CASES["empty windows"]


class Changed(VerilogSliding):
    """A type of its own, whose Verilog is not that which is kept for the configuration."""


MUTANTS = {  # module, old, new
    "the ring overflows": (hop_control, "full.eq(stays & ", "full.eq(0 & "),
    "an image is swept while it waits for events": (tagged_accumulator, "sweeps &= ~inside", "sweeps &= 1"),
    "too few events are evaluated": (hop_evaluation, "many.eq((hop.count != 0) & ", "many.eq(1 | "),
    "a pause is none": (hop_evaluation, "(span != 0) & ~hop.stale", "(span != 0)"),
    "the first window need not be full": (hop_evaluation, "(full | followed)", "1"),
    "age goes on through windows that are too short": (
        hop_evaluation, "age.eq(Mux(many & timed, aged, 0))", "age.eq(aged)"
    ),
    "the unit forgets the window": (hop_evaluation, "gap.eq(Mux(hop.empty, 0,", "gap.eq(Mux(1, 0,"),
    "the reference time stands still": (
        hop_evaluation, "half.eq(self.unit >> 1), first.eq(hop.t_first)]", "half.eq(self.unit >> 1)]"
    ),
    "an event of the next hop in an empty window": (ring, " & ~over)", ")"),
    "the judging round is read at once": (hop_evaluation, "held & ~self.cold", "held & self.cold"),
}  # fmt: skip


OF_CHANGES = {  # the same, of lengths that change
    "lengths stay": (hop_evaluation, "m.d.sync += [settings[name].eq(self.given[name]) for name in LENGTHS]", "pass"),
    "the hop under way is longer at once": (
        hop_control, "late.eq(timed & ~back_s2", "late.eq((lengths.hop_us != 0) & ~back_s2"
    ),
    "the walker is late": (
        walker, "with m.If(self.closed):\n            longest", "with m.If(self.go):\n            longest"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_mutants_are_noticed(name, rng, monkeypatch):
    break_blocks(monkeypatch, *MUTANTS[name])
    config = {"the ring overflows": FULL, "an event of the next hop in an empty window": EMPTY}.get(name, SHORT)
    with closing(VerilatedCore(config, core=Changed(config))) as core:
        with pytest.raises((AssertionError, TimeoutError)):
            [*compared(core, config, (700, 2500), rng)]


@pytest.mark.parametrize("name", OF_CHANGES)
def test_mutants_of_changes_are_noticed(name, rng, monkeypatch):
    break_blocks(monkeypatch, *OF_CHANGES[name])
    given = BatchSettings.from_config(SHORT, roi=CORNER)
    with closing(VerilatedCore(SHORT, core=Changed(SHORT))) as core:
        with pytest.raises((AssertionError, TimeoutError)):
            for waits in (False, True, False):
                compared_with_changes(core, given, rng, waits=waits)
