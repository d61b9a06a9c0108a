"""Windows that slide behind AXI, on the emitted Verilog in Verilator: every hop equals the integer model."""

import dataclasses
import math

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.driver import Accelerator
from cmfpga.driver.simulation import SimulationBackend
from cmfpga.driver.uart import UartBackend
from cmfpga.engines.model import ModelEngine
from cmfpga.errors import ConfigError
from cmfpga.events import Events, open_recording
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.settings import BatchSettings
from cmfpga.protocol.words import encode
from cmfpga.tracking.fit import batch_cutter
from cmfpga.tracking.loop import track
from support.driving import differences
from support.hops import CORNER, SMALL, drawn
from support.serial_line import SimulatedLine

CONFIG = preset("sliding").replace(**SMALL | {"hop_events": 9, "window_us": 4000, "hop_us": 300})
OTHER = {"window_events": 60, "hop_events": 20, "hop_us": 900, "follow": "", "thinning": 2}
FATES = ("roi_events", "outside", "thinned", "time_back")


@pytest.fixture
def accelerator(compiler):
    with Accelerator(SimulationBackend(CONFIG)) as made:
        yield made


def settings(roi=CORNER, **changes):
    return BatchSettings.from_config(CONFIG.replace(**changes), roi)


def object_of(rng, count=900):
    t, x, y = drawn(rng, count, wrap=1 << 32)
    return Events(t, x, y, np.zeros(count, int))


def modelled(events, given):
    return ModelEngine(CONFIG).run(events, given)


def alike(found, wanted, least=5):
    for k, (one, other) in enumerate(zip(found, wanted, strict=True)):
        assert differences(one, other) == [], k
    assert len(wanted) > 5 and sum(Flag.DEGENERATE not in one.flags for one in wanted) >= least


def sent_by_chance(accelerator, words, rng):
    """Words in bursts and with pauses, while results are taken a few words at a time; all that came of them."""
    top = accelerator.backend.top
    top.send(words)
    while top.unsent:
        top.limit(send=int(rng.integers(0, 60)), words=int(rng.integers(0, 40)))
        top.run(int(rng.integers(1, 600)))
    top.limit()
    return accelerator.stop()


def test_lengths_change_in_a_run(accelerator, rng):
    """Windows and hops become longer and shorter, and the run goes on; everything equals the model."""
    model, events, given = ModelEngine(CONFIG), object_of(rng, 2000), settings()
    found, wanted = [], []
    for k, part in enumerate(np.array_split(np.arange(2000), 7)):
        changes = {"window_events": (120, 40, 60)[k % 3], "hop_events": (9, 12)[k % 2], "hop_us": (300, 0)[k % 2]}
        given = dataclasses.replace(given, **changes)
        wanted += model.run(events[part], given)
        found += accelerator.run(events[part], settings=given)
        given = dataclasses.replace(given, roi=None)
    alike(found, wanted)
    assert len({one.roi_events for one in wanted}) > 20
    with pytest.raises(ConfigError, match="window_events = 0: 1 to 200 is needed"):
        accelerator.run(events[:9], settings=dataclasses.replace(given, window_events=0, hop_events=0))


def test_runs_equal_the_model(accelerator, rng):
    """Each with its settings, its events in pieces; counters account for every event."""
    results = late = taken = 0
    for change in ({}, OTHER, {"after": "", "hop_us": 0, "roi_gain": 0.0}):
        accelerator.backend.max_words = int(rng.integers(40, 90))
        given, events, found = settings(**change), object_of(rng), []
        wanted = modelled(events, given)
        for part in np.split(np.arange(900), np.sort(rng.integers(0, 900, 3))):
            found += accelerator.run(events[part], settings=given)
            given = dataclasses.replace(given, roi=None, roi_gain=1, follow=())  # mean nothing: the run goes on
        alike(found, wanted)
        assert [one.batch for one in found] == [results + k + 1 for k in range(len(found))]
        assert any(Flag.DEGENERATE in one.flags for one in found)
        results, taken = results + len(found), taken + 900
        late += 900 - sum(one.events for one in found)
    count = accelerator.counters()
    assert count["batches"] == results and count["events_taken"] == taken == late + sum(count[name] for name in FATES)


