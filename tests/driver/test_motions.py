"""Motions beyond translation behind the AXI top, by the driver on the emitted Verilog: the integer model, ``==``."""

import dataclasses

import numpy as np
import pytest
from studies.crosscheck.batches import random_events, random_settings

from cmfpga.config import preset
from cmfpga.driver import Accelerator, WrongHardware, simulation
from cmfpga.driver.simulation import SimulationBackend
from cmfpga.engines.model import ModelEngine
from cmfpga.errors import ConfigError
from cmfpga.events import Events
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.registers import register_map
from cmfpga.protocol.settings import BatchSettings
from cmfpga.protocol.words import encode
from cmfpga.rtl.shell import result_packet
from cmfpga.rtl.shell import settings as shell_settings
from cmfpga.verilog import compile
from cmfpga.verilog.emit import emit_verilog
from support.driving import differences
from support.mutation import break_blocks

SENSOR = {"sensor_width": 48, "sensor_height": 32, "buffer_events": 64, "max_batch_events": 2000}
CONFIGS = {
    "similarity": preset("similarity").replace(**SENSOR, roi_width=24, roi_height=16),
    "rotation": preset("rotation").replace(**SENSOR, roi_width=48, roi_height=32, ram_style="auto"),
}
CAMERA = "60,60,22,17,-0.2,0,0,0"

pytestmark = pytest.mark.usefixtures("compiler")


@pytest.fixture(params=CONFIGS)
def config(request):
    return CONFIGS[request.param]


@pytest.fixture
def accelerator(config):
    with Accelerator(SimulationBackend(config)) as made:
        yield made


def check(accelerator, rng, count):
    """Random batches and settings, each result equal to the model's; the flags that came."""
    config, seen, roi = accelerator.config, Flag(0), (0, 0)
    model = ModelEngine(config)
    for number in range(count):
        settings, roi = random_settings(config, rng, roi)
        events = random_events(config, rng, roi)[1][:300]
        if not len(events):
            continue
        result, expected = accelerator.run(events, settings=settings), model.run(events, settings)[0]
        assert differences(result, expected) == [], number
        assert result.v == model.core.velocity and not result.config_range
        seen |= result.flags
    return seen


def test_batches_equal_the_model(accelerator, rng):
    """Any start of every parameter, any camera, any steps."""
    assert Flag.SATURATED | Flag.DEGENERATE in check(accelerator, rng, 40)
    assert accelerator.self_test()["golden batch"].endswith("as the integer model")


def test_what_the_hardware_says_it_is(config):
    """Its motion, and what its parameters are told in; nothing of a translation has moved."""
    registers, plain = register_map(config), register_map(preset("fast"))
    caps, lever = registers["CAPS"].unpack(registers["CAPS"].reset), config.motion_model.lever
    assert (caps["MOTION"], caps["LEVER"]) == ({"similarity": 1, "rotation": 2}[config.motion], lever)
    assert "MOTION" not in plain["CAPS"].unpack(0) and "RESULT_V_ROLL" not in plain and "CURVE" not in plain
    assert ("RESULT_V_ZOOM" in registers) == ("V_START_ZOOM" in registers) == (config.motion == "similarity")
    assert ("CENTRE" in registers) == ("CURVE" in registers) == (config.motion == "rotation")
    assert ("ROI_GAIN" in registers) == (config.motion == "similarity")
    for register in registers:
        if register.name in plain:
            assert register.offset == plain[register.name].offset


