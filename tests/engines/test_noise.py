"""The filters in front of the ROI, in every engine: the same events dropped, and each counted once."""

import dataclasses

import numpy as np
import pytest
from studies.crosscheck.batches import random_events, random_settings
from studies.crosscheck.compare import check

from cmfpga.config import Config, preset
from cmfpga.engines import make_engine
from cmfpga.engines.rtl import AmaranthEngine, VerilatedEngine
from cmfpga.events import Events
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.results import counts_of
from cmfpga.protocol.settings import BatchSettings

SMALL = {
    "sensor_width": 45, "sensor_height": 40, "roi_width": 16, "roi_height": 12, "buffer_events": 128, "span_bits": 12,
}  # fmt: skip
CONFIGS = {
    "both": preset("fast").replace(**SMALL, hot_pixels=1, background=1),
    "mask": Config(**SMALL, hot_pixels=1),
    "background": Config(**SMALL, background=1, background_cell=3),
}

pytestmark = pytest.mark.usefixtures("compiler")


@pytest.fixture(scope="module", params=CONFIGS)
def config(request):
    return CONFIGS[request.param]


@pytest.fixture
def verilated(config):
    engine = VerilatedEngine(config)
    yield engine
    engine.close()


def steps(config, rng, count):
    """Batches whose settings change: masks that come and go, periods of 0 and more."""
    roi = (0, 0)
    for _ in range(count):
        settings, roi = random_settings(config, rng, roi)
        short = {"iterations": 1, "cold": settings.cold[:2], "warm": settings.warm[:2], "thin_target": 0}
        yield random_events(config, rng, roi)[1], dataclasses.replace(settings, roi=roi, **short)


def test_all_engines_drop_the_same(config, verilated, rng):
    engines = [verilated, AmaranthEngine(config), make_engine("model", config), make_engine("float", config)]
    dropped = dict.fromkeys(("hot", "noise"), 0)
    for events, settings in steps(config, rng, 14):
        events = events[:120]
        compiled, simulated, model, floating = (engine.run(events, settings)[0] for engine in engines)
        assert compiled == simulated and dataclasses.replace(compiled, cycles=None) == model
        for result in (compiled, floating):
            assert result.events == len(events) == sum(getattr(result, name) for name in counts_of(config))
        assert [getattr(floating, name) for name in dropped] == [getattr(compiled, name) for name in dropped]
        dropped = {name: count + getattr(compiled, name) for name, count in dropped.items()}
    assert bool(dropped["hot"]) == config.hot_pixels and bool(dropped["noise"]) == config.background


def test_hardware_and_model_through_long_batches_and_without_a_pause(config):
    batches, iterations = check(config, 3)
    assert batches > 60 and iterations > 100


def test_dropped_events_tell_the_time_all_the_same(config, verilated):
    """t_1 and t_N are those of the camera, as with events outside of the ROI; a batch of noise alone is degenerate."""
    settings = dataclasses.replace(
        BatchSettings.from_config(config, (0, 0)), hot_mask=((3, 4),) * config.hot_pixels, background_us=50
    )
    events = Events(np.arange(10) * 100 + 7, np.full(10, 3), np.full(10, 4), np.zeros(10))
    for engine in (verilated, make_engine("model", config)):
        result = engine.run(events, settings)[0]
        assert (result.t_first, result.span, result.roi_events, result.flags) == (7, 900, 0, Flag.DEGENERATE)
        assert (result.hot, result.noise) == ((10, 0) if config.hot_pixels else (0, 10))


def test_a_reset_forgets_the_times_but_not_the_mask(verilated, config):
    """As software does: the mask stays, the cells begin without a memory, whatever the RAM holds."""
    settings = dataclasses.replace(
        BatchSettings.from_config(config, (0, 0)), hot_mask=((30, 30),) * config.hot_pixels, background_us=50
    )
    columns = np.array([[3, 4, 30], [3, 4, 30]])
    events = Events(np.array([0, 1, 2]), *columns, np.zeros(3))
    found = []
    for _ in range(3):
        result = verilated.run(events, settings)[0]
        found.append((result.hot, result.noise))
        verilated._core.reset()
    assert found == [found[0]] * 3
    hot, noise = found[0]
    assert hot == config.hot_pixels and noise == 2 * config.background
