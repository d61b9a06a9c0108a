"""The engines behind their one interface: equal results, what they refuse, and where compiled simulators are kept."""

import dataclasses
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from amaranth.hdl import Signal

from cmfpga import engines
from cmfpga.config import Config, preset
from cmfpga.engines import ENGINES, check_roi, make_engine, rtl, verilated
from cmfpga.engines.amaranth_sim import AmaranthEngine
from cmfpga.engines.model import ModelEngine
from cmfpga.engines.verilated import VerilatedCore, VerilatedEngine
from cmfpga.errors import ConfigError
from cmfpga.events import Events
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.settings import BatchSettings, settings_values
from cmfpga.verilog import compile as library
from cmfpga.verilog.compile import compile_library
from cmfpga.verilog.emit import cache_folder

# The hardware of tests/cli too, so that one compilation serves both.
HARDWARE = {
    "sensor_width": 32, "sensor_height": 24, "roi_width": 8, "roi_height": 8, "buffer_events": 96,
    "max_batch_events": 100, "time_bits": 16, "span_bits": 10, "max_iterations": 15, "v_int": 3,
}  # fmt: skip
CONFIG = Config(**HARDWARE, iterations=3)
COUNTS = ("roi_events", "outside", "overflow", "time_back", "time_span")


@pytest.fixture
def compiler():
    if rtl.find_compiler() is None:
        pytest.skip("no C++ compiler")


@pytest.fixture(scope="module")
def verilated_core():
    """One simulated core for all tests, each of which begins with a reset."""
    if rtl.find_compiler() is None:
        pytest.skip("no C++ compiler")
    core = VerilatedCore(CONFIG)
    yield core
    core.close()


@pytest.fixture
def verilated_engine(verilated_core):
    verilated_core.reset()
    engine = VerilatedEngine.__new__(VerilatedEngine)  # without emitting the Verilog again to look the library up
    rtl.RtlEngine.__init__(engine, CONFIG)
    engine._core = verilated_core
    return engine


@pytest.fixture(params=ENGINES)
def engine(request):
    """Each of the three engines, without a batch yet."""
    return request.getfixturevalue("verilated_engine") if request.param == "rtl" else make_engine(request.param, CONFIG)


def make_events(rng, count, t=None, right=20, bottom=16):
    t = np.sort(rng.integers(0, 1000, count)) if t is None else t
    return Events(t, rng.integers(4, right, count), rng.integers(4, bottom, count), np.zeros(count))


def settings(roi=None, **changes):
    return dataclasses.replace(BatchSettings.from_config(CONFIG, roi), **changes)


def without_cycles(result):
    return dataclasses.replace(result, cycles=None)


# ---------------------------------------------------------------- equal results


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
def lives(verilated_core):
    """The sequence's results from the emitted Verilog, Amaranth's simulator, the integer model and the float engine."""
    steps = sequence(np.random.default_rng(7))
    verilated_core.reset()
    compiled = VerilatedEngine.__new__(VerilatedEngine)
    rtl.RtlEngine.__init__(compiled, CONFIG)
    compiled._core = verilated_core
    all_engines = (compiled, AmaranthEngine(CONFIG), ModelEngine(CONFIG), make_engine("float", CONFIG))
    results = [[engine.run(step[1], step[2]) for step in steps] for engine in all_engines]
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
        events = make_events(rng, int(rng.integers(0, 101)), right=rng.integers(6, 21), bottom=rng.integers(6, 17))
        changes = {
            "iterations": int(rng.integers(0, 16)),
            "eta": int(rng.integers(CONFIG.formats.eta.max + 1) >> rng.integers(0, 3)),
            "roi_gain": int(rng.integers(CONFIG.formats.roi_gain.max + 1)),
            "start_last": bool(rng.integers(2)),
            "v_start": tuple(int(v) >> 3 for v in rng.integers(CONFIG.formats.v.min, CONFIG.formats.v.max + 1, 2)),
            "min_roi_events": int(rng.integers(1, 12)),
        }
        roi = (int(rng.integers(12)), int(rng.integers(12))) if rng.random() < 0.7 else None
        compiled, expected = (e.run(events, settings(roi, **changes)) for e in (verilated_engine, model))
        assert without_cycles(compiled) == expected, f"batch {index}"
        assert verilated_engine.roi == model.roi == expected.roi_next
        assert verilated_engine.v == model.v == expected.v
        seen |= expected.flags
    assert seen == Flag.DEGENERATE | Flag.OVERFLOW | Flag.SATURATED | Flag.ROI_CLAMPED


