"""The emitted Verilog, in Verilator, against the integer model: every sum of every iteration, every cycle."""

from dataclasses import replace

import numpy as np
import pytest
from studies.crosscheck.batches import PATTERNS, random_events, random_settings
from studies.crosscheck.compare import compare_stream

from cmfpga.config import Config, preset
from cmfpga.config.schedule import Round, ScheduleEntry, used_events
from cmfpga.engines import make_engine
from cmfpga.events import BatchCutter, open_recording
from cmfpga.protocol.flags import OF_CONFIDENCE, Flag
from cmfpga.protocol.results import COUNTS
from cmfpga.protocol.settings import BatchSettings, schedule_table, settings_values
from cmfpga.protocol.trace import to_batch_result
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.verilog.simulation import VerilatedCore
from support import verilog_tools

MOST = Config().max_batch_events
CONFIGS = {
    **{name: config.replace(max_batch_events=MOST) for name, config in verilog_tools.CONFIGS.items()},
    "whole sensor": Config(sensor_width=64, sensor_height=48, roi_width=64, roi_height=48, buffer_events=512),
    "fast": preset("fast"),
    # So few tags that they come back in every batch, and a long table.
    "fast, odd sizes": preset("fast").replace(
        roi_width=31, roi_height=21, buffer_events=200, tag_bits=5, schedule_entries=256, buffers=1
    ),
    "fast, one pixel wide bank": preset("fast").replace(
        sensor_width=8, sensor_height=6, roi_width=2, roi_height=3, buffer_events=16, tag_bits=2
    ),
    "fast, by sweep": preset("fast").replace(
        gradient="sweep", ascent="constant", roi_width=32, roi_height=24, buffer_events=200
    ),
    # The sequence of the dither begins anew without a schedule.
    "dither, constant": verilog_tools.CONFIGS["narrow formats"].replace(
        gradient="one_pass", dither_frac=3, roi_width=14, roi_height=18, buffer_events=100, max_batch_events=MOST
    ),
    "quad": preset("quad"),
    "similarity": preset("similarity").replace(buffer_events=500),
    "rotation": preset("rotation").replace(
        roi_width=90, roi_height=50, buffer_events=500, ram_style="auto", camera="200,200,120,90"
    ),
    # Banks that are so deep that a word lies in several memories.
    "paper, in one pass": Config(gradient="one_pass", roi_width=120, roi_height=70, buffer_events=300),
}
BATCHES = {"default": 300, "fast": 300}  # 60 for the others


@pytest.fixture(scope="module", params=CONFIGS)
def pair(request):
    config = CONFIGS[request.param]
    core = VerilatedCore(config, seed=7)
    yield core, IntegerCore(config), BATCHES.get(request.param, 60)
    core.close()


def run_both(core, model, events, settings, **played):
    """The RTL's result of a batch, which is the model's in everything but the cycles, which only the RTL has."""
    (rtl,) = core.results([events], settings, **played)
    assert replace(rtl, cycles=None) == model.run(*events, settings)
    assert sum(getattr(rtl, name) for name in COUNTS) == rtl.events == len(events[0])
    return rtl


def test_adversarial_batches_back_to_back(pair, rng):
    core, model, batches = pair
    config = core.config
    names = list(PATTERNS)
    seen, roi, iterations = set(), (0, 0), 0
    for number in range(batches):
        name = names[number % len(names)]
        settings, roi = random_settings(config, rng, roi)
        events = random_events(config, rng, roi, name)[1]
        gaps = rng.integers(0, 4, len(events)) * (rng.random(len(events)) < 0.3) if number % 3 == 0 else None
        batch = events.t, events.x, events.y
        rtl = run_both(core, model, batch, settings, gaps=gaps, stalls=[number % 5])
        # The first batch is offered while the banks are swept after the reset, and has to wait.
        waited = core.finished[-1] - core.offered[-1] - rtl.cycles
        assert 0 <= waited <= config.geometry.bank_depth + 9 if number == 0 else waited == 0
        if gaps is None and rtl.iterations and rtl.events >= core.core.shortest_batch:
            counts, judged = {"events": rtl.events, "roi_events": rtl.roi_events}, bool(rtl.confidence_limit)
            assert rtl.cycles == core.core.cycles(**counts, iterations=model.plan, judge=judged)
        roi = rtl.roi_next
        seen |= {flag for flag in rtl.flags}
        iterations += rtl.iterations
    if batches >= 300:  # the test is only worth its name if all of this happened
        assert iterations > 1000
        never = {Flag.OVERFLOW} if config.when_full == "thin" else set() if config.confidence else {*OF_CONFIDENCE}
        assert seen >= set(Flag) - {Flag.CUT, Flag.SCHEDULE} - never and not never & seen


