"""The Verilog of windows that slide against the model: every round's sums and every field, whenever events come."""

import dataclasses
import itertools

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.settings import BatchSettings
from cmfpga.reference.integer.sliding import Sliding
from cmfpga.verilog.simulation import VerilatedCore
from support.hops import CORNER, SMALL, drawn

QUAD = preset("quad").replace(**SMALL)
FAST = preset("fast").replace(**SMALL | {"tag_bits": 7})
#: Hops that close by number, by time, share nothing, are of one event; with the warm schedule, judged by themselves.
CASES = {
    "both": QUAD.replace(window_events=120, hop_events=9, window_us=4000, hop_us=300),
    "by number": QUAD.replace(window_events=120, hop_events=10, window_us=0, hop_us=0),
    "disjoint": QUAD.replace(window_events=60, hop_events=60, window_us=2000, hop_us=900, follow="", thinning=2),
    "one event a hop": QUAD.replace(window_events=50, hop_events=1, window_us=900, hop_us=40, after=""),
    "two rounds": QUAD.replace(window_events=80, hop_events=12, follow="1:3/4:1 0:3/4:1/4", judge=0),
    "short hops": QUAD.replace(window_events=80, hop_events=40, max_batch_events=25, min_roi_events=1, roi_gain=0.0),
    "empty windows": QUAD.replace(window_events=16, hop_events=16, window_us=4000, hop_us=300, min_roi_events=4),
    "one evaluator": FAST.replace(window_events=120, hop_events=9, window_us=4000, hop_us=300),
    "all that may stand in front": QUAD.replace(
        hop_events=9, window_us=4000, hop_us=300, hot_pixels=1, hot_mask="15,11;16,10", background=1, background_cell=2,
        background_us=400, undistortion="on", camera="36,35,18.3,16.8,-0.3,0.1,0,0,0",
    ),
    "binned": QUAD.replace(
        sensor_width=63, sensor_height=47, binning=1, hop_events=9, window_us=4000, hop_us=300, hot_pixels=1,
        hot_mask="31,23;32,22", background=1, background_cell=3, background_us=400, undistortion="on",
        camera="72,70,37.1,34.1,-0.3,0.1,0,0,0",
    ),
    "binned alone": QUAD.replace(sensor_width=63, sensor_height=47, binning=1),
}  # fmt: skip


def played(core, given, events, rng, *, waits):
    """Results of the core for events that come in pieces, at once, or with pauses and results that are taken late."""
    core.reset()
    n, found = len(events[0]), []
    gaps = rng.integers(0, 60, n) * (np.arange(n) % 100 > 30) if waits else None
    stalls = rng.integers(0, 50, 50) if waits else None
    for a, b in itertools.pairwise([0, *sorted(rng.integers(0, n, 3)), n]):
        part = slice(a, b)
        if b > a:
            pauses = None if gaps is None else gaps[part]
            found += core.slide(*(axis[part] for axis in events), given, gaps=pauses, stalls=stalls)
    return found


def same(one):
    """All fields but the cycles; ``t_first`` means nothing without events."""
    values = {f.name: getattr(one, f.name) for f in dataclasses.fields(one) if f.name != "regions"}
    region = {f.name: getattr(one, f.name) for f in dataclasses.fields(one.regions[0]) if f.name != "cycles"}
    return values | region | {"t_first": one.t_first if one.roi_events else None}


def on_the_sensor(config, rng, events):
    """Events of the image as any of the pixels that are binned to theirs."""
    t, *axes = events
    sizes = config.sensor_width, config.sensor_height
    wide = (at * config.pixel + rng.integers(config.pixel, size=len(at)) if config.binning else at for at in axes)
    return t, *(at.clip(0, size - 1) for at, size in zip(wide, sizes, strict=True))


def compare(wanted, found):
    for k, (one, other) in enumerate(zip(map(same, wanted), map(same, found), strict=False)):
        differ = {name: (one[name], other[name]) for name in one if not (one[name] == other[name])}
        assert not differ, (k, differ)
    assert len(wanted) == len(found)


def compared(core, config, counts, rng):
    """The model's results of so many drawn events each time, which are the core's, whenever events come."""
    given = BatchSettings.from_config(config, roi=CORNER)
    for count in counts:
        events = on_the_sensor(config, rng, drawn(rng, count))
        wanted = list(Sliding(config, given).run(*events))
        for waits in (False, True):
            compare(wanted, played(core, given, events, rng, waits=waits))
        yield wanted