def test_amaranth_simulates_the_fast_hardware_too(rng):
    """Signs, levels, dither, one pass; schedules that change from batch to batch. (Its Verilog: tests/simulation.)"""
    config = preset("fast").replace(**HARDWARE, iterations=3, cold="2:1*2 1:0 0:-1", warm="1:0 0:-2")
    simulated, model = AmaranthEngine(config), ModelEngine(config)
    other = config.replace(cold="0:0*3", warm="0:-1*5 1:-2")
    results = []
    for fields, roi, count in (
        (config, (8, 8), 60), (config, None, 60), (other, None, 0), (other, None, 90), (config, (9, 7), 70),
        (other.replace(start="zero"), None, 80),
    ):  # fmt: skip
        events = make_events(rng, count)
        result = simulated.run(events, BatchSettings.from_config(fields, roi))
        assert without_cycles(result) == model.run(events, BatchSettings.from_config(fields, roi))
        results.append(result)
    assert [result.iterations for result in results] == [4, 2, 0, 6, 4, 3]  # a new ROI starts cold
    assert all(result.flags & ~Flag.ROI_CLAMPED == Flag(0) for result in results if result.events)
    assert all((result.cycles is None) == (not result.events) for result in results)


# ---------------------------------------------------------------- the interface


def test_names(engine):
    assert engine.name in ENGINES and engine.note == ""
    assert engine.roi == (0, 0) and engine.v == (0.0, 0.0)


def test_unknown_engine():
    with pytest.raises(ConfigError, match=r"^engine 'gpu': one of rtl, model, float, axi is needed$"):
        make_engine("gpu", CONFIG)


def test_an_empty_batch_changes_nothing(engine, rng):
    first = engine.run(make_events(rng, 60), settings((8, 8)))
    empty = engine.run(Events.empty(), settings())
    assert empty.flags == Flag.DEGENERATE and empty.cycles is None and empty.iterations == 0 and empty.span == 0
    assert [empty.events, *(getattr(empty, count) for count in COUNTS)] == [0] * 6
    assert empty.roi == empty.roi_next == first.roi_next
    assert empty.v == first.v != (0.0, 0.0)
    last, trace = first.trace, empty.trace
    assert trace.v.tolist() == last.v[-1:].tolist()  # T + 1 rows, T = 0, as of a batch with too few events
    assert [(each.shape, each.dtype) for each in (trace.sum_i, trace.sum_d, trace.s)] == [
        ((0, *each.shape[1:]), each.dtype) for each in (last.sum_i, last.sum_d, last.s)
    ]
    assert trace.v.dtype == last.v.dtype
    after = engine.run(make_events(rng, 60), settings())
    assert after.roi == first.roi_next
    start = tuple(after.trace.v[0] * (1 if engine.name == "float" else CONFIG.formats.v.step))
    assert start == first.v


def test_a_waiting_roi_is_used_once(engine, rng):
    engine.run(Events.empty(), settings((20, 10)))
    assert engine.roi == (20, 10)
    engine.run(Events.empty(), settings((8, 7)))
    used = engine.run(make_events(rng, 60), settings(start_last=False, v_start=(8192, 4096), eta=0))
    assert used.roi == (8, 7) and used.roi_next == (12, 9)  # 2 · (2, 1) px on
    assert engine.run(make_events(rng, 60), settings()).roi == (12, 9)


@pytest.mark.parametrize("corner", [(25, 0), (0, 17), (-1, 3), (3, -1), (10**30, 0)], ids=str)
def test_an_roi_outside_the_sensor_is_refused(engine, rng, corner):
    message = f"ROI at {corner[0]},{corner[1]}: 0,0 to 24,16 is needed for 8×8 px on a sensor of 32×24 px"
    for events in (make_events(rng, 60), Events.empty()):
        with pytest.raises(ConfigError) as caught:
            engine.run(events, settings(corner))
        assert str(caught.value) == message
    assert engine.roi == (0, 0)
    assert engine.run(make_events(rng, 60), settings((24, 16))).roi == (24, 16)


