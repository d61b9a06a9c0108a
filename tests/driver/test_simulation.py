"""The driver on the emitted AXI top in Verilator: batches and streams equal the integer model."""

import dataclasses

import numpy as np
import pytest
from studies.crosscheck import shell as crosscheck

from cmfpga.config import Config, preset
from cmfpga.driver import Accelerator, DeviceError, DeviceTimeout, WireResult
from cmfpga.driver.simulation import SimulationBackend
from cmfpga.engines.model import ModelEngine
from cmfpga.errors import ConfigError
from cmfpga.events import BatchCutter, Events, MemoryRecording, open_recording
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.registers import formats_of
from cmfpga.protocol.results import COUNTS, counts_of
from cmfpga.protocol.settings import BatchSettings
from cmfpga.protocol.words import encode, read_raw, swap_halves
from cmfpga.reference.wire import BatchEnds, to_beats
from cmfpga.tracking.loop import track
from support.axi.expected import Expected
from support.designs import SHELL_SIZES as SMALL
from support.driving import CONFIG, batch, differences, model_run, streamed


@pytest.mark.parametrize("form", formats_of(CONFIG))
def test_batches_equal_the_model(backend, rng, form):
    equal_batches(Accelerator(backend, form=form), rng)


@pytest.mark.parametrize("change", [{}, {"undistortion": "on", "binning": 1}], ids=str)
def test_filters_of_noise(compiler, rng, change):
    """Masks are written through registers; what both filters drop is in the results and in the counters."""
    config = CONFIG.replace(hot_pixels=1, background=1, background_cell=3, **change)
    model, sums = ModelEngine(config), dict.fromkeys(("hot", "noise", "events_taken"), 0)
    masks = [(), ((3, 4), (47, 31)), ((3, 4), (20, 7), (33, 30)), (), ((20, 7),)]
    with Accelerator(SimulationBackend(config)) as accelerator:
        for number, mask in enumerate(masks * 2):
            events = batch(rng, 400, begin=1000 * number, config=config)
            for k, (x, y) in enumerate(((3, 4), (20, 7), (47, 31))):
                events.x[k::40], events.y[k::40] = x, y
            settings = BatchSettings.from_config(config, None if number else (2, 0))
            settings = dataclasses.replace(settings, hot_mask=mask, background_us=(0, 40, 200)[number % 3])
            result = accelerator.run(events, settings=settings)
            assert differences(result, model.run(events, settings)[0]) == []
            assert result.events == sum(getattr(result, name) for name in counts_of(config))
            assert (result.hot > 0) == bool(mask) and (result.noise > 0) == bool(number % 3)
            for name, count in (("hot", result.hot), ("noise", result.noise), ("events_taken", result.events)):
                sums[name] += count
        counters = accelerator.counters()
        assert {name: counters[name] for name in sums} == sums and sums["noise"] > sums["hot"] > 50
        accelerator.reset()
        assert accelerator.counters()["hot"] == accelerator.counters()["noise"] == 0


@pytest.mark.parametrize("change", [{}, {"undistortion": "on"}])
def test_batches_as_evt30(compiler, rng, change):
    """Each at its own time, earlier ones too; where the hardware undistorts, all events go through."""
    config = CONFIG.replace(evt3=1, **change)
    with Accelerator(SimulationBackend(config), form="EVT30") as accelerator:
        equal_batches(accelerator, rng, config)
        row, column = np.divmod(np.arange(40 * 48), 48)
        for start in (3 << 30, 1 << 25, 7):
            events, roi = Events(start + row, column, row % 32, row % 2), (16, 8)
            before = accelerator.counters()["beats_in"]
            result = accelerator.run(events, roi=roi)
            assert differences(result, model_run(ModelEngine(config), events, roi, config)) == []
            assert accelerator.counters()["beats_in"] - before < len(events) / 4


@pytest.mark.parametrize("ends", [{"roi_events": 30}, {"events": 4608}], ids=str)
def test_evt30_leaves_the_roi_out_at_once(compiler, ends):
    """Rows of vectors of which a third is in the ROI's columns: an event a cycle there, a word elsewhere."""
    config = CONFIG.replace(evt3=1)
    row, column = np.divmod(np.arange(3 * 32 * 48), 48)
    events, model, first = Events(100 + row, column, row % 32, row % 2), ModelEngine(config), 0
    words = encode(events, "EVT30")
    with Accelerator(SimulationBackend(config)) as accelerator:
        accelerator.start(roi=(16, 8), form="EVT30", **ends)
        accelerator.send(words)
        accelerator.backend.wait_sent(10)
        cycles = accelerator.backend.top.cycles
        for number, result in enumerate(results := accelerator.stop()):
            part = events[first : first + result.events]
            assert differences(result, model_run(model, part, None if number else (16, 8), config)) == []
            assert result.roi_events == 30 or "events" in ends or result is results[-1]
            first += result.events
    assert len(results) > 10 or cycles < 4 * len(words) + 3 * 256 + 500 < len(events) / 2


