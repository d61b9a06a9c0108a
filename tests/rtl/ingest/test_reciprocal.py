"""Reciprocal against its model: shift and mantissa, exact latency, results that stay."""

import numpy as np
import pytest

from cmfpga.config import Config
from cmfpga.reference.integer.event_path import reciprocal
from cmfpga.rtl.ingest.reciprocal import Reciprocal
from support.bench import play
from support.configs import CONFIGS

SHAPES = {
    "default": CONFIGS["default"],
    "short": Config(span_bits=4, reciprocal_bits=4),
    "long": Config(time_bits=48, span_bits=32, reciprocal_bits=17),
    "wide divisor": Config(span_bits=20, reciprocal_bits=4),
    "wide result": Config(span_bits=5, reciprocal_bits=17),
}


def block_of(config):
    return Reciprocal(span_bits=config.span_bits, reciprocal_bits=config.reciprocal_bits)


def check(config, spans, idle=0):
    """Divide by one span after the other; while a division runs, its input may change."""
    block = block_of(config)
    rng = np.random.default_rng(0)
    script, starts = [], []
    for span in spans:
        starts.append(len(script))
        script.append({"start": 1, "span": span})
        script += [{"span": int(rng.integers(1 << config.span_bits))} for _ in range(block.latency - 1 + idle)]
    script += [{}] * 3
    recording = play(block, script, flows=(), watch=("done", "shift", "mantissa")).watch
    assert [cycle for cycle, done in enumerate(recording["done"]) if done] == [s + block.latency for s in starts]
    ends = [*(start for start in starts[1:]), len(script) - 1]
    for span, start, end in zip(spans, starts, ends, strict=True):
        # From `done` until the next start, inclusive.
        for cycle in range(start + block.latency, end + 1):
            got = recording["shift"][cycle], recording["mantissa"][cycle]
            assert got == reciprocal(config, span), f"1/{span}, cycle {cycle - start}"


@pytest.mark.parametrize("name", SHAPES)
def test_matches_model(name, rng):
    config = SHAPES[name]
    powers = {1 << bit for bit in range(0, config.span_bits, 3)}
    spans = sorted(powers | {max(1, power - 1) for power in powers} | {power + 1 for power in powers})
    spans += [(1 << config.span_bits) - 1, *rng.integers(1, 1 << config.span_bits, 10).tolist()]
    check(config, spans)
    check(config, spans[:4], idle=4)


def test_every_short_span():
    check(SHAPES["short"], list(range(1, 16)))


def test_zero_takes_the_same_time():
    """1/0 means nothing, but must not hang, nor spoil the next division."""
    config = SHAPES["short"]
    block = block_of(config)
    cycle = [{}] * (block.latency - 1)
    script = [{"start": 1, "span": 0}, *cycle, {"start": 1, "span": 11}, *cycle, {}]
    recording = play(block, script, flows=(), watch=("done", "shift", "mantissa")).watch
    assert [n for n, done in enumerate(recording["done"]) if done] == [block.latency, 2 * block.latency]
    assert (recording["shift"][-1], recording["mantissa"][-1]) == reciprocal(config, 11)
