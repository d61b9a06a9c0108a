"""What stands in front of the ROI, in every engine: the same positions, events dropped, and each counted once."""

import contextlib
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
from cmfpga.protocol.results import counts_of, fields_of
from cmfpga.protocol.settings import BatchSettings
from cmfpga.rtl.image import dither, warp
from cmfpga.rtl.ingest import roi_filter
from support.mutation import break_blocks

SMALL = {
    "sensor_width": 45, "sensor_height": 40, "roi_width": 16, "roi_height": 12, "buffer_events": 128, "span_bits": 12,
}  # fmt: skip
ON = SMALL | {"undistortion": "on"}
FILTERS = {
    "both": preset("fast").replace(**SMALL, hot_pixels=1, background=1),
    "mask": Config(**SMALL, hot_pixels=1),
    "background": Config(**SMALL, background=1, background_cell=3),
}
LENSES = {
    "fast": preset("fast").replace(**ON, hot_pixels=1, background=1),
    # Without a dither and without coarse levels: the fractions alone.
    "paper": Config(**ON, undistortion_frac=6, undistortion_cell=2),
    # A dither that is coarser than the positions; and one that is finer.
    "coarse dither": preset("fast").replace(**ON | {"roi_width": 15}, dither_frac=2, undistortion_frac=5),
    "fine dither": Config(**ON, dither_frac=7, undistortion_frac=3, undistortion_cell=4, position_frac=3),
}
CONFIGS = FILTERS | LENSES
LENS = (44.0, 43.0, 21.0, 20.5, -0.3, 0.08, 0.002, -0.001, 0.01)
CAMERA = ",".join(map(repr, LENS))

pytestmark = pytest.mark.usefixtures("compiler")


@pytest.fixture
def verilated():
    """``verilated(config)``: its emitted Verilog, closed behind the test."""
    with contextlib.ExitStack() as stack:
        yield lambda config: stack.enter_context(contextlib.closing(VerilatedEngine(config)))


def settings_of(config, corner, **changes):
    return dataclasses.replace(BatchSettings.from_config(config, corner), **changes)


@pytest.mark.parametrize("name", CONFIGS)
def test_all_engines_see_and_drop_the_same(name, verilated, rng):
    """Batches whose settings change: masks and cameras that come and go, periods of 0 and more."""
    config, roi = CONFIGS[name], (0, 0)
    engines = [verilated(config), AmaranthEngine(config), make_engine("model", config), make_engine("float", config)]
    total = dict.fromkeys(("hot", "noise", "outside"), 0)
    for lens in [LENS] * 3 + [()] * 3 + [LENS] * 3 + [(*LENS[:4], 0.2, *LENS[5:])] * 3 if name in LENSES else [()] * 14:
        settings, roi = random_settings(config, rng, roi)
        short = {"iterations": 1, "cold": settings.cold[:2], "warm": settings.warm[:2], "thin_target": 0}
        settings = dataclasses.replace(settings, roi=roi, camera=lens, **short)
        events = random_events(config, rng, roi)[1][:120]
        compiled, simulated, model, floating = (engine.run(events, settings)[0] for engine in engines)
        assert compiled == simulated and dataclasses.replace(compiled, cycles=None) == model
        for result in (compiled, floating):
            assert result.events == len(events) == sum(getattr(result, name) for name in counts_of(config))
        for field in ("roi_events", *total):
            assert getattr(floating, field) == getattr(compiled, field)
        total = {field: count + getattr(compiled, field) for field, count in total.items()}
    assert total["outside"]
    if name in FILTERS:
        assert bool(total["hot"]) == config.hot_pixels and bool(total["noise"]) == config.background


@pytest.mark.parametrize("name", CONFIGS)
def test_hardware_and_model_through_long_batches_and_without_a_pause(name):
    batches, iterations = check(CONFIGS[name], 3)
    assert batches > 60 and iterations > 100


@pytest.mark.parametrize("config", FILTERS.values(), ids=FILTERS)
def test_dropped_events_tell_the_time_all_the_same(config, verilated):
    """t_1 and t_N are those of the camera, as with events outside of the ROI; a batch of noise alone is degenerate."""
    settings = settings_of(config, (0, 0), hot_mask=((3, 4),) * config.hot_pixels, background_us=50)
    events = Events(np.arange(10) * 100 + 7, np.full(10, 3), np.full(10, 4), np.zeros(10))
    for engine in (verilated(config), make_engine("model", config)):
        result = engine.run(events, settings)[0]
        assert (result.t_first, result.span, result.roi_events, result.flags) == (7, 900, 0, Flag.DEGENERATE)
        assert (result.hot, result.noise) == ((10, 0) if config.hot_pixels else (0, 10))


