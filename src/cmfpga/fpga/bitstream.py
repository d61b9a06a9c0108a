"""Bitstream of a board without a processor, by open tools from PyPI: Yosys, nextpnr, and what packs for the family.

The emitted top as it is, between the board's pins, which amaranth-boards knows, and what makes its clock.
"""

import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from amaranth.build import Attrs, Clock, Pins, Resource, Subsignal
from amaranth.hdl import ClockDomain, ClockSignal, Elaboratable, Instance, Module, ResetSignal, Signal
from amaranth.lib import io
from amaranth.lib.cdc import ResetSynchronizer
from amaranth_boards.tang_primer_20k import TangPrimer20kDockPlatform
from amaranth_boards.ulx3s import ULX3S_85F_Platform

from ..boards import TANG_PRIMER_20K
from ..verilog.emit import sha256
from .families import FAMILIES, TIMING, luts_of_four
from .packing import pack
from .place import listed, require_tools
from .tools import EstimateError, read_json, run, yosys

#: Placements to try: seeds differ by up to 9 %.
SEEDS = 5


def bitstream(verilog, board, path, *, seeds=SEEDS, report=lambda doing: None):
    """Write the bitstream of a :class:`SerialBoard` at ``path``; JSON-ready: clocks, resources, versions. Minutes.

    ``verilog`` is the text of the serial top. Of the placements from the random numbers 1 … ``seeds`` the first that
    meets all clocks is taken. Raises :exc:`EstimateError` where a tool is missing or failed, or no placement meets the
    clocks; then nothing is written.
    """
    versions, flow, family = require_tools(board.device), FLOWS[board.name], FAMILIES[board.device]
    plan = flow.platform().prepare(Pads(board), "pads")
    script = f"read_verilog core.v\nread_rtlil pads.il\n{family.synthesis.format(top='pads')}\nwrite_json 0.json\n"
    pads = [("pads.il", plan.files["pads.il"])]
    (netlist,) = yosys(script, verilog, [f"yosys: synthesis for {family.title}"], report, pads)
    flow.prepare(netlist["modules"]["pads"])
    tried = {}
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        (folder / "pads.json").write_text(json.dumps(netlist), encoding="utf-8")
        (folder / flow.constraints).write_text(plan.files[flow.constraints], encoding="utf-8")
        for seed in range(1, seeds + 1):
            clocks, resources = _placed(folder, board, seed, f"nextpnr: seed {seed} of at most {seeds}", report)
            tried[str(seed)] = clocks
            if all(clock["fmax_mhz"] >= clock["wanted_mhz"] for clock in clocks.values()):
                break
        else:
            raise EstimateError(f"no bitstream: timing is not met: {_text_of(tried)}; more --seeds may do")
        tool, *arguments = flow.pack
        run(tool, arguments, folder, [tool], [], report)
        made = (folder / "pads.bit").read_bytes()
    path.write_bytes(made)
    return {
        **versions, "board": board.name, "device": f"{board.device}-{board.speed}{board.package}", "top": board.top,
        "verilog_sha256": sha256(verilog), "bytes": len(made), "seed": seed, "seeds": tried, "resources": resources,
        "untimed": family.untimed,
    }  # fmt: skip


def text(found):
    """For a terminal."""
    bound = f"; only a bound, without delays of {found['untimed']}" * bool(found["untimed"])
    family = FAMILIES[found["device"].rsplit("-", 1)[0]]
    return f"{found['top']} on {found['device']} (Yosys {found['yosys']}, nextpnr {found['nextpnr']}): " + (
        f"{_text_of(found['seeds'])}{bound}\n{listed(found['resources'], family)}"
    )


def _text_of(tried):
    return "; ".join(
        f"seed {seed}: "
        + ", ".join(f"{name} {c['fmax_mhz']:g} of {c['wanted_mhz']:g} MHz" for name, c in clocks.items())
        for seed, clocks in tried.items()
    )


def _placed(folder, board, seed, doing, report):
    """``{clock: fmax and what is wanted}`` and resources of one placement, which leaves what is packed."""
    flow, family = FLOWS[board.name], FAMILIES[board.device]
    device = family.devices[board.device][0].format(speed=board.speed).split()
    arguments = [*device, *flow.options(board), "--seed", str(seed), "--json", "pads.json", "--report", "report.json"]
    run(family.nextpnr, [*arguments, "--timing-allow-fail", "-q"], folder, [doing], [], report)
    found = read_json(folder / "report.json", "nextpnr", "report")
    try:
        fmax = {("sensor" if "cpi" in name else "clock"): clock for name, clock in found["fmax"].items()}
        if set(fmax) != {"clock", "sensor"} or round(fmax["clock"]["constraint"] * 1e6, -4) != board.clock_hz:
            raise LookupError
        wanted = {"clock": board.clock_hz, "sensor": board.sensor_clock_hz}
        clocks = {
            name: {"fmax_mhz": round(fmax[name]["achieved"], 1), "wanted_mhz": round(hz / 1e6, 1)}
            for name, hz in wanted.items()
        }
        return clocks, {name: found["utilization"][cell] for name, (cell, _) in family.resources.items()}
    except (AttributeError, LookupError, TypeError, ValueError):
        raise EstimateError("the report of nextpnr has not the design's two clocks and the resources") from None