@pytest.mark.parametrize("seed", range(2))
def test_random_streams_of_evt30(compiler, monkeypatch, seed):
    """Ends, stalls, settings and words that no camera sends, as in the crosscheck; all counters."""
    monkeypatch.setattr(crosscheck, "formats_of", lambda config: ["EVT30"])
    batches, _ = crosscheck.through_the_shell(CONFIG.replace(evt3=1), np.random.default_rng(seed))
    assert batches > 100


def equal_batches(accelerator, rng, config=CONFIG):
    model = ModelEngine(config)
    for number in range(6):
        events = batch(rng, int(rng.integers(2, 300)), begin=1000 * number)
        roi = (8 + number, 4) if number in (0, 3) else None
        result = accelerator.run(events, roi=roi)
        assert isinstance(result, WireResult)
        assert differences(result, model_run(model, events, roi, config)) == []
        assert result.batch == number + 1 and not result.wire and not result.config_range
        assert result.t_first == events.t[0] and result.t_ref == events.t[0] + (events.t[-1] - events.t[0]) // 2
        assert accelerator.engine.places == [result.roi_next]


def test_batches_of_the_article_equal_the_model(compiler, rng):
    """The constant step has other registers: no table, but T and η."""
    config = Config(**SMALL, iterations=12)
    model = ModelEngine(config)
    with Accelerator(SimulationBackend(config)) as accelerator:
        for number, change in enumerate(({}, {"iterations": 3}, {"eta": 7.25}, {"start": "zero"}, {})):
            settings = BatchSettings.from_config(config.replace(**change), None if number else (8, 4))
            events = batch(rng, 150, begin=1000 * number)
            result = accelerator.run(events, settings=settings)
            assert differences(result, model.run(events, settings)[0]) == []
            assert result.iterations == change.get("iterations", 12)
        # What comes into a full buffer is dropped.
        events = batch(rng, 700, begin=9000)
        result = accelerator.run(events)
        assert differences(result, model_run(model, events, config=config)) == []
        assert accelerator.counters()["overflow"] == result.overflow > 0
        assert accelerator.self_test()["golden batch"].endswith("as the integer model")


def test_every_setting_reaches_the_hardware(accelerator, rng):
    """Settings one after the other, without a reset: what is not written again must be as it was."""
    model = ModelEngine(CONFIG)
    changes = (
        {}, {"min_roi_events": 60}, {"thinning": 3}, {"thin_target": 8}, {"roi_gain": 1.0},
        {"start": "given", "v_start_x": -1.5, "v_start_y": 2.0}, {"start": "zero"},
        {"cold": "1:1:1*3", "warm": "0:3/4:1/4"}, {"start": "given", "v_start_x": 0.5, "cold": "0:1:1 1:2:2"}, {},
    )  # fmt: skip
    seen = Flag(0)
    for number, change in enumerate(changes):
        settings = BatchSettings.from_config(CONFIG.replace(**change), (8, 4) if number == 0 else None)
        events = batch(rng, 180, begin=1000 * number)
        result = accelerator.run(events, settings=settings)
        assert differences(result, model.run(events, settings)[0]) == []
        seen |= result.flags
    assert Flag.THINNED | Flag.DEGENERATE in seen


def test_flags_and_counters_account_for_every_event(accelerator, rng):
    model = ModelEngine(CONFIG)
    sizes = (2, 700, 90)
    totals = dict.fromkeys(COUNTS, 0)
    for number, size in enumerate(sizes):
        events = batch(rng, size, begin=1000 * number)
        if number == 2:
            events.t[40:45] -= 900  # time steps back
        result = accelerator.run(events, roi=(8, 4))
        assert differences(result, model_run(model, events, (8, 4))) == []
        for name in totals:
            totals[name] += getattr(result, name)
    assert totals["thinned"] and totals["time_back"] and not totals["overflow"]  # a full buffer thins out what it holds
    count = accelerator.counters()
    assert count["events_in"] == count["events_taken"] == sum(sizes) == sum(totals.values())
    assert count["batches"] == len(sizes) and {name: count[name] for name in totals} == totals
    accelerator.clear_counters()
    assert accelerator.counters()["events_in"] == 0