@pytest.mark.parametrize("config", FILTERS.values(), ids=FILTERS)
def test_a_reset_forgets_the_times_but_not_the_mask(verilated, config):
    """As software does: the mask stays, the cells begin without a memory, whatever the RAM holds."""
    settings = settings_of(config, (0, 0), hot_mask=((30, 30),) * config.hot_pixels, background_us=50)
    events = Events(np.arange(3), *np.array([[3, 4, 30], [3, 4, 30]]), np.zeros(3))
    engine = verilated(config)
    for _ in range(3):
        result = engine.run(events, settings)[0]
        assert (result.hot, result.noise) == (config.hot_pixels, 2 * config.background)
        engine._core.reset()


MUTANTS = {  # module, old, new, configuration
    "ROI in whole pixels": (roi_filter, "y - Cat(Const(0, frac), self.roi.y)", "y - self.roi.y", "fast"),
    "a row more": (roi_filter, "(y_s2 < height << frac)", "(y_s2 < (height + 1) << frac)", "paper"),
    "half a pixel twice": (warp, "return 0, scaled", "return 1 << config.dt_frac, scaled", "fine dither"),
    "half a pixel stays": (warp, "return 0, scaled", "return 0, 0", "paper"),
    "dither too small": (dither, "Cat(Const(0, wide - frac), offset)", "offset", "coarse dither"),
    "positions too small": (dither, "event_s1 << (wide - formats.event_frac)", "event_s1", "fine dither"),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_a_broken_block_is_noticed(name, rng, monkeypatch):
    """Fractions that a block behind the undistorter handles wrongly."""
    module, old, new, which = MUTANTS[name]
    break_blocks(monkeypatch, module, old, new)
    config = CONFIGS[which]
    simulated, model = AmaranthEngine(config), make_engine("model", config)

    def equal(roi):
        x, y = roi[0] + rng.integers(-3, 19, 100), roi[1] + rng.integers(-3, 15, 100)
        events = Events(np.arange(100) * 9, x.clip(0, 44), y.clip(0, 39), np.zeros(100))
        settings = settings_of(config, roi, camera=LENS, iterations=2, eta=900)
        return dataclasses.replace(simulated.run(events, settings)[0], cycles=None) == model.run(events, settings)[0]

    # By chance a fraction changes nothing in a batch, or in a few.
    assert not all(map(equal, ((3, 4), (20, 14), (11, 9)) * 4))


def test_without_a_camera_it_is_the_hardware_without_undistortion(rng):
    """Whole pixels, in the same order: the same result, but for the fractions that there are none of."""
    config, roi = CONFIGS["fast"], (0, 0)
    one, other = make_engine("model", config), make_engine("model", config.replace(undistortion="off"))
    for _ in range(12):
        settings, roi = random_settings(config, rng, roi)
        settings = dataclasses.replace(settings, camera=())
        _, events = random_events(config, rng, roi)
        assert one.run(events, settings)[0] == other.run(events, settings)[0]


def test_what_leaves_the_sensor_is_counted(verilated):
    """The corners of a barrel's image lie outside of the undistorted one."""
    config = CONFIGS["paper"].replace(camera=CAMERA)
    roi = config.geometry.roi_x_max, config.geometry.roi_y_max
    corner = np.full(30, config.sensor_width - 1), np.full(30, config.sensor_height - 1)
    events = Events(np.arange(30) * 10, *corner, np.zeros(30))
    for changes, counts in (({}, (30, 0)), ({"camera": ()}, (0, 30))):
        result = verilated(config).run(events, settings_of(config, roi, **changes))[0]
        assert (result.outside, result.roi_events) == counts


def test_a_reset_leaves_the_table(verilated, rng):
    config = CONFIGS["fast"].replace(camera=CAMERA)
    engine, settings = verilated(config), BatchSettings.from_config(config, (10, 10))
    _, events = random_events(config, rng, (10, 10), "random_everywhere")
    found = []
    for _ in range(2):
        found.append(dataclasses.replace(engine.run(events, settings)[0], cycles=None))
        engine._core.reset()
    assert found[0] == found[1] and found[0].outside


def test_behind_the_axi_top(rng):
    """The table is written through registers, again where the camera changes, and after a reset."""
    config, roi, off = CONFIGS["paper"], (0, 0), 0
    names = [f.name for f in fields_of("batch", "region", config=config) if f.name != "cycles"]
    with contextlib.closing(make_engine("axi", config)) as axi:
        model = make_engine("model", config)
        for number, lens in enumerate((LENS, LENS, (), LENS, (*LENS[:4], 0.2, *LENS[5:]))):
            settings, roi = random_settings(config, rng, roi)
            settings = dataclasses.replace(settings, roi=roi, camera=lens, iterations=1)
            events = random_events(config, rng, roi)[1]
            found, wanted = axi.run(events, settings)[0], model.run(events, settings)[0]
            assert [getattr(found, name) for name in names] == [getattr(wanted, name) for name in names], number
            off += found.outside
    assert off
