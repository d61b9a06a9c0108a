"""The engines behind their one interface: equal results, and what they refuse."""

from dataclasses import replace

import numpy as np
import pytest
from studies.crosscheck.batches import random_events, random_settings

from cmfpga import engines
from cmfpga.config import preset
from cmfpga.engines import ENGINES, make_engine
from cmfpga.engines.model import ModelEngine
from cmfpga.engines.rtl import AmaranthEngine, VerilatedEngine
from cmfpga.errors import ConfigError
from cmfpga.events import Events
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.regions import Region
from cmfpga.protocol.results import COUNTS
from cmfpga.protocol.settings import BatchSettings
from support.designs import HARDWARE
from support.small_core import CONFIG, engine_of, make_events, settings, without_cycles


@pytest.fixture(params=ENGINES)
def engine(request):
    """Each of the three engines, without a batch yet."""
    return request.getfixturevalue("verilated_engine") if request.param == "rtl" else make_engine(request.param, CONFIG)


def sequence(rng):
    """``(name, events, settings, flags that must be set)``: a life of the core, one batch after the other."""
    steps = np.arange(25)
    at_rest = Events(np.arange(100), np.full(100, 10), np.full(100, 10), np.zeros(100))
    return [
        ("first", make_events(rng, 60), settings((8, 8)), Flag(0)),
        ("follows", make_events(rng, 60), settings(), Flag(0)),
        ("empty, new ROI", make_events(rng, 0), settings((9, 7)), Flag.DEGENERATE),
        ("empty, newer ROI", make_events(rng, 0), settings((8, 6)), Flag.DEGENERATE),
        ("the ROI waited", make_events(rng, 60), settings(), Flag(0)),
        ("largest", make_events(rng, 100), settings(), Flag(0)),
        ("one event", make_events(rng, 1), settings(), Flag.DEGENERATE),
        ("one moment", make_events(rng, 60, np.full(60, 7)), settings(), Flag.DEGENERATE),
        ("no iterations", make_events(rng, 60), settings(iterations=0), Flag.DEGENERATE),
        ("too few in the ROI", make_events(rng, 20), settings(min_roi_events=21), Flag.DEGENERATE),
        ("time beyond the span", make_events(rng, 60, np.arange(60) * 50), settings(), Flag.TIME_SPAN),
        ("time steps back", make_events(rng, 60, rng.integers(0, 99, 60)), settings(), Flag.TIME_BACK),
        ("time wraps", make_events(rng, 60, np.arange(60) + 65500), settings(), Flag(0)),
        ("negative time", make_events(rng, 60, np.arange(60) - 30), settings(), Flag(0)),
        ("gap of half a wrap", make_events(rng, 50, np.r_[steps, steps + 40000]), settings(), Flag.TIME_BACK),
        ("buffer full", at_rest, settings((8, 8)), Flag.OVERFLOW),
        ("v out of its range", make_events(rng, 80), settings((8, 8), eta=CONFIG.formats.eta.max, iterations=15,
                                                              roi_gain=0), Flag.SATURATED),
        ("ends of v", make_events(rng, 80), settings((8, 8), start_last=False, roi_gain=0,
                                                     v_start=(CONFIG.formats.v.max, CONFIG.formats.v.min)),
         Flag.SATURATED),
        ("to the sensor's edge", make_events(rng, 80), settings((8, 8), v_start=(-30000, 30000), start_last=False,
                                                                roi_gain=CONFIG.formats.roi_gain.max),
         Flag.ROI_CLAMPED),
        ("no step", make_events(rng, 80), settings((8, 8), eta=0, iterations=1, roi_gain=0), Flag(0)),
        ("no events at all in the ROI", make_events(rng, 60), settings((24, 16)), Flag.DEGENERATE),
        ("last", make_events(rng, 60), settings((8, 8), start_last=False), Flag(0)),
    ]  # fmt: skip


NAMES = [step[0] for step in sequence(np.random.default_rng(0))]


@pytest.fixture(scope="module")
def lives(one_core):
    """The sequence's results from the emitted Verilog, Amaranth's simulator, the integer model and the float engine."""
    steps = sequence(np.random.default_rng(7))
    one_core.reset()
    all_engines = (engine_of(one_core), AmaranthEngine(CONFIG), ModelEngine(CONFIG), make_engine("float", CONFIG))
    results = [[engine.run(step[1], step[2])[0] for step in steps] for engine in all_engines]
    return {step[0]: (step, *row) for step, *row in zip(steps, *results, strict=True)}


@pytest.mark.parametrize("name", NAMES)
def test_the_verilog_equals_the_simulator_and_the_model(lives, name):
    (_, events, _, flags), compiled, simulated, model, _ = lives[name]
    assert compiled == simulated  # cycles too
    assert without_cycles(compiled) == model
    assert flags in compiled.flags and bool(flags) == bool(compiled.flags), compiled.flags
    assert compiled.events == len(events) == sum(getattr(compiled, count) for count in COUNTS)