def test_a_batch_without_events(accelerator, rng):
    """It never reaches the hardware, and its ROI waits for the next one."""
    model = ModelEngine(CONFIG)
    for number, (size, roi) in enumerate(((50, (4, 4)), (0, (10, 6)), (50, None))):
        events = batch(rng, size, begin=1000 * number)
        result = accelerator.run(events, roi=roi)
        assert differences(result, model_run(model, events, roi)) == []
        assert result.batch == (1, 0, 2)[number]
    assert accelerator.counters()["batches"] == 2


def test_chosen_lengths_fit_one_transfer(backend, rng):
    """Random events are never trusted, and too few of them in the ROI for the survey: batches as long as can be."""
    backend.max_words = 600
    recording = MemoryRecording(batch(rng, 1000), CONFIG.sensor_width, CONFIG.sensor_height, "made up")
    tracked = list(Accelerator(backend).track(recording, roi=(8, 4), batches=3))
    assert [len(one.events) for one in tracked] == [300] * 3


def test_settings_out_of_range_and_words_that_were_dropped(accelerator, rng):
    """Flags of the result, and only of the one that they belong to."""
    good = BatchSettings.from_config(CONFIG, (8, 4))
    for settings, limited in ((good, False), (dataclasses.replace(good, thinning=0), True), (good, False)):
        assert accelerator.run(batch(rng, 100), settings=settings).config_range == limited
    accelerator.start(events=50)
    outside = Events([0] * 20, [60] * 20, [3] * 20, [0] * 20)
    accelerator.send(np.concatenate([encode(part, "PACKED") for part in (batch(rng, 40), outside, batch(rng, 60))]))
    accelerator.backend.wait_sent(5)
    assert [result.wire for result in accelerator.results(2)] == [True, False]
    accelerator.stop()
    count = accelerator.counters()
    assert count["out_of_sensor"] == 20 and count["events_in"] == count["out_of_sensor"] + count["events_taken"]


def test_bad_events_are_refused_before_they_are_sent(accelerator):
    good = Events([1, 2], [3, 4], [5, 6], [0, 1])
    for events, roi, message in (
        (Events([1], [48], [0], [0]), None, "x of an event is 48"),
        (Events([1], [0], [32], [0]), None, "y of an event is 32"),
        (good, (40, 0), "ROI at 40,0"),
        (Events(*np.zeros((4, CONFIG.max_batch_events + 1), int)), None, "a batch of 262144 events: at most 262143"),
    ):
        with pytest.raises(ConfigError, match=message):
            accelerator.run(events, roi=roi)
    assert accelerator.counters()["beats_in"] == 0


def test_stream_of_batches(accelerator, rng):
    model = ModelEngine(CONFIG)
    events = batch(rng, 1000)
    with pytest.raises(ValueError, match="what ends a batch"):
        accelerator.start(roi=(8, 4))
    accelerator.start(roi=(8, 4), events=130, form="EVT21")
    accelerator.send(encode(events, "EVT21"))
    results = list(accelerator.results(7))
    with pytest.raises(DeviceError, match=r"stop\(\) first"):
        accelerator.run(events)
    assert accelerator.status()["taking_in"]
    results += accelerator.stop()  # the last one has what is left
    assert [result.events for result in results] == [130] * 7 + [90]
    streamed(model, results, events)
    again = batch(rng, 200)  # more than what ended the batches of the stream
    assert differences(accelerator.run(again), model_run(model, again)) == []  # v and the ROI stayed


def test_stream_by_time_with_halves_exchanged(accelerator, top, rng):
    model = ModelEngine(CONFIG)
    events = batch(rng, 400)
    accelerator.start(roi=(8, 4), duration_us=250, form="EVT20", swap=True)
    accelerator.send(encode(events, "EVT20", swap=True))
    accelerator.backend.wait_sent(5)
    top.run(2000)
    results = accelerator.stop()
    assert streamed(model, results, events) == 400 and len(results) >= 4
    assert all(result.span < 250 for result in results)
    again = batch(rng, 200, begin=2000)  # of 1000 µs: more than what ended the batches of the stream
    assert differences(accelerator.run(again), model_run(model, again)) == []


def test_stop_without_events_and_with_too_many(accelerator, top, rng):
    accelerator.start(events=100)
    assert accelerator.stop() == []
    accelerator.start(by_tlast=True)
    top.limit(send=60)
    accelerator.send(encode(batch(rng, 100), "PACKED"))  # the rest never comes
    top.run(2000)
    results = accelerator.stop()
    assert [result.events for result in results] == [60]
    top.limit()
    events = batch(rng, 80)
    assert differences(accelerator.run(events, roi=(8, 4)), model_run(ModelEngine(CONFIG), events, (8, 4))) == []


