"""``cmfpga build``: the same bytes every time, one module per block, and a true description."""

import hashlib
import json
import os
import re
import runpy
import shutil

import pytest

from cmfpga import __version__
from cmfpga.cli import build
from cmfpga.config import Config
from cmfpga.verilog import emit
from cmfpga.verilog.ports import plain
from support.building import FILES, TINY, TINY_SETS
from support.small_core import sets

REGIONS = {
    "gradient": "one_pass", "ascent": "newton", "border": "whole", "v_frac": 2, "buffers": 2, "regions": 2,
    "max_batch_events": 64,
}  # fmt: skip
FAST = {"gradient": "one_pass", "ascent": "newton", "border": "whole", "v_frac": 6, "max_level": 2, "dither_frac": 4}
COMMON = {
    "ascent", "event_buffer", "gradient", "ingest_control", "iteration_control", "reciprocal", "roi_filter",
    "roi_updater", "thinner", "time_scaler", "voter", "warp",
}  # fmt: skip


def blocks_of(config):
    """Names of the boxes in the diagram."""
    sweep, one_pass = ("accumulator", "gradient_reader"), ("tagged_accumulator", "one_pass_gradient")
    parts = one_pass if config.gradient == "one_pass" else sweep
    blocks = COMMON | {"image", "ascent_velocity", *(f"image_{part}" for part in parts)}
    if config.ascent == "newton":
        blocks = blocks - {"warp", "voter"} | {"evaluators", "ascent_schedule", "means"}
    return blocks | ({"dither"} if config.dither_frac else set())


def contents(folder):
    assert sorted(path.name for path in folder.iterdir()) == sorted(FILES)
    return {name: (folder / name).read_bytes() for name in FILES}


def body(verilog):
    """Without the header, which names the configuration."""
    return [line for line in verilog.splitlines() if not line.startswith(b"//")]


@pytest.fixture(scope="module")
def emitted(command, tmp_path_factory):
    """``emitted(**fields)``: the files of a configuration, each made once."""
    made = {}

    def emitted(**fields):
        key = json.dumps(fields, sort_keys=True)
        if key not in made:
            folder = tmp_path_factory.mktemp("build")
            done = command(build, "--preset", "paper", *sets(fields), "--out", folder)
            assert (done.status, done.err) == (0, "")
            assert done.out.splitlines() == [f"wrote {folder / name}" for name in FILES]
            made[key] = contents(folder)
        return made[key]

    return emitted


def info_of(files):
    return json.loads(files["build-info.json"])


def test_two_processes_write_the_same_bytes(process, emitted, tmp_path):
    """Other hash seeds, other folders, one of them without torch; and a third time in this process."""
    here = emitted(**TINY)
    for seed, without in (("0", ()), ("12345", ("torch",))):
        told = ["build", "--preset", "paper", *TINY_SETS, "--out", f"new/{seed}"]
        done = process(*told, without=without, PYTHONHASHSEED=seed)
        assert (done.status, done.err) == (0, ""), without
        assert contents(tmp_path / "new" / seed) == here


def test_nothing_of_this_machine_is_in_the_files(emitted):
    for name, content in emitted(**TINY).items():
        for trace in (os.getcwd(), os.path.dirname(build.__file__), os.path.expanduser("~") + "/", ".py"):
            assert trace.encode() not in content, name
        assert not re.search(rb"\b\d\d:\d\d:\d\d\b|\b20\d\d-\d\d-\d\d\b", content), "a date"


def test_runtime_fields_do_not_change_the_verilog(emitted):
    base = emitted(**TINY)
    other = emitted(
        **TINY, min_roi_events=3, iterations=7, eta=0.5, start="given", v_start_x=1.5, v_start_y=-1, roi_gain=1,
    )  # fmt: skip
    assert other["cmfpga_core.v"] == base["cmfpga_core.v"]
    assert info_of(other)["configuration_hash"] == info_of(base)["configuration_hash"]
    assert info_of(other)["configuration"]["iterations"] == 7