class Pads(Elaboratable):
    """The emitted top, as a black box, between a :class:`SerialBoard`'s pads and what makes its clock."""

    def __init__(self, board):
        self._board = board

    def elaborate(self, platform):
        board, m = self._board, Module()
        flow = FLOWS[board.name]
        parts = [
            Subsignal(
                name,
                Pins(pins, conn=board.sensor_connector, dir="i"),
                *([Clock(board.sensor_clock_hz)] if name == "pclk" else []),
            )
            for name, pins in board.sensor_pins.items()
        ]
        platform.add_resources([Resource("cpi", 0, *parts, flow.levels)])

        def pad(name, port, direction):
            m.submodules[f"{name}_pad"] = buffer = io.Buffer(direction, port)
            return buffer.i if direction == "i" else buffer.o

        sync = ClockDomain("sync")
        m.domains += sync
        flow.clock(m, board, sync, pad("clk", platform.request(platform.default_clk, dir="-"), "i"))
        uart, cpi = platform.request("uart", dir="-"), platform.request("cpi", dir="-")
        sensor = {f"i_cpi_{name}": pad(f"cpi_{name}", getattr(cpi, name), "i") for name in board.sensor_pins}
        m.submodules.top = Instance(
            board.top,
            i_clk=ClockSignal(),
            i_rst=ResetSignal(),
            i_uart_rx=pad("uart_rx", uart.rx, "i"),
            o_uart_tx=pad("uart_tx", uart.tx, "o"),
            o_irq=pad("irq", platform.request("led", 0, dir="-"), "o"),
            **sensor,
        )
        return m


# ---------------------------------------------------------------- clocks


def _by_pll(m, board, sync, oscillator):
    """An ECP5's PLL; reset until it has locked."""
    locked = Signal()
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
        i_CLKI=oscillator,
        i_CLKFB=sync.clk,
        i_RST=0,
        i_STDBY=0,
        o_CLKOP=sync.clk,
        o_LOCK=locked,
    )
    m.submodules.reset = ResetSynchronizer(~locked, domain="sync")


def _by_oscillator(m, board, sync, oscillator):
    """The oscillator itself; reset for its first 256 cycles, which registers count that begin at 0."""
    cycles = Signal(8, reset_less=True)
    m.d.comb += [sync.clk.eq(oscillator), sync.rst.eq(~cycles.all())]
    m.d.sync += cycles.eq(cycles + ~cycles.all())


# ---------------------------------------------------------------- boards


@dataclass(frozen=True, kw_only=True)
class Flow:
    """From the pads and a family's netlist to a board's bitstream, ``pads.bit``."""

    #: Of amaranth-boards; the name of its file of pins; and levels of the sensor's.
    platform: type
    constraints: str
    levels: Attrs
    #: Adds what makes the clock: of the module, the board, the domain and the oscillator.
    clock: Callable
    #: Changes the netlist's module in place.
    prepare: Callable
    #: Options of nextpnr, of the board.
    options: Callable
    #: The tool that packs, and its arguments; the name's end by which loaders know what it writes.
    pack: tuple[str, ...]
    suffix: str


#: By the board's name.
FLOWS = {
    "ulx3s": Flow(
        platform=ULX3S_85F_Platform,
        constraints="pads.lpf",
        levels=Attrs(IO_TYPE="LVCMOS33", PULLMODE="DOWN"),
        clock=_by_pll,
        prepare=pack,
        options=lambda board: [
            *("--package", board.package, "--lpf", "pads.lpf", "--textcfg", "pads.config"), *TIMING
        ],
        pack=("ecppack", "--compress", "--input", "pads.config", "--bit", "pads.bit"),
        suffix=".bit",
    ),
    "tang_primer_20k": Flow(
        platform=TangPrimer20kDockPlatform,
        constraints="pads.cst",
        levels=Attrs(IO_TYPE="LVCMOS33", PULL_MODE="DOWN"),
        clock=_by_oscillator,
        prepare=luts_of_four,
        options=lambda board: [
            *("--vopt", "cst=pads.cst", "--freq", f"{board.clock_hz / 1e6:g}", "--write", "placed.json")
        ],
        # The pins that configure the device belong to the design once it has started.
        pack=(
            "gowin_pack", "-d", TANG_PRIMER_20K.device, "--mspi_as_gpio", "--sspi_as_gpio", "--ready_as_gpio",
            "--done_as_gpio", "-o", "pads.bit", "placed.json",
        ),
        suffix=".fs",
    ),
}  # fmt: skip
