"""The driver on the emitted AXI top in Verilator."""

import dataclasses

import numpy as np
import pytest

from cmfpga.config import Config, preset
from cmfpga.driver import Accelerator, DeviceError, DeviceTimeout, WireResult, WrongHardware
from cmfpga.engines.model import ModelEngine
from cmfpga.errors import ConfigError
from cmfpga.events import BatchCutter, Events, MemoryRecording, open_recording
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.registers import FORMATS
from cmfpga.protocol.settings import BatchSettings
from cmfpga.protocol.words import encode
from cmfpga.simulation.axi_top import SimulationBackend
from cmfpga.tracking.loop import track
from support.driving import CONFIG, REGISTERS, SMALL, batch, differences, model_run, within, works


class Wrapped(SimulationBackend):
    """The simulation of the shared top, with registers that may be made to lie."""

    def __init__(self, top):
        self.config, self.top = CONFIG, top
        self.overrides = {}

    def override(self, register, **fields):
        declared = REGISTERS[register]
        word = self.top.read32(declared.offset)
        for name, value in fields.items():
            word = word & ~declared[name].mask | declared[name].pack(value)
        self.overrides[declared.offset] = word

    def read32(self, offset):
        return self.overrides.get(offset, super().read32(offset))


@pytest.fixture
def backend(top):
    return Wrapped(top)


@pytest.fixture
def accelerator(backend):
    return Accelerator(backend)


@pytest.mark.parametrize("form", FORMATS)
def test_batches_equal_the_model(backend, rng, form):
    accelerator, model = Accelerator(backend, form=form), ModelEngine(CONFIG)
    for number in range(6):
        events = batch(rng, int(rng.integers(2, 300)), begin=1000 * number)
        roi = (8 + number, 4) if number in (0, 3) else None
        result = accelerator.run(events, roi=roi)
        assert isinstance(result, WireResult)
        assert differences(result, model_run(model, events, roi)) == []
        assert result.batch == number + 1 and not result.wire and not result.config_range
        assert result.t_first == events.t[0] and result.t_ref == events.t[0] + (events.t[-1] - events.t[0]) // 2
        assert accelerator.engine.roi == result.roi_next and accelerator.engine.v == result.v


def test_batches_of_the_article_equal_the_model(compiler, rng):
    """The constant step has other registers: no table, but T and η."""
    config = Config(**SMALL, iterations=12)
    model = ModelEngine(config)
    with Accelerator(SimulationBackend(config)) as accelerator:
        for number, change in enumerate(({}, {"iterations": 3}, {"eta": 7.25}, {"start": "zero"}, {})):
            settings = BatchSettings.from_config(config.replace(**change), None if number else (8, 4))
            events = batch(rng, 150, begin=1000 * number)
            result = accelerator.run(events, settings=settings)
            assert differences(result, model.run(events, settings)) == []
            assert result.iterations == change.get("iterations", 12)
        assert accelerator.self_test()["golden batch"].endswith("as the integer model")


def test_cycles_are_those_of_the_core(accelerator, rng):
    from cmfpga.rtl.core import Core

    events = batch(rng, 200)
    result = accelerator.run(events, roi=(8, 4))
    formula = Core(CONFIG).cycles(events=200, roi_events=result.roi_events, iterations=result.iterations)
    assert result.cycles == formula


def test_every_setting_reaches_the_hardware(accelerator, rng):
    """Settings one after the other, without a reset: what is not written again must be as it was."""
    model = ModelEngine(CONFIG)
    changes = (
        {},
        {"min_roi_events": 60},
        {"thinning": 3},
        {"thin_target": 8},
        {"roi_gain": 1.0},
        {"start": "given", "v_start_x": -1.5, "v_start_y": 2.0},
        {"start": "zero"},
        {"cold": "1:-1*3", "warm": "0:-2"},
        {"start": "given", "v_start_x": 0.5, "cold": "0:0 1:1"},
        {},
    )
    seen = Flag(0)
    for number, change in enumerate(changes):
        settings = BatchSettings.from_config(CONFIG.replace(**change), (8, 4) if number == 0 else None)
        events = batch(rng, 180, begin=1000 * number)
        result = accelerator.run(events, settings=settings)
        expected = model.run(events, settings)
        assert differences(result, expected) == []
        seen |= result.flags
    assert Flag.THINNED | Flag.DEGENERATE in seen


