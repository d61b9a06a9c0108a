"""The simulated core by itself: what it counts, shows and refuses."""

import numpy as np
import pytest

from cmfpga.protocol.flags import Flag
from cmfpga.protocol.settings import settings_values
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.verilog.simulation import VerilatedCore
from support.small_core import CONFIG, make_events, settings
from support.votes import bank_pixels


def played(core, events, **options):
    """A batch's ports, with what the test bench measured, its trace and its pixels."""
    values = settings_values(CONFIG, settings((8, 8)))
    (row,), (trace,), pixels = core.play([(events.t, events.x, events.y)], [values], **options)
    return row | {"measured_cycles": row.pop("valid") - row.pop("offered")}, trace, pixels


def test_the_test_bench_counts_the_same_cycles(verilated_core, rng):
    events = make_events(rng, 40)
    waited, _, _ = played(verilated_core, events)
    # After a reset, before events are accepted: a cycle, the sweep of 16 words, and until its sums have settled.
    assert waited["measured_cycles"] == waited["cycles"] + 1 + 16 + 8
    plain, _, none = played(verilated_core, events)
    assert plain["cycles"] == plain["measured_cycles"] and plain["accepted"] == 40 and none is None
    gaps = rng.integers(0, 4, 40)
    slow, _, _ = played(verilated_core, events, gaps=gaps, stalls=[5])
    assert slow["measured_cycles"] == plain["measured_cycles"] + gaps[1:].sum()


def test_the_pixels_of_every_sweep(verilated_core, rng):
    events, model = make_events(rng, 40), IntegerCore(CONFIG)
    _, trace, pixels = played(verilated_core, events, keep_pixels=True)
    model.run(events.t, events.x, events.y, settings((8, 8)), keep=True)
    wanted = [bank_pixels(CONFIG, done.images) for done in model.iterations]
    assert pixels.reshape(3, 16, 4, 3).tolist() == [[[[*one.values()] for one in row] for row in w] for w in wanted]
    np.testing.assert_array_equal(pixels[:, :, 0::3].sum(axis=(1, 2)), trace[:, 2])


def test_giving_up_says_what_is_missing(verilated_core, rng):
    events = make_events(rng, 40)
    for options, message in (
        ({"max_cycles": 20}, r"after 20 clock cycles: \d+ of 40 events"),
        ({"open_end": True}, r"after \d+ clock cycles: 40 of 40 events"),
    ):
        verilated_core.reset()
        with pytest.raises(TimeoutError, match=rf"^0 of 1 results {message} accepted, 0 of 3 iterations seen$"):
            played(verilated_core, events, **options)
    verilated_core.reset()
    assert played(verilated_core, events)[0]["accepted"] == 40


def test_a_reset_forgets_v_and_the_roi(verilated_core, verilated_engine, rng):
    before = verilated_engine.run(make_events(rng, 60), settings((8, 8)))[0]
    assert before.v != (0.0, 0.0)
    verilated_core.reset()
    after = verilated_engine.run(make_events(rng, 60), settings(min_roi_events=32))[0]
    assert Flag.DEGENERATE in after.flags and after.v == (0.0, 0.0) and after.roi == (0, 0)


def test_a_closed_core_is_not_used(compiler, rng):
    core, events = VerilatedCore(CONFIG), make_events(rng, 5)
    axes, values = (events.t, events.x, events.y), settings_values(CONFIG, settings((8, 8)))
    core.close()
    core.close()  # safe
    uses = (core.reset,), (core.take_waves,), (core.play, [axes], [values]), (core.write_schedule, ((0, 1, 1),))
    for use, *arguments in uses:
        with pytest.raises(ValueError, match=r"^the simulated core is closed$"):
            use(*arguments)


def test_random_contents_of_memories_do_not_matter(compiler, verilated_core, rng):
    events = make_events(rng, 60)
    other = VerilatedCore(CONFIG, seed=99)
    (a, trace_a, _), (b, trace_b, _) = played(verilated_core, events), played(other, events)
    assert a == b
    np.testing.assert_array_equal(trace_a, trace_b)
    other.close()


def test_the_verilog_is_emitted_once_a_process(compiler, verilated_core, monkeypatch):
    monkeypatch.setattr("cmfpga.verilog.compile.emit_verilog", None)
    again = VerilatedCore(CONFIG.replace(iterations=2))
    assert again.core is verilated_core.core and again.config.iterations == 2
    again.close()
