"""``cmfpga build --top ulx3s`` and its like: the serial top, pads, and where a bitstream can and cannot be made."""

import dataclasses
import json
import re
from pathlib import Path
from unittest.mock import Mock

import pytest

from cmfpga.boards import TANG_PRIMER_20K, ULX3S
from cmfpga.cli import build
from cmfpga.fpga import bitstream, place
from cmfpga.fpga.families import ECP5
from cmfpga.fpga.tools import EstimateError
from support.building import TINY_SETS, check_lint


@pytest.fixture(scope="module")
def made(command, long_tools, tmp_path_factory):
    folder = tmp_path_factory.mktemp("ulx3s")
    assert command(build, "--top", "ulx3s", *TINY_SETS, "--out", folder).status == 0
    return folder


def test_ports(made):
    info = json.loads((made / "ulx3s-info.json").read_text())
    assert info["top"] == "cmfpga_ulx3s" and info["registers"]["ID"]["offset"] == 0x10
    bits = {port["name"]: (port["direction"], port["bits"]) for port in info["ports"]}
    assert bits["cpi_data"] == ("input", 8) and bits["uart_tx"] == ("output", 1) and len(bits) == 9


def test_lint(made):
    check_lint(made, ULX3S.top)


def sites_of(board, pattern):
    """The plan of the board's tools, and ``{pad: pin of the device}``, each pin once, by ``pattern``."""
    flow = bitstream.FLOWS[board.name]
    plan = flow.platform().prepare(bitstream.Pads(board), "pads")
    text = plan.files[flow.constraints]
    sites = re.findall(pattern, text if isinstance(text, str) else text.decode())
    assert len(dict(sites)) == len({site for _, site in sites}) == len(sites) == 15
    return plan, dict(sites)


def wires(board, sites):
    """``(signal of the sensor, pin that the board's facts name, pin of the device)``."""
    for name, pins in board.sensor_pins.items():
        for k, pin in enumerate(pins.split()):
            site = sites[f"cpi_0__{name}__io" + (f"[{k}]" if name == "data" else "")]
            yield f"{name.upper()}{k if name == 'data' else ''}", pin, site


def readme(board):
    return (Path(__file__).parents[2] / "boards" / board.name / "README.md").read_text(encoding="utf-8")


def test_pads_of_the_ulx3s():
    """Every pin that the wiring table names is a pad of its own, and the PLL makes the board's clock."""
    plan, sites = sites_of(ULX3S, r'LOCATE COMP "(\S+?)" SITE "(\w+)"')
    for signal, pin, site in wires(ULX3S, sites):
        assert f"| {signal} | {'GP' if pin[-1] == '+' else 'GN'}{pin[:-1]} | {site} |" in readme(ULX3S)
    assert 'FREQUENCY PORT "clk25_0__io" 25000000.0 HZ;' in plan.files["pads.lpf"]
    feedback, divider = ULX3S.clock_hz / ULX3S.oscillator_hz, ULX3S.vco_hz / ULX3S.clock_hz
    assert feedback.is_integer() and divider.is_integer() and 400e6 <= ULX3S.vco_hz <= 800e6
    assert f"parameter \\CLKFB_DIV {feedback:.0f}" in plan.files["pads.il"]
    assert ULX3S.clock_hz / ULX3S.baud == 25


def test_pads_of_the_tang_primer_20k():
    """Of the dock's headers, which amaranth-boards has by number; the oscillator is the clock."""
    board = TANG_PRIMER_20K
    _, sites = sites_of(board, r'IO_LOC "(\S+?)" (\w+);')
    pmods = [header for header in bitstream.FLOWS[board.name].platform.connectors if header.name == "pmod"]
    headers = {site: f"PMOD{header.number} {at}" for header in pmods for at, site in header.mapping.items()}
    for signal, pin, site in wires(board, sites):
        assert site == pin and f"| {signal} | {headers[site]} | {site} |" in readme(board)
    assert sites["clk27_0__io"] == "H11" and board.clock_hz == board.oscillator_hz == 9 * board.baud == 27_000_000