def test_flags_and_counters_account_for_every_event(accelerator, rng):
    model = ModelEngine(CONFIG)
    sizes = (2, 700, 90)
    totals = dict.fromkeys(("roi_events", "outside", "overflow", "time_back"), 0)
    for number, size in enumerate(sizes):
        events = batch(rng, size, begin=1000 * number)
        if number == 2:
            events.t[40:45] -= 900  # time steps back
        result = accelerator.run(events, roi=(8, 4))
        assert differences(result, model_run(model, events, (8, 4))) == []
        for name in totals:
            totals[name] += getattr(result, name)
    assert totals["overflow"] and totals["time_back"]
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


def test_track_equals_the_model(accelerator, rng):
    events = batch(rng, 2000)
    recording = MemoryRecording(events, 48, 32)
    tracked = list(accelerator.track(recording, roi=(8, 4), events=150, batches=9, start_event=100))
    cutter = BatchCutter(recording, events=150, start_event=100, max_events=CONFIG.max_batch_events)
    expected = list(track(ModelEngine(CONFIG), cutter, roi=(8, 4), batches=9))
    assert len(tracked) == len(expected) == 9
    cycles = 11  # column that the model leaves empty
    for a, b in zip(tracked, expected, strict=True):
        assert a.row()[:cycles] == b.row()[:cycles] and a.row()[cycles + 1 :] == b.row()[cycles + 1 :]
        assert int(a.row()[cycles]) > 0 and not b.row()[cycles]


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
        (Events(*np.zeros((4, CONFIG.max_batch_events + 1), int)), None, "a batch of 65536 events: at most 65535"),
    ):
        with pytest.raises(ConfigError, match=message):
            accelerator.run(events, roi=roi)
    assert accelerator.counters()["beats_in"] == 0


# ---------------------------------------------------------------- streams


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
    for number, result in enumerate(results):
        part = events[130 * number : 130 * (number + 1)]
        assert differences(result, model_run(model, part, None if number else (8, 4))) == []
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
    begin = 0
    for number, result in enumerate(results):
        part = events[begin : begin + result.events]
        begin += result.events
        assert part.t[-1] - part.t[0] < 250
        assert differences(result, model_run(model, part, None if number else (8, 4))) == []
    assert begin == 400 and len(results) >= 4
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


# ---------------------------------------------------------------- identity


@pytest.mark.parametrize(
    "register, fields, message",
    [
        ("ID", {"MAGIC": 0xFFFFFFFF}, r"ID reads 0xffffffff, not 0x434d4158; is the bitstream loaded"),
        ("ID", {"MAGIC": 0}, r"ID reads 0x00000000"),
        ("VERSION", {"MAJOR": 9, "MINOR": 8, "PATCH": 7}, r"made by cmfpga 9\.8\.7, this .*install cmfpga 9\.8\.7"),
        ("VERSION", {"PATCH": 9999}, r"made by cmfpga \d+\.\d+\.9999"),
        ("CAPS", {"MAP": 77}, r"version 77 of the register map, this driver 1"),
        ("BUILD", {"HASH": 0xDEADBEEF}, rf"configuration deadbeef, not {CONFIG.hardware_hash[:8]}"),
    ],
)  # fmt: skip
def test_wrong_hardware_is_refused_by_name(backend, register, fields, message):
    backend.override(register, **fields)
    with pytest.raises(WrongHardware, match=message) as error:
        Accelerator(backend)
    assert "\n" not in str(error.value)
    assert backend.top.read32(REGISTERS["COUNT_BATCHES"].offset) == 0


def test_configuration_is_found_among_the_presets(backend):
    for name in ("fast", "paper"):
        config = preset(name)
        backend.config = None
        backend.override("BUILD", HASH=int(config.hardware_hash[:8], 16))
        assert Accelerator(backend).config == config
        with pytest.raises(WrongHardware, match=rf"{config.hardware_hash[:8]} \(preset {name}\), not"):
            Accelerator(backend, CONFIG)
    backend.overrides.clear()
    with pytest.raises(WrongHardware, match="none of the presets paper, fast"):
        Accelerator(backend)
    other = CONFIG.replace(cold="0:0", start="zero")  # run-time fields are the user's
    assert Accelerator(backend, other).config == other
    with pytest.raises(ValueError, match="format 'EVT9'"):
        Accelerator(backend, CONFIG, form="EVT9")
    backend.has_interrupt = False
    with pytest.raises(DeviceError, match="there is no interrupt to wait for"):
        Accelerator(backend, CONFIG, interrupt=True)


