"""Bitstream of a board with a Lattice ECP5, by open tools from PyPI: Yosys, nextpnr and Project Trellis.

The emitted top as it is, between the board's pins, which amaranth-boards knows, and the PLL.
"""

import json
import tempfile
from pathlib import Path

from amaranth.build import Attrs, Clock, Pins, Resource, Subsignal
from amaranth.hdl import ClockDomain, ClockSignal, Elaboratable, Instance, Module, ResetSignal, Signal
from amaranth.lib import io
from amaranth.lib.cdc import ResetSynchronizer
from amaranth_boards.ulx3s import ULX3S_85F_Platform

from ..verilog.emit import sha256
from .families import ECP5, TIMING
from .packing import pack_registers
from .place import listed, require_tools
from .tools import EstimateError, read_json, run, yosys

#: By the board's name.
PLATFORMS = {"ulx3s": ULX3S_85F_Platform}

#: Placements to try: seeds differ by up to 9 %.
SEEDS = 5


def bitstream(verilog, board, path, *, seeds=SEEDS, report=lambda doing: None):
    """Write the bitstream of ``board`` at ``path``; JSON-ready: clocks, resources, versions. Minutes.

    Parameters
    ----------
    verilog : str
        What :func:`cmfpga.verilog.emit.emit_verilog` gave of the serial top.
    board : SerialBoard
    path : Path
    seeds : int
        Placements to try, from the random numbers 1 … ``seeds``; the first that meets all clocks is taken.

    Raises
    ------
    EstimateError
        A tool is missing or failed, or no placement meets the clocks; then nothing is written.
    """
    versions = require_tools()
    plan = PLATFORMS[board.name]().prepare(Pads(board), "pads")
    script = "read_verilog core.v\nread_rtlil pads.il\nsynth_ecp5 -no-rw-check -top pads -json 0.json\n"
    pads = plan.files["pads.il"]
    (netlist,) = yosys(script, verilog, ["yosys: synthesis for ECP5"], report, [("pads.il", _text(pads))])
    pack_registers(netlist["modules"]["pads"])
    tried = {}
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        (folder / "pads.json").write_text(json.dumps(netlist), encoding="utf-8")
        (folder / "pads.lpf").write_text(_text(plan.files["pads.lpf"]), encoding="utf-8")
        for seed in range(1, seeds + 1):
            clocks, resources = _placed(folder, board, seed, f"nextpnr: seed {seed} of at most {seeds}", report)
            tried[str(seed)] = clocks
            if all(clock["fmax_mhz"] >= clock["wanted_mhz"] for clock in clocks.values()):
                break
        else:
            raise EstimateError(f"no bitstream: timing is not met: {_text_of(tried)}; more --seeds may do")
        arguments = ["--compress", "--input", "pads.config", "--bit", "pads.bit"]
        run("ecppack", arguments, folder, ["ecppack"], [], report)
        made = (folder / "pads.bit").read_bytes()
    path.write_bytes(made)
    return {
        **versions, "board": board.name, "device": f"{board.device}-{board.speed}{board.package}", "top": board.top,
        "verilog_sha256": sha256(verilog), "bytes": len(made), "seed": seed, "seeds": tried, "resources": resources,
    }  # fmt: skip


def text(found):
    """For a terminal."""
    return f"{found['top']} on {found['device']} (Yosys {found['yosys']}, nextpnr {found['nextpnr']}): " + (
        f"{_text_of(found['seeds'])}\n{listed(found['resources'], ECP5)}"
    )


def _text_of(tried):
    return "; ".join(
        f"seed {seed}: "
        + ", ".join(f"{name} {c['fmax_mhz']:g} of {c['wanted_mhz']:g} MHz" for name, c in clocks.items())
        for seed, clocks in tried.items()
    )