def test_result_that_does_not_come(accelerator):
    accelerator.start(events=100)
    with pytest.raises(DeviceTimeout, match=r"no packet within 0\.05 s"):
        next(accelerator.results(1, timeout=0.05))


def test_real_recording_with_preset_fast(compiler, data_dir):
    """Every batch bit for bit, and the self-test, of the hardware that the presets ship."""
    config = preset("fast")
    with (
        Accelerator(SimulationBackend(config), form="EVT21") as accelerator,
        open_recording(data_dir / "davis240c_shapes_rotation_2.1s_gtflow.h5") as recording,
    ):
        assert accelerator.self_test()["golden batch"].startswith("1200 events")
        cutter = BatchCutter(recording, events=2000, max_events=config.max_batch_events)
        wanted = track(ModelEngine(config), cutter, roi=(90, 60), batches=8)
        for tracked in accelerator.track(recording, roi=(90, 60), events=2000, batches=8):
            assert differences(tracked.result, next(wanted).result) == []
        assert tracked.index == 7
        count = accelerator.counters()
        assert count["events_in"] == count["events_taken"] == 16_000
        assert count["events_taken"] == count["roi_events"] + count["outside"] + count["overflow"]


def test_a_file_of_evt30(compiler, data_dir):
    """The words of the file, untouched, give what its events do; nothing is counted twice or lost."""
    path, size = data_dir / "original_formats" / "prophesee_driving_1280x720_evt3.raw", 20_000
    config = preset("fast").replace(sensor_width=1280, sensor_height=720, evt3=1)
    form, words = read_raw(path)
    model = ModelEngine(config)
    with Accelerator(SimulationBackend(config)) as accelerator, open_recording(path) as recording:
        accelerator.start(roi=(1040, 290), events=size, form=form)
        accelerator.send(words)
        for number, events in enumerate(recording.chunks(size=size)):
            if len(events) < size:
                accelerator.backend.wait_sent(10)
                accelerator.backend.top.run(1000)
                counts = accelerator.counters()
            (result,) = accelerator.results(1) if len(events) == size else accelerator.stop()
            roi = None if number else (1040, 290)
            assert differences(result, model_run(model, events, roi, config)) == []
            assert result.t_first == events.t[0] and result.roi_events > 100
        assert number == 10 and counts["events_in"] == counts["events_taken"] + 1 == recording.extent()[0] == 219_596
        assert counts["other_words"] == 1 and not counts["format_errors"] + counts["time_high_back"]


#: File, its events, how they are sent, ROI of the first batch, how many batches at least.
STREAMS = {
    "EVT21 by number": ("davis240c_shapes_rotation_0.0s.h5", (60_000, 15_000), ("EVT21", True), (100, 30), 10),
    "PACKED by duration": ("davis240c_slider_depth_0.0s.h5", (0, 9_000), ("PACKED", False), (90, 60), 2),
    # The words of a file of EVT 2.0, untouched: with its own time words and what else is in it.
    "a file's words": ("original_formats/prophesee_spinner_640x480_evt2.raw", None, (None, False), (216, 84), 2),
}


@pytest.mark.parametrize("name", STREAMS)
def test_real_streams(compiler, data_dir, name):
    """Batches that the hardware cuts out of a stream, back to back; on a sensor that is large enough for all files."""
    file, part, (form, swap), roi, least = STREAMS[name]
    config = preset("fast").replace(sensor_width=640, sensor_height=480)
    if part:
        with open_recording(data_dir / file) as recording:
            words = encode(next(recording.chunks(*part)), form)
    else:
        form, words = read_raw(data_dir / file)
        words = words[:6200]
    ends = {"duration_us": 10_000} if "duration" in name else {"events": 1500 if part else 4000}
    wanted = BatchEnds(events=ends.get("events", 0), duration=ends.get("duration_us", 0), by_tlast=False)
    batches, _ = Expected(config).receive(to_beats(words, last=False), form, wanted)
    assert len(batches) >= least and (part or sum(len(t) for t, *_ in batches) == 12_000)
    model, found = ModelEngine(config), set()
    with Accelerator(SimulationBackend(config)) as accelerator:
        accelerator.start(roi=roi, form=form, swap=swap, **ends)
        accelerator.send(swap_halves(words) if swap else words)
        for number, (result, (t, x, y, _)) in enumerate(zip(accelerator.results(len(batches)), batches, strict=True)):
            expected = model_run(model, Events(t, x, y, np.zeros(len(t))), None if number else roi, config)
            assert differences(result, expected) == []
            found.add(result.v if result.iterations else None)
    assert len(found - {None}) > min(3, least - 1)