def test_check_roi_alone():
    check_roi(CONFIG, (24, 16))
    with pytest.raises(ConfigError, match=r"^ROI at 24,17: 0,0 to 24,16 is needed "):
        check_roi(CONFIG, (24, 17))


def test_a_batch_that_is_too_large_is_refused(engine, rng):
    with pytest.raises(ConfigError, match=r"^a batch of 101 events: at most 100 are allowed \(max_batch_events\)$"):
        engine.run(make_events(rng, 101), settings((8, 8)))
    assert engine.roi == (0, 0)
    assert engine.run(make_events(rng, 100), settings((8, 8))).events == 100


@pytest.mark.parametrize("axis, value, largest", [("x", 32, 31), ("y", 24, 23), ("x", 40, 31), ("y", 65535, 23)])
def test_an_event_outside_the_sensor_is_refused(engine, rng, axis, value, largest):
    """The hardware has no bits for it: x = 40 would be 8, which is in the ROI."""
    events = make_events(rng, 60)
    getattr(events, axis)[33] = value
    with pytest.raises(
        ConfigError, match=rf"^{axis} of an event is {value}: 0 to {largest} is allowed on .* 32×24 px "
    ):
        engine.run(events, settings((8, 8)))
    getattr(events, axis)[33] = largest
    assert engine.run(events, settings((8, 8))).outside > 0


# ---------------------------------------------------------------- the simulated core


def core_run(core, events, **options):
    values = settings_values(CONFIG, settings((8, 8)))
    return core.run(events.t, events.x, events.y, values, **options)


def test_the_test_bench_counts_the_same_cycles(verilated_core, rng):
    verilated_core.reset()
    events = make_events(rng, 40)
    waited, _, _ = core_run(verilated_core, events)
    # After a reset, before events are accepted: the sweep of 16 words, and until its sums have settled.
    assert waited["measured_cycles"] == waited["cycles"] + 16 + 8
    plain, _, none = core_run(verilated_core, events)
    assert plain["cycles"] == plain["measured_cycles"] and plain["accepted"] == 40 and none is None
    gaps = rng.integers(0, 4, 40)
    slow, _, _ = core_run(verilated_core, events, gaps=gaps, result_stall=5)
    assert slow["measured_cycles"] == plain["measured_cycles"] + gaps[1:].sum()


def test_the_pixels_of_every_sweep(verilated_core, rng):
    verilated_core.reset()
    _, trace, pixels = core_run(verilated_core, make_events(rng, 40), keep_pixels=True)
    assert pixels.shape == (3, 16, 12) and trace.shape == (3, 7)
    for bank in range(4):
        assert verilated_core.pixel_names[3 * bank].endswith("_i")
    np.testing.assert_array_equal(pixels[:, :, 0::3].sum(axis=(1, 2)), trace[:, 2])
    np.testing.assert_array_equal(pixels[:, :, 1::3].sum(axis=(1, 2)), trace[:, 3])


def test_giving_up_says_what_is_missing(verilated_core, rng):
    events = make_events(rng, 40)
    for options, message in (
        ({"max_cycles": 20}, r"no result after 20 clock cycles: \d+ of 40 events accepted, 0 of 3 iterations seen"),
        ({"open_end": True}, r"no result after \d+ clock cycles: 40 of 40 events accepted, 0 of 3 iterations seen"),
    ):
        verilated_core.reset()
        with pytest.raises(TimeoutError, match=message):
            core_run(verilated_core, events, **options)
    verilated_core.reset()
    assert core_run(verilated_core, events)[0]["accepted"] == 40


def test_a_reset_forgets_v_and_the_roi(verilated_core, verilated_engine, rng):
    before = verilated_engine.run(make_events(rng, 60), settings((8, 8)))
    assert before.v != (0.0, 0.0)
    verilated_core.reset()
    after = verilated_engine.run(make_events(rng, 60), settings(min_roi_events=32))
    assert Flag.DEGENERATE in after.flags and after.v == (0.0, 0.0) and after.roi == (0, 0)