def _placed(folder, board, seed, doing, report):
    """``{clock: fmax and what is wanted}`` and resources of one placement, which leaves ``pads.config``."""
    device = ECP5.devices[board.device][0].format(speed=board.speed).split()
    arguments = [*device, "--package", board.package, "--seed", str(seed)]
    arguments += ["--json", "pads.json", "--lpf", "pads.lpf", "--textcfg", "pads.config", "--report", "report.json"]
    run("nextpnr-ecp5", [*arguments, *TIMING, "--timing-allow-fail", "-q"], folder, [doing], [], report)
    found = read_json(folder / "report.json", "nextpnr", "report")
    try:
        fmax = {("sensor" if "cpi" in name else "clock"): clock for name, clock in found["fmax"].items()}
        clocks = {
            name: {"fmax_mhz": round(clock["achieved"], 1), "wanted_mhz": round(clock["constraint"], 1)}
            for name, clock in sorted(fmax.items())
        }
        if set(clocks) != {"clock", "sensor"} or clocks["clock"]["wanted_mhz"] * 1e6 != board.clock_hz:
            raise LookupError
        return clocks, {name: found["utilization"][cell] for name, (cell, _) in ECP5.resources.items()}
    except (AttributeError, LookupError, TypeError, ValueError):
        raise EstimateError("the report of nextpnr has not the design's two clocks and the resources") from None


def _text(content):
    return content if isinstance(content, str) else content.decode()


class Pads(Elaboratable):
    """The emitted top, as a black box, between pads and PLL.

    Parameters
    ----------
    board : SerialBoard
    """

    def __init__(self, board):
        self._board = board

    def elaborate(self, platform):
        board, m = self._board, Module()
        levels = Attrs(IO_TYPE="LVCMOS33", PULLMODE="DOWN")
        parts = [
            Subsignal(
                name, Pins(pins, conn=("gpio", 0), dir="i"), *([Clock(board.sensor_clock_hz)] if name == "pclk" else [])
            )
            for name, pins in board.sensor_pins.items()
        ]
        platform.add_resources([Resource("cpi", 0, *parts, levels)])

        def pad(port, direction):
            buffer = io.Buffer(direction, port)
            m.submodules += buffer
            return buffer.i if direction == "i" else buffer.o

        sync = ClockDomain("sync")
        locked = Signal()
        m.domains += sync
        times = {
            "CLKI_DIV": 1,
            "CLKFB_DIV": board.clock_hz // board.oscillator_hz,
            "CLKOP_DIV": board.vco_hz // board.clock_hz,
        }
        # Half of the divisor's phase: edges in line with the input's, as Lattice's own tool has it.
        phase = {"CLKOP_CPHASE": times["CLKOP_DIV"] - 1, "CLKOP_FPHASE": 0}
        m.submodules.pll = Instance(
            "EHXPLLL",
            *(("p", name, value) for name, value in (times | phase).items()),
            *(("p", name, value) for name, value in {"CLKOP_ENABLE": "ENABLED", "FEEDBK_PATH": "CLKOP"}.items()),
            a_FREQUENCY_PIN_CLKI=f"{board.oscillator_hz / 1e6:g}",
            a_FREQUENCY_PIN_CLKOP=f"{board.clock_hz / 1e6:g}",
            i_CLKI=pad(platform.request("clk25", dir="-"), "i"),
            i_CLKFB=sync.clk,
            i_RST=0,
            i_STDBY=0,
            o_CLKOP=sync.clk,
            o_LOCK=locked,
        )
        m.submodules.reset = ResetSynchronizer(~locked, domain="sync")
        uart, cpi = platform.request("uart", dir="-"), platform.request("cpi", dir="-")
        sensor = {f"i_cpi_{name}": pad(getattr(cpi, name), "i") for name in board.sensor_pins}
        m.submodules.top = Instance(
            board.top,
            i_clk=ClockSignal(),
            i_rst=ResetSignal(),
            i_uart_rx=pad(uart.rx, "i"),
            o_uart_tx=pad(uart.tx, "o"),
            o_irq=pad(platform.request("led", 0, dir="-"), "o"),
            **sensor,
        )
        return m
