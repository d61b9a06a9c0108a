"""Mutants of the core whose windows slide: what :mod:`test_core` compares notices each of them."""

from contextlib import closing

import pytest

from cmfpga.rtl.image import tagged_accumulator
from cmfpga.rtl.sliding import hop_control, hop_evaluation
from cmfpga.rtl.top import VerilogSliding
from cmfpga.verilog.simulation import VerilatedCore
from support.mutation import break_blocks

from .test_core import CASES, compared

SHORT = CASES["both"].replace(buffer_events=127, window_us=2500)
FULL = SHORT.replace(window_us=4000)


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
    "the judging round is read at once": (hop_evaluation, "held & ~self.cold", "held & self.cold"),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_mutants_are_noticed(name, rng, monkeypatch):
    break_blocks(monkeypatch, *MUTANTS[name])
    config = FULL if name == "the ring overflows" else SHORT
    with closing(VerilatedCore(config, core=Changed(config))) as core:
        with pytest.raises((AssertionError, TimeoutError)):
            [*compared(core, config, (700, 2500), rng)]
