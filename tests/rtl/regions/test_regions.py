"""Hardware with a table of regions against the integer model: every iteration of every region, whatever the order."""

import dataclasses

import numpy as np
import pytest
from studies.crosscheck.batches import random_regions, some_changed

from cmfpga.protocol.flags import Flag
from cmfpga.protocol.regions import Region
from cmfpga.protocol.results import counts_of
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.verilog.simulation import VerilatedCore
from support.core_batches import settings
from support.regions import CONFIGS, model_of, random_run, random_settings, random_window, without_clock

CHUNKS = 6


@pytest.fixture(scope="module", params=CONFIGS)
def hardware(request):
    verilated = VerilatedCore(CONFIGS[request.param], seed=3)
    yield verilated
    verilated.close()


def start(hardware, regions):
    """Hardware after a reset, and a model, with the same table."""
    hardware.reset()
    hardware.write([])
    model = model_of(hardware.config)
    for one in (hardware, model):
        one.write(regions)
    return model


def check(hardware, model, windows, chosen, **played):
    found = hardware.results(windows, chosen, **played)
    for window, result in zip(windows, found, strict=True):
        model.sizes.append(len(window[0]))
        assert without_clock(result) == model.run(*window, chosen)
        for region in result.regions:
            counts = {**vars(result), **vars(region)}
            assert result.events == sum(counts[name] for name in counts_of(hardware.config))
        assert result.events == sum(model.sizes[-hardware.config.slices :])
    return found


@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_any_table_and_any_batches(hardware, chunk):
    config = hardware.config
    for seed in range(10):
        rng = np.random.default_rng((chunk, seed))
        regions = random_regions(config, rng)
        model = start(hardware, regions)
        for _ in range(3):
            windows, gaps, stalls = random_run(config, rng, regions)
            found = check(hardware, model, windows, random_settings(config, rng), gaps=gaps, stalls=stalls)
            assert [len(result.regions) for result in found] == [len(regions)] * len(windows)
            if rng.random() < 0.4:
                regions = some_changed(config, rng, regions)
                anew = {number for number in range(len(regions)) if rng.random() < 0.2}
                hardware.write(regions, anew), model.write(regions, anew)


def window_in(config, rng, count, x, y):
    """Events around a pixel of the image, so close together that all may lie in one bin."""
    t = np.sort(rng.integers(0, 1000, count))
    t[-1] = 1000
    return t, *(np.clip(at + rng.integers(-1, 2, count), 0, None) << config.binning for at in (x, y))


HAZARDS = {
    "all events in one bin": ([Region(x=0, y=0, width=12, height=10)], (5, 5)),
    "empty bins around": ([Region(x=16, y=12, width=12, height=10, margin=(0, 0))], (22, 18)),
    "an empty region": ([Region(x=0, y=0, width=4, height=4), Region(x=18, y=12, width=9, height=9)], (21, 16)),
    "over the sensor's edge": ([Region(x=36, y=27, width=12, height=12)], (38, 28)),
    "a region of one pixel": ([Region(x=22, y=18, width=1, height=1)], (22, 18)),
    "the same region thrice": ([Region(x=16, y=12, width=16, height=12)] * 3, (22, 18)),
    "a chain of parents": (
        [Region(x=16, y=12, width=16, height=12, start="parent" if k else "given", parent=max(0, k - 1))
         for k in range(4)],
        (22, 18),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", HAZARDS)
def test_hazards(hardware, name, rng):
    regions, place = HAZARDS[name]
    config = hardware.config
    model = start(hardware, regions)
    chosen = settings(config, camera=(), hot_mask=(), background_us=0)
    for count in (1, 2, 37, 38, config.slice_events):
        (result,) = check(hardware, model, [window_in(config, rng, count, *place)], chosen)
        most = max(region.roi_events for region in result.regions)
        assert most <= config.buffer_events and (most or count < 3 or name.endswith("pixel"))


def test_a_batch_without_any_event_in_a_region_is_degenerate_in_all(hardware, rng):
    regions = [Region(x=30, y=20, width=5, height=5, start="last") for _ in range(min(4, hardware.config.regions))]
    model = start(hardware, regions)
    chosen = settings(hardware.config, camera=(), hot_mask=(), background_us=0)
    (result,) = check(hardware, model, [window_in(hardware.config, rng, 50, 3, 3)], chosen)
    assert all(Flag.DEGENERATE in region.flags and region.outside == 50 for region in result.regions)


def test_a_store_of_thousands_of_pages(rng):
    """Its table of links is deep, and so lies in slices; every page of both halves is used."""
    config = CONFIGS["one unit"].replace(max_batch_events=69_000, when_full="thin")
    assert config.store.pages > 2048
    hardware = VerilatedCore(config)
    model = start(hardware, random_regions(config, rng, 5))
    for _ in range(2):
        count = 69_000
        t = np.sort(rng.integers(0, 20_000, count))
        x, y = (np.minimum(rng.exponential(size / 4, count).astype(int), size - 1) for size in (40, 30))
        check(hardware, model, [(t, x, y)], settings(config))
    hardware.close()


def test_the_outcome_is_that_of_a_core_of_one_region(rng):
    """With bins as large as the sensor, events come in the order of time: all is as in a core of one ROI."""
    config = CONFIGS["five units, front"].replace(undistortion="off", hot_pixels=0, background=0)
    one = config.replace(regions=0, units=1, bin_bits=4)
    hardware, core = VerilatedCore(config), IntegerCore(one)
    chosen = settings(config)
    for k in range(30):
        place = int(rng.integers(24)), int(rng.integers(18))
        hardware.write([Region(x=place[0], y=place[1], width=16, height=12, margin=(0, 0))])
        window = random_window(config, rng)
        found = without_clock(hardware.results([window], chosen)[0]).regions[0]
        wanted = core.run(*window, dataclasses.replace(chosen, roi=place)).regions[0]
        if Flag.DEGENERATE in wanted.flags:
            assert Flag.DEGENERATE in found.flags and found.roi_events == wanted.roi_events
            continue
        moved = {"roi_next": wanted.roi_next, "flags": found.flags | (wanted.flags & Flag.ROI_CLAMPED)}
        assert dataclasses.replace(found, **moved) == wanted, k
    hardware.close()


def test_cycles_of_a_region_are_exact(hardware, rng):
    config, unit = hardware.config, hardware.core.units[0]
    model = start(hardware, regions := random_regions(config, rng, config.regions))
    chosen, cycles = settings(config), []
    for _ in range(5):
        windows, gaps, stalls = random_run(config, rng, regions)
        for result in check(hardware, model, windows, chosen, gaps=gaps, stalls=stalls):
            for region, row in zip(result.regions, regions, strict=True):
                plans = [own or common for own, common in ((row.cold, chosen.cold), (row.warm, chosen.warm))]
                known = {
                    unit.cycles(roi_events=region.roi_events, iterations=plan)
                    for plan in plans
                    if len(plan) == region.iterations
                }
                cycles.append(region.iterations)
                assert not region.iterations or region.cycles in known
    assert any(cycles)