def test_a_closed_core_is_not_used(compiler, rng):
    core = VerilatedCore(CONFIG, seed=5)
    core.close()
    core.close()  # safe
    for use in (
        core.reset,
        lambda: core_run(core, make_events(rng, 3)),
        lambda: core.write_schedule(((0, 1),)),
    ):
        with pytest.raises(ValueError, match="closed"):
            use()


def test_random_contents_of_memories_do_not_matter(compiler, verilated_core, rng):
    verilated_core.reset()
    events = make_events(rng, 60)
    other = VerilatedCore(CONFIG, seed=99)
    (a, trace_a, _), (b, trace_b, _) = core_run(verilated_core, events), core_run(other, events)
    assert a == b
    np.testing.assert_array_equal(trace_a, trace_b)
    other.close()


# ---------------------------------------------------------------- compiler and cache


def test_without_a_compiler_amaranth_simulates(monkeypatch, rng):
    monkeypatch.setattr(rtl, "find_compiler", lambda: None)
    engine = make_engine("rtl", CONFIG)
    assert type(engine) is AmaranthEngine and engine.name == "rtl"
    assert engine.note.startswith("no C++ compiler found: using Amaranth's simulator")
    result = engine.run(make_events(rng, 30), settings((8, 8)))
    assert result.cycles == engine.core.cycles(events=30, roi_events=result.roi_events, iterations=3)
    engine.close()