@pytest.mark.parametrize("options, why", [
    (["--bitstream"], "--bitstream and --baud are for a board without a processor: --top ulx3s"),
    (["--top", "kv260", "--set", "time_bits=34"], "time_bits = 34: at most 32 is allowed"),
    (["--top", "kv260", "--baud", "9600"], "--bitstream and --baud are for a board without a processor"),
    (["--top", "ulx3s", "--baud", "22000000"], "22000000 baud: a bit is 3.41 cycles of 75 MHz; 4 or more, and a who"),
    (["--top", "ulx3s", "--baud", "16666666"], "16666666 baud: a bit is 4.50 cycles of 75 MHz; 4 or more, and a who"),
    (["--top", "ulx3s", "--bitstream", "--target", "80"], "--speed, --seeds and --target say how to --place"),
])  # fmt: skip
def test_what_it_cannot_be_made_with(command, options, why, tmp_path):
    done = command(build, *options, *TINY_SETS, "--out", tmp_path / "none")
    assert done.error.startswith(why) and not done.out and not (tmp_path / "none").exists()


@pytest.fixture
def tools(monkeypatch):
    """Tools that find these clocks, MHz, one seed after the other, and write a bitstream of four bytes."""
    clocks, used = [], []

    def run(tool, arguments, folder, *_):
        used.append((tool, arguments))
        if tool == "ecppack":
            (folder / "pads.bit").write_bytes(b"bits")
            return
        fmax = {"$glbnet$clk": {"achieved": clocks.pop(0), "constraint": 75.0}}
        fmax["cpi_0__pclk__io$TRELLIS_IO_IN"] = {"achieved": 200.0, "constraint": 75.0}
        used_up = {cell: {"used": 1, "available": 2} for cell, _ in ECP5.resources.values()}
        (folder / "report.json").write_text(json.dumps({"fmax": fmax, "utilization": used_up}))

    monkeypatch.setattr(bitstream, "run", run)
    monkeypatch.setattr(bitstream, "yosys", lambda *_: [{"modules": {"pads": {"cells": {}, "ports": {}}}}])
    return clocks, used


def test_a_bitstream(made, tools, tmp_path):
    clocks, used = tools
    clocks += [74.9, 75.2]
    verilog, image = (made / f"{ULX3S.top}.v").read_text(), tmp_path / "it.bit"
    found = bitstream.bitstream(verilog, ULX3S, image)
    assert image.read_bytes() == b"bits" and found["seed"] == 2 and not clocks
    assert [tool for tool, _ in used] == ["nextpnr-ecp5", "nextpnr-ecp5", "ecppack"]
    assert {"--85k", "CABGA381", "6"} <= set(used[0][1])
    assert "seed 2: clock 75.2 of 75 MHz, sensor 200 of 75 MHz" in bitstream.text(found)


def test_the_command_tries_several_placements(command, monkeypatch, tmp_path):
    never = Mock(side_effect=EstimateError("no bitstream"))
    monkeypatch.setattr(bitstream, "bitstream", never)
    monkeypatch.setattr(place, "require_tools", lambda device: {})
    for given in [], ["--seeds", "2"]:
        done = command(build, "--top", "ulx3s", "--bitstream", *given, *TINY_SETS, "--out", tmp_path / "it")
        assert done.error == "no bitstream"
    assert [call.kwargs["seeds"] for call in never.call_args_list] == [bitstream.SEEDS, 2] and bitstream.SEEDS > 1


@pytest.mark.parametrize("clocks, changes, why", [
    ([70.0, 74.9], {}, r"^no bitstream: timing is not met: seed 1: clock 70 of 75 MHz, .*seeds may do$"),
    # The tools must have aimed for the clock that the PLL makes.
    ([90.0], {"clock_hz": 50_000_000}, "has not the design's two clocks"),
])  # fmt: skip
def test_no_bitstream(made, tools, tmp_path, clocks, changes, why):
    tools[0].extend(clocks)
    board = dataclasses.replace(ULX3S, **changes)
    with pytest.raises(EstimateError, match=why):
        bitstream.bitstream((made / f"{ULX3S.top}.v").read_text(), board, tmp_path / "it.bit", seeds=2)
    assert not list(tmp_path.iterdir())