@pytest.mark.parametrize("name", NAMES)
def test_cycles_follow_the_formula(lives, verilated_core, name):
    _, compiled, _, model, floating = lives[name]
    assert model.cycles is None and floating.cycles is None
    if not compiled.events:
        assert compiled.cycles is None  # it never came to the hardware
    elif Flag.DEGENERATE in compiled.flags:
        assert compiled.events < compiled.cycles < compiled.events + 100
    else:
        assert compiled.cycles == verilated_core.core.cycles(
            events=compiled.events, roi_events=compiled.roi_events, iterations=compiled.iterations
        )


@pytest.mark.parametrize("name", ["first", "one moment", "ends of v", "no step", "last"])
def test_the_float_engine_crops_and_counts_the_same(lives, name):
    _, compiled, _, _, floating = lives[name]
    for field in ("events", "span", "roi", "iterations", *COUNTS):
        assert getattr(floating, field) == getattr(compiled, field), field
    assert (floating.flags ^ compiled.flags) & ~Flag.SATURATED == Flag(0)
    if not floating.iterations:
        return
    one = CONFIG.widths.weight_max
    np.testing.assert_allclose(floating.trace.v[0], compiled.trace.v[0] * CONFIG.formats.v.step, atol=0.05)
    np.testing.assert_allclose(floating.trace.sum_i[0], compiled.trace.sum_i[0] / one, atol=0.3)
    np.testing.assert_allclose(floating.trace.s[0], compiled.trace.s[0] / one**2, atol=2)
    assert floating.events == sum(getattr(floating, count) for count in COUNTS)


def test_random_batches(verilated_engine, rng):
    """Verilog and model through many batches with random settings, v and the ROI carried over."""
    model = ModelEngine(CONFIG)
    seen = Flag(0)
    for index in range(60):
        chosen, roi = random_settings(CONFIG, rng, model.places[0])
        _, events = random_events(CONFIG, rng, roi)
        compiled, expected = (engine.run(events, chosen)[0] for engine in (verilated_engine, model))
        assert without_cycles(compiled) == expected, f"batch {index}"
        assert verilated_engine.places == model.places == [expected.roi_next]
        seen |= expected.flags
    assert set(seen) == set(Flag) - {Flag.CUT, Flag.SCHEDULE, Flag.DOUBTFUL, Flag.SHORT}


def test_amaranth_simulates_the_fast_hardware_too(rng):
    """Rounds, levels, dither, one pass; schedules that change. (Its Verilog: tests/verilog/simulation.)"""
    config = preset("fast").replace(
        **HARDWARE, cold="2:2:2*2 1:1:1 0:3/4:1/2", warm="1:1:1 0:3/4:1/4", cold_after_doubtful=0, roi_gain=0.0
    )
    simulated, model = AmaranthEngine(config), ModelEngine(config)
    other = config.replace(cold="0:1:1*3", warm="0:3/4:1/2*5 1:1:1/4")
    results = []
    for fields, roi, count in (
        (config, (8, 8), 60), (config, None, 60), (other, None, 0), (other, None, 90), (config, (9, 7), 70),
        (other.replace(start="zero"), None, 80),
    ):  # fmt: skip
        events = make_events(rng, count)
        result = simulated.run(events, BatchSettings.from_config(fields, roi))[0]
        assert without_cycles(result) == model.run(events, BatchSettings.from_config(fields, roi))[0]
        results.append(result)
    assert [result.iterations for result in results] == [4, 2, 0, 6, 4, 3]  # a new ROI starts cold
    assert all(result.flags & ~(Flag.ROI_CLAMPED | Flag.DOUBTFUL) == Flag(0) for result in results if result.events)
    assert all((result.cycles is None) == (not result.events) for result in results)


def test_names(engine):
    assert engine.name in ENGINES and engine.note == ""
    assert engine.places == [(0, 0)] and engine.run(Events.empty(), settings())[0].v == (0.0, 0.0)


def test_unknown_engine():
    with pytest.raises(ConfigError, match=r"^engine 'gpu': one of rtl, model, float, axi, serial:PORT is needed$"):
        make_engine("gpu", CONFIG)
    assert ENGINES == ("rtl", "model", "float")  # axi has no trace