# Fields that only shape the fast architecture, and words that are others than the default.
FAST_ONLY = ("schedule_entries", "max_level", "tag_bits", "dither_frac", "ram_style", "evaluators")
WORDS = {
    "gradient": "one_pass", "ascent": "newton", "ram_style": "block", "when_full": "thin", "border": "whole",
    "undistortion": "on", "motion": "rotation", "evaluators": 4, "store_style": "ultra", "windows": "sliding",
}  # fmt: skip
# The confidence needs formats of its own.
NEEDED = {"ascent": FAST | {"ascent": "constant"}, "confidence": FAST | {"confidence": 0},
          "background_cell": {"background": 1}, "undistortion_cell": {"undistortion": "on"},
          "undistortion_frac": {"undistortion": "on"}, "windows": FAST,
          "regions": REGIONS | {"regions": 1},
          **{name: REGIONS for name in ("units", "slices", "bin_bits", "store_style")},
          "motion": FAST | {"ascent": "sign", "motion": "similarity", "undistortion": "on", "schedule_entries": 64,
                            "roi_width": 16, "roi_height": 8, "sensor_width": 16, "sensor_height": 8}}  # fmt: skip


@pytest.mark.usefixtures("long_tools")
@pytest.mark.parametrize("name", [name for name in Config().hardware_fields if name != "evt3"])  # in the AXI top alone
def test_hardware_fields_change_the_verilog(emitted, name):
    fields = {**TINY, **(FAST if name in FAST_ONLY else {}), **NEEDED.get(name, {})}
    base = emitted(**fields)
    step = 2 if name in ("roi_width", "roi_height") else 1
    value = WORDS[name] if name in WORDS else {**Config().to_dict(), **fields}[name] + step
    other = emitted(**{**fields, name: value})
    assert body(other["cmfpga_core.v"]) != body(base["cmfpga_core.v"])
    assert info_of(other)["configuration_hash"] != info_of(base)["configuration_hash"]


