"""Blocks broken on purpose, one at a time: batches through the core notice each (see also ``tests/verilog``)."""

import pytest

from cmfpga.rtl import iterating, iteration_control
from cmfpga.rtl.ascent import sign
from cmfpga.rtl.confidence import probe, verdict
from cmfpga.rtl.core import Core
from cmfpga.rtl.image import basis, flow, gradient_reader, moments, one_pass_gradient, voter, warp
from cmfpga.rtl.ingest import binning, event_buffer, ingest_control
from support.bench import Repeated
from support.core_batches import CONFIGS, random_batch, run, spread
from support.mutation import break_blocks

MUTANTS = {  # module, old, new, configuration
    "a pair does not cancel": (one_pass_gradient, "Mux(valid[a] ^ valid[b], Mux(", "Mux(1, Mux(", "one pass"),
    "sums go on": (one_pass_gradient, "growth + Mux(begin, 0, before)", "growth + before", "one pass"),
    "squares of another step": (one_pass_gradient, "2 * i + w", "2 * i", "fast"),
    "warped by the last probe": (probe, "self.complete & turn.any()", "self.complete & turn[:3].any()", "similarity"),
    "sums of the last probe": (probe, "self.sums.valid & self.iterating", "self.sums.valid", "similarity"),
    "means of three": (verdict, "Mux(turn == 0, 0, total)", "Mux(turn[1] == 0, 0, total)", "four evaluators"),
    "means of the batch before": (verdict, "mean.eq(total >> 2)", "mean.eq(total >> 1)", "one evaluator"),
    "a verdict of any round": (iterating, "self.means.done & control.run.final", "self.means.done",
                               "three bits of v"),
    "a verdict not waited for": (iteration_control, "with m.If(self.judged):", "with m.If(1):", "three bits of v"),
    "a verdict of the batch before": (iterating, "(judged | verdict.done) & ~control.run.take", "judged | verdict.done",
                                      "three bits of v"),
    "events come too soon": (event_buffer, "goes &= turn == 0", "goes &= turn[0] == 0", "one evaluator"),
    "events come at any time": (event_buffer, "turn.eq(Mux(self.replay, 0, turn + 1))", "turn.eq(turn + 1)",
                                "one evaluator"),
    "half a pixel too far": (basis, "1 << motion.place_frac) >> 1 if", "1 << motion.place_frac) >> 2 if", "rotation"),
    "the ROI's corner forgotten": (basis, "self.corner[axis] << motion.place_frac", "0", "rotation"),
    "a centre beside the ROI's": (basis, "2 * (size - 1)", "2 * size", "similarity"),
    "not bent": (basis, "product_s3 * self.curve", "product_s3 * 0", "rotation"),
    "xy by xx": (basis, '("xy", "p", "q")', '("xy", "p", "p")', "rotation"),
    "turned the wrong way": (flow, "if sign > 0 else total - product", "if 1 else 0", "similarity"),
    "flow floored": (flow, "round_half_up(total, motion.frac)", "total >> motion.frac", "rotation"),
    "the flow's event": (warp, '{name: delay(m, event[name], flow.latency, name=f"{name}_flow")',
                         '{name: delay(m, event[name], 1, name=f"{name}_flow")', "similarity"),
    "another event's basis": (one_pass_gradient, "self._stages - 1\n", "self._stages - 2\n", "rotation"),
    "the near pixels": (one_pass_gradient, "Mux(odd_s3, growth[0], growth[1])", "Mux(odd_s3, growth[1], growth[0])",
                        "similarity"),
    "the near products": (one_pass_gradient, "Mux(odd_s1, *products_s1)", "Mux(~odd_s1, *products_s1)", "similarity"),
    "the near derivative": (one_pass_gradient, "Mux(odd_s1, d_s1, -d_s1)", "d_s1", "similarity"),
    "pixels of the finest level": (moments, "each + motion.place_frac", "motion.place_frac", "similarity"),
    "the corner of coarse pixels": (voter, "((1 << (level + unit)) // 2 -", "((1 << unit) // 2 -", "similarity"),
    "moments go on": (moments, "Mux(begin_s1, 0, register)", "register", "rotation"),
    "the wrong moment": (moments, "s + part if sign > 0 else s - part", "s + part", "rotation"),
    "zoom without a limit": (sign, "Mux(chosen[-1], Mux(negative_s1", "Mux(0, Mux(negative_s1", "similarity"),
    "steps as long for lesser slopes": (sign, 'ways(step >> 1, "_halved")', 'ways(step, "_halved")', "similarity"),
    "lesser than the next slope": (sign, "others.any()", "others[-1]", "similarity"),
    "lesser by any size": (sign, "double - sizes[other]", "sizes[name] - sizes[other]", "rotation"),
    "the steepest steps by half": (sign, "- sizes[other])[-1]", "- sizes[other])[-1] | 1", "similarity"),
    "probed away from 0": (probe, "Mux(v[-1], distance, -distance)", "Mux(v[-1], -distance, distance)", "similarity"),
    "one parameter probed": (probe, "Mux(turn[k],", "Mux(turn[0],", "rotation"),
    "fallen from the last probe": (probe, 'self.last[f"s{name}"]', 'self.last[f"sx"]', "rotation"),
    "any doubt is none": (probe, "difference <= 0", "difference < difference", "similarity"),
    "a row too few": (gradient_reader, "(row == config.geometry.bank_rows - 1)",
                      "(row == config.geometry.bank_rows - 2)", "small"),
    "y by x": (gradient_reader, 'pixel[f"d{name}"]', 'pixel["dx"]', "small"),
    "products go on": (gradient_reader, "delay(m, first, self.lead,", "delay(m, first & 0, self.lead,", "small"),
    "binned by half": (binning, ">> self.config.binning if", ">> self.config.binning - 1 if", "binned"),
    "rows not binned": (binning, 'in ("x", "y")', 'in ("x",)', "binned rotation"),
    "division not waited for": (iteration_control, "eq(self.divided | next", "eq(self.divide | next", "small"),
    "one too many": (iteration_control, "following.eq(self.iterations + 1)", "following.eq(self.iterations)", "small"),
    "one event too few": (iteration_control, "< batch.settings.min_roi", "<= batch.settings.min_roi", "small"),
    "result not waited for": (iteration_control, "with m.If(self.taken):", "with m.If(1):", "small"),
    "last events not waited for": (ingest_control, "timer.eq(self._drain - 1)", "timer.eq(0)", "small"),
    "every long batch is cut": (ingest_control, "full & ~limit & ~self.i.payload.last", "full", "small"),
    "settings of any time": (ingest_control, '"settings": current,', '"settings": self.settings,', "small"),
    "ROI not waited for": (ingest_control, "handover.free & handover.settled", "handover.free", "two"),
    "iterations not waited for": (ingest_control, "(timer == 0) & handover.free &", "(timer == 0) &", "two"),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_a_broken_block_is_noticed(name, monkeypatch, rng):
    original, old, new, which = MUTANTS[name]
    break_blocks(monkeypatch, original, old, new)
    config = CONFIGS[which]
    follow = {"cold_after_doubtful": 0} if config.confidence else {}
    follow |= {"iterations": 2, "min_roi_events": 5, "eta": config.formats.eta.raw(8.0)}
    batches = [spread(config, rng, 30, **follow)]
    batches += [spread(config, rng, count, roi=None, **follow) for count in (5, 90, 20)]
    batches += [random_batch(config, rng) for _ in range(4)]
    with pytest.raises(AssertionError):
        run(config, batches, rng, stall=0.5, core=Repeated(Core(config)))