def test_filters_of_noise(compiler, rng):
    """What they drop is in the hops' results, and in counters of its own."""
    config = CONFIG.replace(hot_pixels=1, background=1, background_cell=3, hot_mask="7,5;20,11", background_us=30)
    given, events = BatchSettings.from_config(config, CORNER), object_of(rng)
    events.x[::9], events.y[::9] = 7, 5
    with Accelerator(SimulationBackend(config)) as accelerator:
        found = accelerator.run(events, settings=given)
        found += accelerator.stop()
        alike(found, ModelEngine(config).run(events, given), least=1)
        count = accelerator.counters()
    for name in ("hot", "noise"):
        assert count[name] == sum(getattr(one, name) for one in found) > 20


def test_a_stream_with_stalls_and_pauses(accelerator, rng):
    """Written while it runs, other settings than lengths are those of the next run; what nobody takes is counted."""
    other = {"roi": (3, 5), "follow": "", "thinning": 2}
    first, second = object_of(rng), object_of(rng)
    accelerator.start(settings=settings(), form="EVT21")
    accelerator.send(encode(first[:300], "EVT21"))
    found = [next(accelerator.results(1))]
    accelerator.control.write_settings(settings(**other), {"every": 1})
    found += sent_by_chance(accelerator, encode(first[300:], "EVT21"), rng)
    alike(found, modelled(first, settings()))
    accelerator.control.write("CTRL", START=1)
    top = accelerator.backend.top
    top.limit(words=5)
    accelerator.send(encode(second, "EVT21"))
    before = accelerator.counters()
    top.run(20_000)
    count = accelerator.counters()
    for name in ("result_stalls", "output_stalls", "input_stalls"):
        assert count[name] - before[name] > 10_000
    top.limit()
    alike(accelerator.stop(), modelled(second, settings(**other)))


def test_every_so_many_th_result_is_sent(accelerator, rng):
    """The ROI moves at each; the next run begins with its first."""
    numbers, skipped = 0, 0
    for _ in range(2):
        events = object_of(rng)
        wanted = modelled(events, settings())
        every = next(k for k in (5, 4) if len(wanted) % k != 1)  # so that the run ends in between
        accelerator.start(roi=CORNER, every=every, form="EVT21")
        accelerator.control.clear_interrupts()
        found = sent_by_chance(accelerator, encode(events, "EVT21"), rng)
        assert len({one.roi_next for one in found}) > 3
        assert [one.batch for one in found] == [numbers + k + 1 for k in range(0, len(wanted), every)]
        for one, other in zip(found, wanted[::every], strict=True):
            assert differences(one, other) == []
        numbers, skipped = numbers + len(wanted), skipped + len(wanted) - len(found)
        assert accelerator.counters()["results_skipped"] == skipped
        assert accelerator.counters()["batches"] == numbers
    accelerator.clear_counters()
    assert accelerator.counters()["results_skipped"] == 0


def test_what_ends_a_run(accelerator, rng):
    """Its unfinished hop has no result, and the next one remembers nothing, as after a reset."""
    events, given = object_of(rng), settings(hop_us=0)
    wanted = modelled(events[100:], given)
    for end in (accelerator.stop, accelerator.reset, lambda: None):
        assert sum(one.events for one in accelerator.run(events[:100], settings=given)) < 100
        end()
        alike(accelerator.run(events[100:], settings=given), wanted, 3)
    accelerator.reset()
    alike(accelerator.run(events, settings=settings(None)), modelled(events, settings(None)), 0)
    accelerator.stop()
    before = accelerator.control.read("COUNT_EMPTY_ENDS")["VALUE"]
    accelerator.control.write("CTRL", END_BATCH=1)
    accelerator.backend.top.run(40)
    assert accelerator.control.read("COUNT_EMPTY_ENDS")["VALUE"] == before + 1
    assert not accelerator.status()["computing"]
    accelerator.start(settings=given)
    accelerator.backend.top.limit(words=3)  # a packet that is stuck
    accelerator.send(encode(events, accelerator.form))
    accelerator.backend.top.run(5000)
    accelerator.backend.top.limit()
    accelerator.reset()
    alike(accelerator.run(events, settings=given), modelled(events, given), 3)