def test_a_system_yosys_is_not_asked(emitted, command, tmp_path, monkeypatch):
    """Another Yosys would order and name things differently."""
    fake = tmp_path / "bin" / "yosys"
    fake.parent.mkdir()
    fake.write_text("#!/bin/sh\necho 'Yosys 0.99'; exit 1\n")
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", f"{fake.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("AMARANTH_USE_YOSYS", "system")
    assert shutil.which("yosys") == str(fake)
    done = command(build, "--preset", "paper", *TINY_SETS, "--out", tmp_path / "out")
    assert done.status == 0 and contents(tmp_path / "out") == emitted(**TINY)


CONFIGURATIONS = {
    "paper": {}, "tiny": TINY, "fast": TINY | FAST, "2x2": {"roi_width": 2, "roi_height": 2},
    "one event": {**TINY, "buffer_events": 1, "max_batch_events": 1},
    "no power of two": {"sensor_width": 37, "sensor_height": 29, "roi_width": 10, "roi_height": 6, "buffer_events": 77},
    "narrow": {
        **TINY, "dt_frac": 2, "v_int": 1, "v_frac": 1, "position_frac": 1, "weight_frac": 1, "derivative_frac": 1,
        "reciprocal_bits": 4, "gradient_int": 1, "gradient_frac": 4, "eta_int": 1, "eta_frac": 1, "roi_gain_frac": 0,
        "time_bits": 8, "span_bits": 4, "max_iterations": 100,
    },
    "wide": {**TINY, "dt_frac": 16, "v_int": 10, "v_frac": 16, "time_bits": 48, "span_bits": 32, "weight_frac": 12},
    "odd one pass": {**TINY, "gradient": "one_pass", "roi_width": 5, "roi_height": 3},
    "full sensor": {"roi_width": 240, "roi_height": 180},
    "roi is sensor": {"sensor_width": 16, "sensor_height": 12, "roi_width": 16, "roi_height": 12},
}  # fmt: skip


@pytest.fixture(params=[pytest.param(Config(**fields), id=name) for name, fields in CONFIGURATIONS.items()])
def files(request, emitted):
    return emitted(**CONFIGURATIONS[request.node.callspec.id])


def test_one_module_per_block(files):
    text = files["cmfpga_core.v"].decode("ascii")
    modules = re.findall(r"^module (\S+?) ?\(", text, re.MULTILINE)
    blocks = {name.removeprefix("cmfpga_core_") for name in modules if name != "cmfpga_core"}
    assert len(modules) == len(set(modules)) == text.count("\nendmodule\n")
    expected = blocks_of(Config(**info_of(files)["configuration"]))
    assert expected <= blocks
    # What else there is belongs to one of them, such as the banks of the accumulator.
    assert all(name.startswith(tuple(expected)) for name in blocks), blocks - expected
    # All that is instantiated is defined, and the other way round.
    assert set(re.findall(r"^  (cmfpga_core_\w+) +\w+ \(", text, re.MULTILINE)) == set(modules) - {"cmfpga_core"}


def test_the_header_names_version_and_configuration(files):
    text = files["cmfpga_core.v"].decode("ascii")
    assert text.startswith(f"// cmfpga_core: Contrast Maximization for event cameras, emitted by cmfpga {__version__}.")
    header = text.partition("\nmodule ")[0]
    assert info_of(files)["configuration_hash"][:16] in header and "SPDX-License-Identifier: BSD-2-Clause" in header
    # No RAM needs initial contents, and an UltraRAM cannot have any; other words: tests/verilog.
    assert "initial begin\n" not in text and "init =" not in text and " z;" not in text


def test_the_listed_ports_are_those_of_the_top_module(files):
    text = files["cmfpga_core.v"].decode("ascii")
    head = re.search(r"^module cmfpga_core\(\n(.*?)\n\);", text, re.DOTALL | re.MULTILINE)[1]
    declared = re.findall(r"^  (input|output) (?:reg )?(?:\[(\d+):0\] )?(\w+),?  // (.+)$", head, re.MULTILINE)
    listed = info_of(files)["ports"]
    assert len(declared) == head.count("\n") + 1 and [row[2] for row in declared][:2] == ["clk", "rst"]
    told = [(port["direction"], port["bits"], port["name"], plain(port["meaning"])) for port in listed]
    assert [(direction, int(high or 0) + 1, *rest) for direction, high, *rest in declared] == told


def test_the_description_is_that_of_the_configuration(files):
    info = info_of(files)
    config = Config(**info["configuration"])
    assert set(info) == {
        "cmfpga", "amaranth", "yosys", "top", "sha256", "configuration_hash", "configuration", "formats", "latencies",
        "cycles", "ports",
    }  # fmt: skip
    assert info["cmfpga"] == __version__ and info["top"] == "cmfpga_core"
    verilog = files["cmfpga_core.v"]
    assert info["sha256"] == hashlib.sha256(verilog).hexdigest() == emit.sha256(verilog.decode())
    assert info["configuration_hash"] == config.hardware_hash
    assert re.fullmatch(r"0\.5\.\d+", info["amaranth"]) and info["yosys"]
    formats, told = config.formats, info["formats"]
    for name, fmt in (("v", formats.v), ("dt", formats.dt), ("η", formats.eta), ("ROI x", formats.roi_x)):
        assert (told[name]["format"], told[name]["bits"]) == (str(fmt), fmt.width)
    bits = {port["name"]: (port["bits"], port["signed"]) for port in info["ports"]}
    assert bits["event_x"] == (config.geometry.x_bits, False) and bits["event_t"] == (told["t"]["bits"], False)
    assert bits["result_v_x"] == (formats.v.width, True) and bits["settings_eta"] == (formats.eta.width, False)
    if config.gradient == "sweep":
        assert bits["trace_pixels_0_i"] == (told["I"]["bits"], False)
    untimed = {"ingest_control", "iteration_control", "ascent_schedule", "ascent_velocity", "image", "means"}
    assert set(info["latencies"]) == {name.removeprefix("image_") for name in blocks_of(config) - untimed}
    assert all(isinstance(cycles, int) and cycles >= 0 for cycles in info["latencies"].values())


def test_the_formula_of_cycles(files):
    cycles = info_of(files)["cycles"]
    config = Config(**info_of(files)["configuration"])
    turns = 4 if config.ascent == "newton" else 1
    numbers = re.fullmatch(r"N \+ T·\((?:4·)?n \+ ([\d +]+)\) \+ (\d+)", cycles["formula"])
    assert ("4·n" in cycles["formula"]) == (turns == 4)
    each = [int(number) for number in numbers[1].split(" + ")]
    if config.gradient == "sweep":
        assert each[0] == config.roi_width * config.roi_height // 4 and len(each) == 2
    else:
        assert len(each) == 1
    example = cycles["example"]
    assert example["cycles"] == example["N"] + example["T"] * (turns * example["n"] + sum(each)) + int(numbers[2])


def test_the_summary_says_the_same(files):
    info, text = info_of(files), files["build-info.md"].decode()
    config = info["configuration"]
    assert f"ROI {config['roi_width']}×{config['roi_height']} px" in text and f"`{info['cycles']['formula']}`" in text
    assert f"{info['cycles']['example']['cycles']:,} cycles" in text
    for port in info["ports"]:
        assert f"| `{port['name']}` | {port['direction']} | {port['bits']}{' (signed)' * port['signed']} |" in text
    for name, cycles in info["latencies"].items():
        assert f"| {name} | {cycles} |" in text
    for name, fmt in info["formats"].items():
        assert f"| {name} | {fmt['format']} | {fmt['bits']} | {fmt['meaning']} |" in text


def test_paths_as_json(command, tmp_path):
    done = command(build, *TINY_SETS, "--json", "--out", tmp_path / "für €")
    files = json.loads(done.out)["files"]
    assert done.status == 0 and done.err == ""
    assert files == [str(tmp_path / "für €" / name) for name in FILES]
    assert len(contents(tmp_path / "für €")["cmfpga_core.v"]) > 100_000


def test_the_default_folder(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "build").mkdir()
    (tmp_path / "build" / "cmfpga_core.v").write_text("old")
    assert command(build, *TINY_SETS).out.startswith(f"wrote build{os.sep}cmfpga_core.v\n")
    assert (tmp_path / "build" / "cmfpga_core.v").stat().st_size > 100_000


def test_as_a_module(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["build", "--set", "gradient=sweep", "--set", "roi_width=3"])
    with pytest.raises(SystemExit) as caught, pytest.warns(RuntimeWarning, match="found in sys.modules"):
        runpy.run_module("cmfpga.build", run_name="__main__")
    assert caught.value.code == 2
    assert capsys.readouterr().err == "error: roi_width = 3: an even number of pixels is needed by the sweep\n"


@pytest.mark.parametrize("cache", [None, "mine"], ids=["temporary", "named"])
def test_without_a_home(process, tmp_path, cache):
    """Yosys keeps what it compiles in the cache, and nothing else is said."""
    given = {"HOME": "/dev/null", "XDG_CACHE_HOME": "", "CMFPGA_CACHE": cache or ""}
    done = process("build", "--set", "roi_width=8", "--set", "roi_height=8", **given)
    assert done.status == 0 and (tmp_path / "build" / "cmfpga_core.v").exists()
    if cache:
        assert done.err == "" and (tmp_path / cache / "wasmtime").is_dir()
    else:
        assert done.err.startswith("note: /dev/null/.cache/cmfpga cannot be written: ") and done.err.count("\n") == 1
        folder = re.search(r" is kept in (\S+) until ", done.err)[1]
        assert not os.path.exists(folder)