@pytest.fixture(scope="module")
def cores():
    made = {}
    yield lambda config: made.setdefault(config.hardware_hash, VerilatedCore(config))
    for core in made.values():
        core.close()


@pytest.mark.parametrize("name", CASES)
def test_hops_equal_the_model(name, cores, rng):
    config, degenerate = CASES[name], 0
    shares = config.hop_events < config.window_events  # what follows a window has events of the one before
    follows = shares and bool(BatchSettings.from_config(config).follow)
    for wanted in compared(cores(config), config, (700, 700, 2500), rng):
        degenerate += sum(Flag.DEGENERATE in one.flags for one in wanted)
        assert len(wanted) > 20 and any(one.late for one in wanted) == follows
    assert degenerate > 2


#: Longer and shorter windows, some with hops of another length, or that never close by time.
CHANGES = (
    {"window_events": 40, "hop_events": 5}, {"window_events": 127, "window_us": 2500}, {"hop_us": 0},
    {"window_us": 900, "hop_us": 200}, {"hop_events": 15, "min_roi_events": 30}, {"window_us": 0, "hop_us": 500},
    {"window_events": 16, "hop_events": 16, "min_roi_events": 4},
)  # fmt: skip


def compared_with_changes(core, given, rng, *, waits):
    """Hops of the core, whose lengths change time and again between two events, are the model's; how many there are."""
    events, lengths, hops = drawn(rng, 4000), given, 0
    core.reset()
    sliding = Sliding(core.config, given)
    for a, b in itertools.pairwise([0, *sorted(rng.integers(0, len(events[0]), 40)), len(events[0])]):
        part = [axis[a:b] for axis in events]
        lengths = dataclasses.replace(given, **CHANGES[rng.integers(len(CHANGES))])
        sliding.take_lengths(lengths)
        gaps, stalls = (rng.integers(0, 60, b - a), rng.integers(0, 50, 50)) if waits else (None, None)
        if b > a:
            wanted = list(sliding.run(*part))
            compare(wanted, core.slide(*part, lengths, gaps=gaps, stalls=stalls))
            hops += len(wanted)
    return hops


@pytest.mark.parametrize("name", ["both", "by number", "two rounds", "one evaluator"])
@pytest.mark.parametrize("waits", [False, True])
def test_lengths_change_between_two_hops(name, waits, cores, rng):
    config = CASES[name]
    given = BatchSettings.from_config(config, roi=CORNER)
    assert compared_with_changes(cores(config), given, rng, waits=waits) > 100


def test_an_undistorted_event_on_the_sensors_last_column(cores, rng):
    """Where the sensor's side is a power of two, half a pixel and the dither take it behind the last place."""
    config = CASES["all that may stand in front"].replace(sensor_width=16, background=0, hot_pixels=0)
    t, _, y = drawn(rng, 700)
    x = np.where(rng.random(len(t)) < 0.5, 15, rng.integers(0, 16, len(t)))
    given = BatchSettings.from_config(config, roi=(0, 5))
    wanted = list(Sliding(config, given).run(t, x, y))
    assert len(wanted) > 20
    compare(wanted, played(cores(config), given, (t, x, y), rng, waits=False))


def test_an_image_far_from_its_first_events(cores, rng):
    """A fast object on a wide sensor: the image lies six ROIs ahead of where the window's first events were."""
    config = CASES["by number"].replace(
        sensor_width=320, sensor_height=240, window_events=4, hop_events=3, min_roi_events=2, v_int=8,
        cold="0:1:1/8", follow="0:1:1/8",
    )  # fmt: skip
    given = dataclasses.replace(BatchSettings.from_config(config, roi=(100, 90)), v_start=(6400, 0))
    t, x, y = np.arange(2000) * 20, rng.integers(100, 320, 2000), rng.integers(85, 105, 2000)
    wanted = list(Sliding(config, given).run(t, x, y))
    assert any(one.sums[0] and abs(one.v[0]) > 99 for one in wanted)  # by an event that came from there
    compare(wanted, played(cores(config), given, (t, x, y), rng, waits=False))