@pytest.mark.parametrize("timeout", [float("nan"), float("inf"), -0.1])
def test_time_outs_that_never_end_are_refused(accelerator, backend, rng, timeout):
    events = batch(rng, 10)
    for wrong in (
        lambda: Accelerator(backend, timeout=timeout),
        lambda: accelerator.run(events, timeout=timeout),
        lambda: accelerator.send(np.zeros(1, np.uint64), timeout=timeout),
        lambda: next(accelerator.results(1, timeout=timeout)),
        lambda: accelerator.stop(timeout=timeout),
        lambda: accelerator.self_test(timeout=timeout),
    ):
        with pytest.raises(ConfigError, match=r"time-out .* s: 0 to 86400 s is allowed"):
            wrong()


# ---------------------------------------------------------------- what goes wrong


@pytest.mark.parametrize("sent", [0, 1, 37, 99])
def test_words_that_stop_in_the_middle_of_a_batch(accelerator, top, rng, sent):
    top.limit(send=sent)
    with within(5), pytest.raises(DeviceTimeout, match=rf"(?s)no result within 0\.1 s .*: {sent} words taken") as error:
        accelerator.run(batch(rng, 100), roi=(8, 4), timeout=0.1)
    assert "\n" not in str(error.value) and accelerator.timeout == 10
    top.limit()
    assert accelerator.engine.v == (0, 0) and accelerator.engine.roi == (0, 0)
    works(accelerator, rng)


def test_interrupt_that_never_comes(accelerator, backend, rng, monkeypatch):
    """The result is there, but the line is dead: said so; without the interrupt all works."""

    def dead(timeout):
        backend.top.run(20_000)
        return False

    monkeypatch.setattr(backend, "wait_interrupt", dead)
    with (
        within(5),
        pytest.raises(DeviceTimeout, match=r"the result came, but no interrupt within 0\.1 s; interrupt=False"),
    ):
        accelerator.run(batch(rng, 100), roi=(8, 4), timeout=0.1)
    accelerator.interrupt = False
    accelerator.reset()
    works(accelerator, rng)


def test_interrupts_that_nobody_asked_for(accelerator, backend, rng, monkeypatch):
    """Wake-ups without a result are not results."""
    usual, woken = backend.wait_interrupt, []

    def early(timeout):
        woken.append(timeout)
        return True if len(woken) % 3 else usual(timeout)

    monkeypatch.setattr(backend, "wait_interrupt", early)
    works(accelerator, rng)
    assert len(woken) >= 6


def test_reset_in_between(accelerator, top, rng):
    """Of the software in the middle of a batch, and of the hardware behind the driver's back."""
    accelerator.start(roi=(8, 4), events=100)
    accelerator.send(encode(batch(rng, 250), "PACKED"))
    top.run(180)
    accelerator.reset()
    works(accelerator, rng)
    top.reset()
    with within(5), pytest.raises(DeviceError):
        accelerator.run(batch(rng, 100), timeout=0.1)
    works(accelerator, rng)


def test_somebody_else_sends_words(accelerator, top, rng):
    works(accelerator, rng)
    top.send(encode(batch(rng, 5), "PACKED"))
    top.run(100)
    with pytest.raises(DeviceError, match="something else sends"):
        accelerator.run(batch(rng, 100), roi=(8, 4))
    works(accelerator, rng)


def test_packets_of_another_length_and_lost_results(accelerator, backend, rng, monkeypatch):
    usual = backend.receive
    monkeypatch.setattr(backend, "receive", lambda timeout: usual(timeout)[:9])
    with pytest.raises(DeviceError, match="a packet of 9 words; 14 make a result"):
        accelerator.run(batch(rng, 100), roi=(8, 4))
    monkeypatch.undo()
    works(accelerator, rng)
    accelerator.start(events=30)
    accelerator.send(encode(batch(rng, 90), "PACKED"))
    usual(1)
    with pytest.raises(DeviceError, match="batch 4 came, not of 3"):
        next(accelerator.results(1))
    accelerator.stop()