def test_which_compiler_is_found(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert rtl.find_compiler() is None
    for name in ("clang++", "g++", "c++"):  # the preferred one last
        (tmp_path / name).write_text("#!/bin/sh\n")
        assert shutil.which(name) is None
        (tmp_path / name).chmod(0o755)
        assert rtl.find_compiler() == str(tmp_path / name)


def test_with_a_compiler_it_is_the_verilog(compiler, monkeypatch):
    monkeypatch.setattr(verilated, "VerilatedCore", lambda config: config)
    engine = make_engine("rtl", CONFIG)
    assert type(engine) is VerilatedEngine and engine.note == "" and engine._core is CONFIG


def test_cache_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("CMFPGA_CACHE", str(tmp_path / "mine"))
    assert cache_folder() == tmp_path / "mine"
    for unset in ("", None):
        if unset is None:
            monkeypatch.delenv("CMFPGA_CACHE")
        else:
            monkeypatch.setenv("CMFPGA_CACHE", unset)
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
        assert cache_folder().name == "cmfpga" and cache_folder() != tmp_path / "mine"


@pytest.fixture
def builds(monkeypatch, tmp_path):
    """Compilations, as a list, that are only pretended; the cache is empty."""
    made = []

    def pretend(compiler, scratch, library):
        assert (scratch / "cmfpga_core.v").exists() and (scratch / "ports.inc").exists()
        made.append(library.name)
        library.write_text("not a library")

    monkeypatch.setenv("CMFPGA_CACHE", str(tmp_path / "new" / "cache"))
    monkeypatch.setattr(library, "_verilate", lambda scratch, top: None)
    monkeypatch.setattr(library, "_compile", pretend)
    # The text of the hardware: what matters here is only when it changes.
    monkeypatch.setattr(library, "emit_verilog", lambda core: f"// {core.config.hardware_hash}\n")
    monkeypatch.setattr(library, "find_compiler", lambda: "echo")
    return made


def fake_core(config):
    """What :func:`compile_library` needs of a core, which Amaranth would warn of if it were not elaborated."""
    ports = {f"event_{name}": Signal(4) for name in ("t", "x", "y", "last")}
    return SimpleNamespace(config=config, inputs=ports, outputs={})


def test_the_cache_is_reused(builds, tmp_path):
    library = compile_library(fake_core(CONFIG))
    assert library.parent == tmp_path / "new" / "cache" and library.read_text() == "not a library"
    assert compile_library(fake_core(CONFIG.replace(iterations=7, eta=0.5, start="zero"))) == library
    assert len(builds) == 1
    kept = {path.name for path in library.parent.iterdir()}
    assert kept == {f"{library.stem}{suffix}" for suffix in (".so", ".sha256", ".lock")}  # no scratch left


def test_the_cache_is_not_reused_for_anything_else(builds, monkeypatch):
    first = compile_library(fake_core(CONFIG))
    other = compile_library(fake_core(CONFIG.replace(buffer_events=33)))
    monkeypatch.setattr(library, "find_compiler", lambda: "false-echo")
    monkeypatch.setattr(
        library.subprocess, "run", lambda *_, **__: library.subprocess.CompletedProcess([], 0, "other version", "")
    )
    newer = compile_library(fake_core(CONFIG))
    assert len({first, other, newer}) == 3 and len(builds) == 3


@pytest.mark.parametrize("damage", ["cut", "changed", "without digest", "digest cut"])
def test_a_damaged_library_is_made_again(builds, damage):
    library = compile_library(fake_core(CONFIG))
    digest = library.with_suffix(".sha256")
    if damage in ("cut", "changed"):
        library.write_text("not a" if damage == "cut" else "not a libramy")
    elif damage == "digest cut":
        digest.write_text(digest.read_text()[:32])
    else:
        digest.unlink()
    assert compile_library(fake_core(CONFIG)) == library and library.read_text() == "not a library"
    assert len(builds) == 2
    assert compile_library(fake_core(CONFIG)) == library and len(builds) == 2


def test_a_library_that_cannot_be_loaded(tmp_path):
    (tmp_path / "a.so").write_text("not a library")
    with pytest.raises(library.CompilerError, match=r"^the compiled Verilog cannot be loaded: .*/a\.so"):
        library.load(tmp_path / "a.so")


@pytest.fixture
def cxx(monkeypatch, tmp_path):
    """``cxx(lines)``: a script as the C++ compiler, by CXX; its path. Verilator is not run, the cache is empty."""

    def cxx(lines):
        path = tmp_path / "my c++"
        path.write_text(f"#!/bin/sh\n{lines}\n")
        path.chmod(0o755)
        monkeypatch.setenv("CXX", f"'{path}' --own")
        return path

    monkeypatch.setenv("CMFPGA_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(library, "_verilate", lambda scratch, top: None)
    return cxx


@pytest.mark.parametrize(
    "lines, message",
    [
        ("exit 1", "fails with status 1: it does not say why"),
        ("echo no license >&2; exit 3", "fails with status 3: no license"),
        ('[ "$2" = --version ] && exit; echo in file; echo an Error here; echo more; exit 1',
         "fails with status 1: an Error here"),
        ("chmod -x \"$0\"", "cannot be run: Permission denied"),
    ],
    ids=["silent", "version", "compiling", "not run"],
)  # fmt: skip
def test_a_compiler_that_fails(cxx, lines, message, rng):
    """One line, and the slow simulator; what cannot do with that one says the line."""
    path = cxx(lines)
    line = f"the C++ compiler {path} {message}"
    engine = make_engine("rtl", CONFIG.replace(buffer_events=34))
    assert type(engine) is AmaranthEngine and engine.note.startswith(f"{line}: using Amaranth's simulator, ")
    assert engine.run(make_events(rng, 10), settings((8, 8))).events == 10
    engine.close()
    with pytest.raises(library.CompilerError) as caught:
        make_engine("axi", CONFIG.replace(buffer_events=34))
    assert str(caught.value) == line


def test_cxx_goes_before_the_others(compiler, cxx, monkeypatch):
    path = cxx('echo "mine $1"')
    assert library.require_compiler() == ([str(path), "--own"], "mine --own\n")
    monkeypatch.setenv("CXX", "'")
    with pytest.raises(library.CompilerError, match=r"^CXX=': No closing quotation$"):
        library.require_compiler()
    monkeypatch.setenv("CXX", " ")
    assert rtl.find_compiler() and rtl.find_compiler() != " "


def test_a_failed_compilation_leaves_nothing(builds, monkeypatch, tmp_path):
    def fail(*_):
        raise RuntimeError("c++ failed")

    monkeypatch.setattr(library, "_compile", fail)
    with pytest.raises(RuntimeError, match="failed"):
        compile_library(fake_core(CONFIG))
    assert {path.suffix for path in (tmp_path / "new" / "cache").iterdir()} <= {".lock"}


def test_a_cache_that_cannot_be_made(builds, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("CMFPGA_CACHE", str(tmp_path / "file"))
    with pytest.raises(ConfigError, match=r"^\S+/file: cannot be made, .*; CMFPGA_CACHE may name another folder$"):
        compile_library(fake_core(CONFIG))


def test_without_a_home_the_cache_is_temporary(monkeypatch, caplog):
    monkeypatch.delenv("CMFPGA_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null")
    folder = cache_folder()
    assert folder == cache_folder() and folder.is_dir() and folder.stat().st_mode & 0o077 == 0
    (line,) = caplog.messages
    assert line == (
        f"note: /dev/null/cmfpga cannot be written: what is compiled is kept in {folder} until this process ends; "
        "CMFPGA_CACHE may name a folder that stays"
    )


def test_a_cached_library_is_loaded_from_the_cache(compiler, verilated_core, monkeypatch, tmp_path, rng):
    """The real one, put into an empty cache: neither Verilator nor the compiler runs."""
    for suffix in (".so", ".sha256"):
        shutil.copy(Path(verilated_core._library._name).with_suffix(suffix), tmp_path)

    def fail(*_):
        raise AssertionError("compiled again")

    monkeypatch.setenv("CMFPGA_CACHE", str(tmp_path))
    monkeypatch.setattr(library, "_verilate", fail)
    engine = make_engine("rtl", CONFIG)
    assert isinstance(engine, VerilatedEngine) and engine._core._library._name.startswith(str(tmp_path))
    events = make_events(rng, 60)
    assert without_cycles(engine.run(events, settings((8, 8)))) == ModelEngine(CONFIG).run(events, settings((8, 8)))
    engine.close()


def test_the_failure_of_a_tool_is_shown():
    with pytest.raises(RuntimeError, match=r"(?s)^sh failed:\n.*broken"):
        library._check_call(["/bin/sh", "-c", "echo broken >&2; exit 3"])


def test_the_package_says_what_there_is():
    assert engines.ENGINES == ("rtl", "model", "float") and all(hasattr(engines, name) for name in engines.__all__)


TWO_AT_ONCE = """
import sys, time
from types import SimpleNamespace
from amaranth.hdl import Signal
from cmfpga.verilog import compile as module
from cmfpga.config import Config

def compile(compiler, scratch, library):
    with open(sys.argv[1], "a") as log:
        log.write("compiled\\n")
    time.sleep(0.5)
    library.write_text("a library")

module._verilate = lambda scratch, top: None
module._compile = compile
module.emit_verilog = lambda core: "// the same"
module.find_compiler = lambda: "echo"
ports = {f"event_{name}": Signal(4) for name in ("t", "x", "y", "last")}
print(input() + module.compile_library(SimpleNamespace(config=Config(), inputs=ports, outputs={})).read_text())
"""


def test_two_processes_do_not_compile_the_same(tmp_path):
    """The second one waits, and takes what the first one has made."""
    command = [sys.executable, "-c", TWO_AT_ONCE, tmp_path / "log"]
    environment = {**os.environ, "CMFPGA_CACHE": str(tmp_path / "cache")}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": environment}
    with subprocess.Popen(command, **pipes) as one, subprocess.Popen(command, **pipes) as other:
        for process in (one, other):  # both are ready
            process.stdin.write("go: \n")
            process.stdin.flush()
        assert [process.communicate(timeout=60)[0] for process in (one, other)] == ["go: a library\n"] * 2
    assert (tmp_path / "log").read_text() == "compiled\n"


def test_after_the_end(compiler, verilated_core, rng):
    core, events = VerilatedCore(CONFIG), make_events(rng, 5)
    axes, values = (events.t, events.x, events.y), settings_values(CONFIG, settings((8, 8)))
    core.close()
    core.close()
    for use in (core.reset, lambda: core.run(*axes, values), lambda: core.stream([axes], [values]), core.take_waves):
        with pytest.raises(ValueError, match=r"^the simulated core is closed$"):
            use()


def test_the_verilog_is_emitted_once_a_process(compiler, verilated_core, monkeypatch):
    monkeypatch.setattr(library, "emit_verilog", None)
    again = VerilatedCore(CONFIG.replace(iterations=2))
    assert again.core is verilated_core.core and again.config.iterations == 2
    again.close()
