"""What ``cmfpga build`` writes beside the core: the example, its bench, fields' positions, FuseSoC's file, IP-XACT."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from amaranth.hdl import Shape

from cmfpga import __version__
from cmfpga.config import PRESETS, preset
from cmfpga.engines.model import ModelEngine
from cmfpga.events import Events
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.results import BatchResult, fields_of
from cmfpga.rtl import payloads
from cmfpga.rtl.top import flatten, verilog_top
from cmfpga.verilog import description, example, ports
from cmfpga.verilog.compiler import find_verilator
from cmfpga.verilog.emit import TOP
from cmfpga.verilog.ports import port_table
from support.designs import FAST, SMALL, configured
from support.verilog_tools import check_ip_xact, emitted, require_icarus, run, verilator_lint

_SIZES = {"sensor_width": 48, "sensor_height": 32, "roi_width": 16, "roi_height": 16, "buffer_events": 128}
CONFIGS = {
    "paper": SMALL.replace(roi_width=16, roi_height=16, iterations=5),
    "fast": configured(FAST),
    "sliding": preset("sliding").replace(**_SIZES, hop_events=40),
    "similarity": preset("similarity").replace(**_SIZES, tag_bits=4),
    "rotation": preset("rotation").replace(**_SIZES, tag_bits=4, ram_style="auto"),
    "rotation, small": preset("rotation").replace(
        **_SIZES | {"sensor_width": 24, "sensor_height": 20}, tag_bits=4, ram_style="auto"
    ),
    "flow": preset("flow").replace(**_SIZES, regions=2, units=1, camera="48,48,24,16,-0.1,0.02,0,0,0"),
    "objects": preset("objects").replace(**_SIZES, regions=2, units=1, roi_gain=0.5),
    "filtered": configured(FAST).replace(hot_pixels=1, background=1, background_us=400, hot_mask="16,12;17,12"),
}


def texts(config, core, verilog):
    table = port_table(core)
    return {
        f"{example.FIELDS}.vh": description.header(table),
        f"{example.EXAMPLE}.v": example.example(config, table),
        f"{example.BENCH}.v": example.bench(config, table, verilog),
        f"{example.EXAMPLE}.mem": example.memory(config, table),
        f"{TOP}.core": description.fusesoc(),
        "component.xml": description.ip_xact(table),
    }


def write(config, folder):
    core, verilog = emitted(config)
    for name, text in {f"{TOP}.v": verilog, **texts(config, core, verilog)}.items():
        (folder / name).write_text(text)


def expected(config):
    """The model's first result of the same batch that is not degenerate."""
    config = example.example_config(config)
    engine, events = ModelEngine(config), np.array(example.example_batch(config)).T
    if config.regions:
        engine.write(example.example_regions(config))
    results = engine.run(Events(*events, np.zeros(events.shape[1], int)), example.example_settings(config))
    return next(result for result in results if Flag.DEGENERATE not in result.flags)


def compare(config, output):
    """What the bench printed is what the model says, in every field but the cycles."""
    config = example.example_config(config)
    printed = {name: int(value) for name, value in re.findall(r"^result_(\w+) = (-?\d+)$", output, re.MULTILINE)}
    found, right = BatchResult.decoded(config, [printed]), expected(config)
    assert any(right.v)
    names = [f.name for f in fields_of("batch", "region", config=config) if f.name != "cycles"]
    assert {name: getattr(found, name) for name in names} == {name: getattr(right, name) for name in names}
    assert printed["cycles"] > 0 and output.splitlines()[-1].startswith("DONE: ")


@pytest.mark.parametrize("name", CONFIGS)
def test_a_batch_in_icarus(name, tmp_path):
    require_icarus()
    config = CONFIGS[name]
    write(config, tmp_path)
    sources = [f"{example.BENCH}.v", f"{example.EXAMPLE}.v", f"{TOP}.v"]
    for language in ("2001", "2012"):
        command = ["iverilog", f"-g{language}", "-Wall", "-o", "example", "-s", example.BENCH, *sources]
        assert run(command, cwd=tmp_path) == (0, "")
    status, output = run(["vvp", "-n", "example"], cwd=tmp_path, timeout=300)
    assert status == 0
    compare(config, output)


def test_waveforms_on_demand(tmp_path):
    require_icarus()
    write(CONFIGS["fast"], tmp_path)
    run(["iverilog", "-o", "example", f"{example.BENCH}.v", f"{example.EXAMPLE}.v", f"{TOP}.v"], cwd=tmp_path)
    run(["vvp", "-n", "example", "+waves"], cwd=tmp_path)
    text = (tmp_path / f"{example.EXAMPLE}.vcd").read_text()
    assert all(f" {name} " in text for name in ("event_in_valid", "event_ready", "loaded", "result_valid"))


@pytest.mark.parametrize("name, idle", [("fast", {"iterations", "eta"}), ("paper", set())])
def test_settings_that_the_core_does_not_read_are_told(name, idle):
    config = CONFIGS[name]
    text = example.example(config, port_table(emitted(config)[0]))
    assert set(re.findall(r"\.settings_(\w+)\(.*; not read$", text, re.MULTILINE)) == idle