def test_words_that_get_lost(accelerator, backend, rng, monkeypatch):
    usual = backend.send
    monkeypatch.setattr(backend, "send", lambda words: usual(words[3:]))
    with pytest.raises(DeviceError, match="the result is of 97 events; 100 were sent"):
        accelerator.run(batch(rng, 100), roi=(8, 4))
    monkeypatch.undo()
    works(accelerator, rng)


def test_input_that_does_not_change(accelerator, backend, rng):
    backend.override("STATUS", INPUT_PENDING=1)
    with (
        within(5),
        pytest.raises(DeviceTimeout, match=r"the kind of input does not change within 0\.1 s: 0 words taken"),
    ):
        accelerator.run(batch(rng, 100), roi=(8, 4), timeout=0.1)
    backend.overrides.clear()
    works(accelerator, rng)


def test_registers_that_do_not_answer(accelerator, top):
    top._call("axi_reset", 0)  # then held in reset: nothing answers
    top.read32 = lambda offset: (_ for _ in ()).throw(DeviceTimeout("no answer"))
    with pytest.raises(DeviceTimeout):
        accelerator.counters()
    accelerator.close()  # says nothing, and does not hang
    accelerator.close()
    with pytest.raises(ValueError, match="closed"):
        top.run(1)


def test_memories_at_random(compiler, rng):
    """Nothing depends on what memories hold at the begin."""
    events = batch(rng, 150)
    found = []
    for seed in (2, 3):
        with Accelerator(SimulationBackend(CONFIG, seed=seed)) as accelerator:
            found.append(accelerator.run(events, roi=(8, 4)))
    assert found[0] == found[1]


# ---------------------------------------------------------------- the self-test


def test_self_test(accelerator, rng):
    found = accelerator.self_test()
    assert list(found) == ["identity", "scratch", "interrupt", "golden batch", "counters"]
    assert found["interrupt"].startswith("came") and found["golden batch"].endswith("as the integer model")
    works(accelerator, rng)


def test_self_test_without_the_interrupt(backend):
    accelerator = Accelerator(backend, interrupt=False)
    assert accelerator.self_test()["interrupt"] == "not used"


def test_self_test_notices(accelerator, backend, monkeypatch):
    backend.override("SCRATCH", VALUE=0)
    with pytest.raises(DeviceError, match="SCRATCH reads 0x00000000 after 0xffffffff"):
        accelerator.self_test()
    backend.overrides.clear()
    backend.override("BUILD", HASH=1)
    with pytest.raises(WrongHardware, match="configuration 00000001"):
        accelerator.self_test()
    backend.overrides.clear()
    monkeypatch.setattr(backend, "wait_interrupt", lambda timeout: True)
    with pytest.raises(DeviceError, match="is the line stuck"):
        accelerator.self_test()
    monkeypatch.undo()
    usual = backend.receive

    def wrong(timeout):
        words = usual(timeout)
        words[-1] ^= np.uint64(1)
        return words

    monkeypatch.setattr(backend, "receive", wrong)
    with pytest.raises(DeviceError, match=r"golden batch's sums is .*; the integer model says"):
        accelerator.self_test()
    monkeypatch.undo()
    assert accelerator.self_test()["counters"] == "1200 events in, 1 result"


# ---------------------------------------------------------------- a real recording


def test_real_recording_with_preset_fast(compiler, data_dir):
    """Every batch bit for bit, and the self-test, of the hardware that the presets ship."""
    config = preset("fast")
    model = ModelEngine(config)
    with (
        Accelerator(SimulationBackend(config), form="EVT21") as accelerator,
        open_recording(data_dir / "davis240c_shapes_rotation_2.1s_gtflow.h5") as recording,
    ):
        assert accelerator.self_test()["golden batch"].startswith("1200 events")
        cutter = BatchCutter(recording, events=2000, max_events=config.max_batch_events)
        for tracked in accelerator.track(recording, roi=(90, 60), events=2000, batches=8):
            expected = model_run(model, cutter.next(), None if tracked.index else (90, 60), config)
            assert differences(tracked.result, expected) == []
        assert tracked.index == 7
        count = accelerator.counters()
        assert count["events_in"] == count["events_taken"] == 16_000
        assert count["events_taken"] == count["roi_events"] + count["outside"] + count["overflow"]