def test_events_behind_the_end_are_the_next_run_s(accelerator, rng):
    """They wait as long as a result of the run before does."""
    events, given, top = object_of(rng), settings(hop_us=0), accelerator.backend.top
    counts = np.cumsum([one.events for one in modelled(events, given)])
    end = int(counts[1]) + 3
    assert end < counts[2]
    accelerator.start(settings=given)
    top.limit(words=0)
    top.send(encode(events[:end], "PACKED"))
    top.run(3000)
    accelerator.control.write_settings(given, {"every": 1})  # at the ROI again
    accelerator.control.write("CTRL", END_BATCH=1, START=1)
    top.send(encode(events[end:], "PACKED"))
    top.run(3000)
    assert top.unsent and accelerator.status()["computing"]
    top.limit()
    wanted = modelled(events[:end], given) + modelled(events[end:], given)
    accelerator.backend.wait_sent(10)
    alike(accelerator.stop(), wanted)


def test_lengths_that_are_not_allowed(accelerator, rng):
    """The driver refuses them; the hardware limits a hop to its window, and says so in each result."""
    events = object_of(rng)
    for change, message in (
        ({"window_events": 201}, "window_events = 201: 1 to 200 is needed"),
        ({"hop_events": 121}, "hop_events = 121: 1 to 120 is needed"),
        ({"hop_us": 4001}, "hop_us = 4001: 0 to 4000 is needed"),
    ):
        with pytest.raises(ConfigError, match=message):
            accelerator.run(events, settings=dataclasses.replace(settings(), **change))
    with pytest.raises(ConfigError, match="what ends a batch: windows = batches is needed"):
        accelerator.start(roi=CORNER, events=50)
    assert accelerator.counters()["beats_in"] == 0
    for name, wrong, base, right in (
        ("HOP_EVENTS", 150, {"window_events": 40, "hop_us": 0}, {"hop_events": 40}),
        ("HOP_US", 3000, {"window_us": 2000, "hop_events": 120}, {"hop_us": 2000}),
    ):
        accelerator.control.write_settings(settings(**base), {"every": 1})
        accelerator.control.write(name, VALUE=wrong)
        accelerator.control.write("CTRL", START=1)
        found = sent_by_chance(accelerator, encode(events, accelerator.form), rng)
        alike(found, modelled(events, settings(**base, **right)), 0)
        assert all(one.config_range for one in found)
        accelerator.reset()
    assert not any(one.config_range for one in accelerator.run(events, settings=settings()))


def test_a_board_at_a_serial_line(compiler, rng):
    events = object_of(rng)
    with Accelerator(UartBackend(SimulatedLine(CONFIG)), CONFIG) as accelerator:
        found = accelerator.run(events[:500], settings=settings())
        alike(found + accelerator.run(events[500:]), modelled(events, settings()))
        assert not any(accelerator.backend.counters().values())


def test_the_preset_follows_an_object_of_a_recording(compiler, data_dir):
    """A survey by the hardware's own windows chooses lengths; with given ones, each row equals the model's."""
    given = {"window_events": 800, "hop_events": 50}
    config = preset("sliding").replace(**given)
    with (
        Accelerator(SimulationBackend(config)) as accelerator,
        open_recording(data_dir / "davis240c_shapes_rotation_0.0s.h5") as recording,
    ):
        assert accelerator.self_test()["golden batch"].endswith("as the integer model")
        cutter = batch_cutter(recording, config, start_event=20_000)
        wanted = list(track(ModelEngine(config), cutter, roi=(100, 30), batches=25))
        found = list(accelerator.track(recording, roi=(100, 30), start_event=20_000, batches=25))
        assert len(found) == 25 and len({one.result.roi_next for one in found}) > 5
        for one, other in zip(found, wanted, strict=True):
            assert differences(one.result, other.result) == []
            assert one.t_us == other.t_us and one.events.first_event == other.events.first_event
        surveyed = Accelerator(accelerator.backend, preset("sliding"))
        lengths = [len(one.events) for one in surveyed.track(recording, roi=(100, 30), start_event=20_000, batches=9)]
        assert len(lengths) == 9 and min(lengths) > 300
        events = next(recording.chunks(20_000, 2500))
        by_hops = surveyed.engine.trial(events, None)[0]
        model = ModelEngine(preset("sliding"))
        model.write(surveyed.engine.regions)
        (by_batch,) = model.trial(events, None)
        assert by_hops.roi_events == by_batch.roi_events and math.dist(by_hops.v, by_batch.v) < 0.3