def test_an_empty_batch_changes_nothing(engine, rng):
    first = engine.run(make_events(rng, 60), settings((8, 8)))[0]
    empty = engine.run(Events.empty(), settings())[0]
    assert empty.flags == Flag.DEGENERATE and empty.cycles is None and empty.iterations == 0 and empty.span == 0
    assert [empty.events, *(getattr(empty, count) for count in COUNTS)] == [0] * 7
    assert empty.roi == empty.roi_next == first.roi_next
    assert empty.v == first.v != (0.0, 0.0)
    last, trace = vars(first.trace), vars(empty.trace)
    assert trace["v"].tolist() == last["v"][-1:].tolist()  # T + 1 rows, T = 0, as of a batch with too few events
    for name, values in trace.items():
        assert values.dtype == last[name].dtype and values.shape[1:] == last[name].shape[1:]
        assert len(values) == (name == "v")
    after = engine.run(make_events(rng, 60), settings())[0]
    assert after.roi == first.roi_next
    start = tuple(after.trace.v[0] * (1 if engine.name == "float" else CONFIG.formats.v.step))
    assert start == first.v


def test_a_waiting_roi_is_used_once(engine, rng):
    engine.run(Events.empty(), settings((20, 10)))
    assert engine.places == [(20, 10)]
    engine.run(Events.empty(), settings((8, 7)))
    used = engine.run(make_events(rng, 60), settings(start_last=False, v_start=(8192, 4096), eta=0))[0]
    assert used.roi == (8, 7) and used.roi_next == (12, 9)  # 2 · (2, 1) px on
    assert engine.run(make_events(rng, 60), settings())[0].roi == (12, 9)


@pytest.mark.parametrize("corner", [(25, 0), (0, 17), (24, 17), (-1, 3), (3, -1), (10**30, 0)], ids=str)
def test_an_roi_outside_the_sensor_is_refused(engine, rng, corner):
    message = f"ROI at {corner[0]},{corner[1]}: 0,0 to 24,16 is needed for 8×8 px on a sensor of 32×24 px"
    for events in (make_events(rng, 60), Events.empty()):
        with pytest.raises(ConfigError) as caught:
            engine.run(events, settings(corner))
        assert str(caught.value) == message
    assert engine.places == [(0, 0)]
    assert engine.run(make_events(rng, 60), settings((24, 16)))[0].roi == (24, 16)


def test_rows_that_a_core_of_one_roi_has_not(engine, rng):
    """Its table has one row, which may be written, and is as large as the ROI."""
    row = Region.roi(CONFIG, (8, 8))
    for rows in ([], [row, row], [replace(row, width=4)], [replace(row, moves=False)]):
        with pytest.raises(ConfigError, match=r"^regions = 0: the table has one row, which is as large as the ROI"):
            engine.write(rows)
    engine.write([row])
    first = engine.run(make_events(rng, 60), settings(start_last=False, v_start=(8192, 4096), eta=0))[0]
    engine.write([row])  # it goes on where it has moved to
    assert first.roi == (8, 8) and engine.places == [first.roi_next] == [(12, 10)]
    engine.write([row], {0})
    assert engine.places == [(8, 8)] and engine.run(make_events(rng, 60), settings())[0].roi == (8, 8)


def test_a_batch_that_is_too_large_is_refused(engine, rng):
    with pytest.raises(ConfigError, match=r"^a batch of 101 events: at most 100 are allowed \(max_batch_events\)$"):
        engine.run(make_events(rng, 101), settings((8, 8)))
    assert engine.places == [(0, 0)]
    assert engine.run(make_events(rng, 100), settings((8, 8)))[0].events == 100


@pytest.mark.parametrize("axis, value, largest", [("x", 32, 31), ("y", 24, 23), ("x", 40, 31), ("y", 65535, 23)])
def test_an_event_outside_the_sensor_is_refused(engine, rng, axis, value, largest):
    """The hardware has no bits for it: x = 40 would be 8, which is in the ROI."""
    events = make_events(rng, 60)
    getattr(events, axis)[33] = value
    message = rf"^{axis} of an event is {value}: 0 to {largest} is allowed on .* 32×24 px "
    with pytest.raises(ConfigError, match=message):
        engine.run(events, settings((8, 8)))
    getattr(events, axis)[33] = largest
    assert engine.run(events, settings((8, 8)))[0].outside > 0


def test_without_a_compiler_amaranth_simulates(monkeypatch, rng):
    monkeypatch.setattr(engines, "cannot_compile", lambda: "no C++ compiler found")
    engine = make_engine("rtl", CONFIG)
    assert type(engine) is AmaranthEngine and engine.name == "rtl"
    assert engine.note.startswith("no C++ compiler found: using Amaranth's simulator")
    result = engine.run(make_events(rng, 30), settings((8, 8)))[0]
    assert result.cycles == engine.core.cycles(events=30, roi_events=result.roi_events, iterations=3)
    engine.close()


def test_with_a_compiler_it_is_the_verilog(compiler, monkeypatch):
    monkeypatch.setattr("cmfpga.engines.rtl.VerilatedCore", lambda config: config)
    engine = make_engine("rtl", CONFIG)
    assert type(engine) is VerilatedEngine and engine.note == "" and engine._core is CONFIG