@pytest.mark.parametrize("name", [*PRESETS, *CONFIGS])
def test_no_warning_of_verilator(name, sim_dir, tmp_path):
    """Beside those of the core, whose waivers are for its file alone here."""
    write(CONFIGS.get(name) or preset(name), tmp_path)
    waivers = tmp_path / "verilator.vlt"
    waivers.write_text((sim_dir / "verilator.vlt").read_text().replace("*cmfpga_*.v", f"*{TOP}.v"))
    text = (tmp_path / f"{example.EXAMPLE}.v").read_text()
    options = "-Wall", f"-I{tmp_path}", waivers, tmp_path / f"{TOP}.v"
    assert verilator_lint(text, tmp_path, *options, top=example.EXAMPLE) == (0, set())
    broken = text.replace(".event_last(", ".event_t(", 1)
    assert verilator_lint(broken, tmp_path, *options, top=example.EXAMPLE)[0]


@pytest.mark.parametrize("name", PRESETS)
def test_every_port_is_connected_and_told(name):
    config = preset(name)
    core = verilog_top(config)
    table = port_table(core)
    text = example.example(config, table)
    assert re.findall(r"^    \.(\w+)\(", text, re.MULTILINE) == [port.name for port in table]
    for port in table:
        line = re.search(rf"^    \.{port.name}\((.*)\),?  // (.*)$", text, re.MULTILINE)
        assert line[2].removesuffix("; not read").endswith(ports.plain(port.meaning)) and str(port.bits) in line[2]
        assert line[1] or port.direction == "output"
    stub = f"module {TOP}();\nendmodule\n"
    for name, made in texts(config, core, stub).items():
        assert made.isascii(), name


@pytest.mark.parametrize("name", PRESETS)
def test_fields_lie_as_in_the_payloads(name):
    """As Amaranth lays out what the core's streams carry."""
    config = preset(name)
    core = verilog_top(config)
    found = {key: int(value) for key, value in re.findall(r"(\w+) = (\d+)[,;]", description.header(port_table(core)))}
    layouts = {"event": payloads.event(config), "settings": payloads.settings(config), "result": core.o.payload.shape()}
    for group, layout in layouts.items():
        assert found[f"{group.upper()}_BITS"] == Shape.cast(layout).width
        for port, (path, shape) in flatten(layout, group).items():
            at, inner = 0, layout
            for key in path:
                at, inner = at + inner[key].offset, inner[key].shape
            assert (found[f"{port.upper()}_LSB"], found[f"{port.upper()}_BITS"]) == (at, Shape.cast(shape).width), port


def fusesoc(folder, target):
    pytest.importorskip("fusesoc", reason="FuseSoC is not installed: pip install fusesoc")
    name = f"{description.VENDOR}:{description.LIBRARY}:{TOP}"
    command = [sys.executable, "-m", "fusesoc.main", "--cores-root=.", "run", f"--target={target}", name]
    found = find_verilator()
    path = os.pathsep.join([str(Path(found.program).parent), os.environ["PATH"]])
    environment = {**os.environ, "PATH": path, "VERILATOR_ROOT": str(found.root)}
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment)


def test_fusesoc_lints_it(tmp_path):
    write(CONFIGS["fast"], tmp_path)
    done = fusesoc(tmp_path, "lint")
    assert done.returncode == 0 and "%Warning" not in done.stdout + done.stderr, done.stdout + done.stderr
    path = tmp_path / f"{example.EXAMPLE}.v"
    path.write_text(path.read_text().replace(".event_last(", ".event_t(", 1))
    assert fusesoc(tmp_path, "lint").returncode


def test_fusesoc_builds_and_runs_it(tmp_path):
    require_icarus()
    if not shutil.which("make"):
        pytest.skip("make is not installed (Debian package make)")
    config = CONFIGS["fast"]
    write(config, tmp_path)
    done = fusesoc(tmp_path, "sim")
    assert done.returncode == 0, done.stdout + done.stderr
    lines = [line for line in (done.stdout + done.stderr).splitlines() if re.match(r"result_|DONE", line)]
    compare(config, "\n".join(lines))


@pytest.mark.parametrize("name", PRESETS)
def test_ip_xact(name):
    check_ip_xact(description.ip_xact(port_table(verilog_top(preset(name)))).encode())


def test_ip_xact_says_what_the_ports_are():
    table = port_table(verilog_top(preset("fast")))
    root = ElementTree.fromstring(description.ip_xact(table))
    space = re.match(r"\{.*\}", root.tag)[0]

    def text(node, *names):
        return node.findtext("/".join(space + name for name in names))

    assert (text(root, "name"), text(root, "version")) == (TOP, __version__)
    ports = {
        text(node, "name"): (text(node, "wire", "direction"), int(text(node, "wire", "vector", "left") or 0) + 1)
        for node in root.iter(f"{space}port")
    }
    assert ports == {port.name: (port.direction.removesuffix("put"), port.bits) for port in table}
    buses = {text(bus, "name"): bus for bus in root.iter(f"{space}busInterface")}
    assert set(buses) == {"clk", "rst", "event", "result"}
    for group in ("event", "result"):
        mapped = [text(pair, "physicalPort", "name") for pair in buses[group].iter(f"{space}portMap")]
        assert sorted(mapped) == sorted(port.name for port in table if port.group == group)