def test_reset_in_the_middle_of_a_batch(pair, rng):
    core, config = pair[0], pair[0].config
    x, y = PATTERNS["random_inside"](config, rng, (0, 0))
    events = np.arange(len(x)) * 5 + 10, x, y
    settings = replace(BatchSettings.from_config(config, (0, 0)), iterations=5)
    for stop_after in (1, len(x), len(x) + 90, len(x) + 150):
        core.write_schedule(schedule_table(config, settings))
        with pytest.raises(TimeoutError):
            core.play([events], [settings_values(config, settings)], max_cycles=stop_after)
        core.reset()
        run_both(core, IntegerCore(config), events, settings)


def test_batches_back_to_back_without_a_pause(pair, rng):
    """The next batch is offered while the one before is optimised; gaps and stalls change nothing but the time."""
    core, _, batches = pair
    for gaps, stalls in ((0, 0), (0.2, 0), (0, 1), (0.2, 1)):
        core.reset()
        assert compare_stream(core, rng, batches // 4, gaps=gaps, stalls=stalls)[0] == batches // 4


def test_sustained_rate_of_the_article_s_workload(rng):
    """N = 5000, n = 800, warm: the three rounds are hidden behind the ingest of the next 5000 events."""
    config = preset("quad")
    core = VerilatedCore(config)
    settings = replace(BatchSettings.from_config(config, (80, 60)), judge=0)
    core.write_schedule(schedule_table(config, settings))
    inside = rng.permutation(np.arange(5000) < 800)
    x = np.where(inside, 80 + rng.integers(64, size=5000), rng.integers(70, size=5000))
    y = np.where(inside, 60 + rng.integers(64, size=5000), rng.integers(50, size=5000))
    t = np.sort(rng.integers(40_000, size=5000))
    still = settings_values(config, replace(settings, roi=None, roi_gain=0))
    results, _, _ = core.play([(t, x, y)] * 8, [settings_values(config, settings) | {"roi_gain": 0}, *[still] * 7])
    assert [row["roi_events"] for row in results] == [800] * 8
    assert [row["iterations"] for row in results] == [5, *[3] * 7]
    periods = np.diff([row["valid"] for row in results])
    alone = core.core.cycles(events=5000, roi_events=800, iterations=config.schedules.warm, judge=False)
    assert alone - 5000 == 2628 and core.core.iteration_latency == 56
    # A batch opens, is taken in and handed over; meanwhile the one before has been optimised.
    assert set(periods[1:].tolist()) == {1 + 5000 + core.core.drain + 1}
    core.close()


@pytest.mark.parametrize("buffers", [1, 2])
def test_strides_at_their_limits(buffers, rng):
    """One event more or less than a stride needs; a full buffer; one that has thinned out, by little and by much."""
    config = preset("similarity").replace(
        buffer_events=2047,
        buffers=buffers,
        cold="2:1/4*5 1:0/2*3 0:-1 0:-2/4 0:-3/2 0:-3",
        warm="0:-2/2 0:-3/4*4 1:0/4 2:-2",
    )
    core, model = VerilatedCore(config), IntegerCore(config)
    settings = replace(BatchSettings.from_config(config, (0, 0)), roi_gain=0)
    full = config.buffer_events
    for n in (1, 2, 127, 128, 255, 256, 257, 511, 512, 513, 801, full, full + 1, 2 * full, 2 * full + 1, 10 * full):
        events = np.cumsum(rng.integers(0, 40, n)), *rng.integers(64, size=(2, n))
        rtl = run_both(core, model, events, replace(settings, roi=(0, 0) if n % 2 else None))
        if rtl.iterations and n >= core.core.shortest_batch:
            assert rtl.cycles == core.core.cycles(events=n, roi_events=rtl.roi_events, iterations=model.plan)
            strides = [round(rtl.roi_events / count) for count in used_events(model.plan, rtl.roi_events)]
            assert max(strides) == (1 if n < 256 else 2 if n < 512 else 4)
    core.close()


def test_a_schedule_out_of_range_is_limited_and_flagged(rng):
    config = CONFIGS["similarity"]
    core, model = VerilatedCore(config), IntegerCore(config)
    roi = (60, 50)
    x, y = PATTERNS["moving_edge"](config, rng, roi)
    t = np.cumsum(rng.integers(1, 50, len(x)))
    good = BatchSettings.from_config(config, roi)
    largest = config.formats.v.width - 2
    for bad, limited in (
        ((3, 2, 1), (2, 2, 1)), ((1, largest + 1, 0), (1, largest, 0)), ((3, 15, 3), (2, largest, 2)),
        ((1, 1, 3), (1, 1, 2)),
    ):  # fmt: skip
        core.write_schedule([(2, 6, 2), bad, (0, 1, 0)])
        cold = ((2, 6, 2), limited, (0, 1, 0))
        plan = (ScheduleEntry(level, shift - config.formats.v.f, 1 << stride) for level, shift, stride in cold)
        settings = replace(good, cold=tuple(plan))
        (values,), traces, _ = core.play([(t, x, y)], [settings_values(config, settings)])
        expected = model.run(t, x, y, settings)
        assert Flag.SCHEDULE in Flag(values["flags"])
        assert to_batch_result(config, [values], traces).trace == expected.trace
        core.write_schedule(cold)
        (values,), _, _ = core.play([(t, x, y)], [settings_values(config, settings)])
        model.run(t, x, y, settings)
        assert Flag.SCHEDULE not in Flag(values["flags"])
    core.close()


def test_a_schedule_as_long_as_the_table(rng):
    """A driver may write one, whatever ``max_iterations`` says: the count does not wrap."""
    config = Config(
        sensor_width=8, sensor_height=6, roi_width=2, roi_height=2, buffer_events=16, gradient="one_pass",
        ascent="newton", border="whole", cold="0:1:1", warm="0:1:1", max_iterations=2, schedule_entries=9,
    )  # fmt: skip
    core, model = VerilatedCore(config), IntegerCore(config)
    for count in (4, 9, 8):
        settings = replace(BatchSettings.from_config(config, (0, 0)), cold=(Round(0, 4, 0.125),) * count, warm=())
        events = np.arange(12) * 9, *rng.integers(2, size=(2, 12))
        assert run_both(core, model, events, settings).iterations == count
    core.close()


RECORDINGS = {  # file: ROI of the first batch, events of a batch
    "davis240c_shapes_rotation_0.0s.h5": ((100, 30), 5000),
    "davis240c_shapes_rotation_2.1s_gtflow.h5": ((90, 60), 2000),
    "davis240c_shapes_translation_52.0s.h5": ((90, 60), 3000),
    "davis240c_slider_depth_0.0s.h5": ((90, 60), 5000),
    "davis240c_translboxes_imu.h5": ((90, 60), 6000),
    "davis240b_evbench_seq0002.h5": ((92, 66), 5000),
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_whole_recording(data_dir, name):
    roi, size = RECORDINGS[name]
    # 20 iterations: every event of every recording passes through, in a time that CI can spare.
    config = Config(iterations=20)
    rtl, model = make_engine("rtl", config), make_engine("model", config)
    formula = rtl._core.core.cycles
    batches = 0
    with open_recording(data_dir / name) as recording:
        cutter = BatchCutter(recording, events=size, max_events=config.max_batch_events)
        while (batch := cutter.next()) is not None:
            settings = BatchSettings.from_config(config, None if batches else roi)
            a, b = rtl.run(batch, settings)[0], model.run(batch, settings)[0]
            assert replace(a, cycles=None) == b
            assert a.cycles == formula(events=a.events, roi_events=a.roi_events, iterations=a.iterations)
            assert a.events == a.roi_events + a.outside + a.overflow
            batches += 1
        assert batches == recording.num_events // size
    rtl.close()
    assert batches >= 10


def test_every_iteration_of_one_real_batch(data_dir):
    """All 100 iterations of the article's workload, from a start far off, on the densest recording."""
    config = Config(start="given", v_start_x=9.0, v_start_y=-7.0)
    rtl, model = make_engine("rtl", config), make_engine("model", config)
    with open_recording(data_dir / "davis240b_evbench_seq0002.h5") as recording:
        batch = BatchCutter(recording, events=5000, max_events=config.max_batch_events).next()
    settings = BatchSettings.from_config(config, (92, 66))
    a, b = rtl.run(batch, settings)[0], model.run(batch, settings)[0]
    assert a.iterations == 100 and len(np.unique(a.trace.v, axis=0)) > 20
    assert a.trace == b.trace
    rtl.close()