def test_a_stream_without_a_pause_and_after_a_reset_in_the_middle(accelerator, rng):
    """Batches that the hardware cuts, back to back, words and packets stalled; then a reset while one is taken in."""
    config, top = accelerator.config, accelerator.backend.top
    run = BatchSettings.from_config(config.replace(**with_camera(config)), (0, 0))
    for attempt in range(2):
        model = ModelEngine(config)
        events = random_events(config, rng, (0, 0))[1]
        events = Events(1000 * attempt + np.arange(len(events)), events.x, events.y, events.p)
        size = len(events) // 5
        assert size > 10
        accelerator.start(settings=run, events=size)
        accelerator.send(encode(events, accelerator.form))
        for number, result in enumerate(accelerator.results(4)):
            settings = dataclasses.replace(run, roi=None) if number else run
            expected = model.run(events[size * number : size * (number + 1)], settings)[0]
            assert differences(result, expected) == [], (attempt, number)
        accelerator.send(encode(events, accelerator.form)[: size // 2])
        top.run(60)
        assert accelerator.status()["taking_in"]
        accelerator.reset()


def with_camera(config):
    return {"camera": CAMERA} if config.motion == "rotation" else {}


def test_settings_beyond_their_range_are_limited_and_flagged(accelerator, rng):
    """As the registers say: the largest roll and zoom, the sensor's last pixel."""
    config = accelerator.config
    events = random_events(config, rng, (0, 0))[1][:100]
    good = BatchSettings.from_config(config.replace(**with_camera(config), start="given"), (0, 0))
    most = tuple(parameter.fmt.max for parameter in config.motion_model.parameters)
    for part in range(2, len(most)):
        wrong = dataclasses.replace(good, v_start=(*good.v_start[:part], most[part] + 1, *good.v_start[part + 1 :]))
        model = ModelEngine(config)
        accelerator.reset()
        result = accelerator.run(events, settings=wrong)
        limited = dataclasses.replace(wrong, v_start=(*wrong.v_start[:part], most[part], *wrong.v_start[part + 1 :]))
        assert result.config_range and differences(result, model.run(events, limited)[0]) == []
    if config.motion == "rotation":
        accelerator.reset()
        far, last = (  # without a distortion, so that the table is the same
            dataclasses.replace(good, camera=(60.0, 60.0, column, 17.0, 0.0, 0.0, 0.0, 0.0, 0.0)) for column in (60, 47)
        )
        result = accelerator.run(events, settings=far)
        assert result.config_range and differences(result, ModelEngine(config).run(events, last)[0]) == []
    assert not accelerator.run(events, settings=good).config_range


MUTANTS = {  # module, old, new, configuration
    "zoom and roll exchanged": (shell_settings, "found.append(part[outer][inner])",
        'found.append(part[outer][{"zoom": "roll", "roll": "zoom"}.get(inner, inner)])', "similarity"),
    "the centre's row for its column": (shell_settings, "found.append(part[outer][inner])",
        'found.append(part[outer]["y" if outer == "centre" else inner])', "rotation"),
    "a sum's upper half forgotten": (result_packet, "following.matches(*found) & ~nothing",
        "following.matches(*(k for k in found if k < 19)) & ~nothing", "rotation"),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_a_broken_shell_is_noticed(name, monkeypatch, rng):
    *change, which = MUTANTS[name]
    break_blocks(monkeypatch, *change)
    # Both keep what is sound.
    monkeypatch.setattr(simulation, "_library", simulation._library.__wrapped__)
    monkeypatch.setattr(compile, "kept_verilog", emit_verilog)
    with Accelerator(SimulationBackend(CONFIGS[which])) as made, pytest.raises(AssertionError):
        check(made, rng, 12)


def test_without_a_camera_there_is_no_rotation(rng):
    """One line, before anything is sent; and hardware of another motion is refused by its name."""
    config = CONFIGS["rotation"]
    backend = SimulationBackend(config)
    with Accelerator(backend) as accelerator:
        with pytest.raises(ConfigError, match=r"^motion = rotation: a calibration is needed: camera = "):
            accelerator.run(random_events(config, rng, (0, 0))[1][:50])
        assert accelerator.counters()["beats_in"] == 0
        with pytest.raises(WrongHardware, match="which was asked for"):
            Accelerator(backend, CONFIGS["similarity"])
