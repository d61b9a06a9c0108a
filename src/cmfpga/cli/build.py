"""``cmfpga build``: emit the accelerator as Verilog, with what a user must know of it."""

import importlib.resources
import json
import sys

from .. import __version__, cli
from ..boards import BOARDS, SerialBoard
from ..errors import UserError, write_text
from ..fpga import bitstream, levels, place, resources
from ..fpga.families import FAMILIES
from ..protocol import registers
from ..protocol.registers import documents
from ..rtl.axi.top import AxiTop
from ..rtl.top import verilog_top
from ..rtl.uart.top import UartTop, divisor
from ..verilog import description, example
from ..verilog.description import describe, describe_top, summary
from ..verilog.emit import TOP, emit_verilog
from ..verilog.ports import port_table
from ..waiting import waiting

EXAMPLES = (
    "cmfpga build                                     # preset fast, into ./build",
    "cmfpga build --preset fast-128 --out build-128",
    "cmfpga build --preset paper --resources --out build-paper",
    "cmfpga build --preset flow --out build-flow       # many regions, five units",
    "cmfpga build --top kv260                         # with AXI ports and registers, for Vivado",
    "cmfpga build --place LFE5U-85F --seeds 5          # clock and area by an open flow",
    "cmfpga build --top ulx3s --bitstream              # a whole bitstream by open tools",
    "cmfpga build --list-fields",
)

SERIAL_BOARDS = [board.name for board in BOARDS.values() if isinstance(board, SerialBoard)]


def build(config, folder):
    """Write ``cmfpga_core.v``, what describes it, and an example of its use into ``folder``; returns their paths."""
    core = verilog_top(config)
    with waiting("Emitting the Verilog"):
        verilog = emit_verilog(core)
    info, table = describe(config, core, verilog), port_table(core)
    contents = {
        f"{TOP}.v": verilog,
        "build-info.json": json.dumps(info, indent=2, ensure_ascii=False) + "\n",
        "build-info.md": summary(info),
        f"{example.FIELDS}.vh": description.header(table),
        f"{example.EXAMPLE}.v": example.example(config, table),
        f"{example.BENCH}.v": example.bench(config, table, verilog),
        f"{example.EXAMPLE}.mem": example.memory(config, table),
        f"{TOP}.core": description.fusesoc(),
        "component.xml": description.ip_xact(table),
    }
    for name, text in contents.items():
        write_text(folder / name, text)
    return [folder / name for name in contents]


def build_top(config, board, folder, baud=None):
    """Write a board's top, such as ``cmfpga_kv260.v``, ``kv260-info.json`` and the documents of the registers.

    ``baud`` is of a serial board's line, instead of its own. Returns their paths.
    """
    from ..driver.golden import batch_file, setting_writes  # knows the engines; only tops need it

    if isinstance(board, SerialBoard):
        top = UartTop(config, clock_hz=board.clock_hz, baud=baud or board.baud)
    else:
        top = AxiTop(config)
    with waiting(f"Emitting {board.top}"):
        verilog = emit_verilog(top, board.top)
    paths = [folder / f"{board.top}.v", folder / f"{board.name}-info.json"]
    info = describe_top(board, top, verilog)
    write_text(paths[0], verilog)
    write_text(paths[1], json.dumps(info, indent=2, ensure_ascii=False) + "\n")
    title = f"Registers of {board.top}, cmfpga {__version__}, configuration {config.hardware_hash[:16]}."
    settings = setting_writes(config)
    with waiting("Writing the registers' documents"):
        paths += documents.write_documents(top.shell.registers, title, folder, settings)
    if not isinstance(board, SerialBoard):
        bench = importlib.resources.files("cmfpga.driver").joinpath("cocotb_bench.py").read_text(encoding="utf-8")
        for name, text in ((f"test_{board.top}.py", bench), (f"{board.top}_batch.json", batch_file(config, board.top))):
            write_text(folder / name, text)
            paths.append(folder / name)
    return paths


def _estimate(verilog, axi, by_block):
    """The resources of the core's Verilog at this path; ``axi``, that of a top's or None, adds a row of that."""
    estimated = resources.estimate(verilog.read_text(encoding="utf-8"), by_block=by_block, report=cli.note)
    if axi is not None:
        cli.note(f"the same of {axi.stem}")
        estimated["axi"] = resources.core(axi.read_text(encoding="utf-8"), report=cli.note, top=axi.stem)
    return estimated


def parser():
    """Parser of the arguments of ``cmfpga build``."""
    tops = "; ".join(f"{board.name}: {board.top}" for board in BOARDS.values())
    made = cli.parser("cmfpga build", "Emit the accelerator as Verilog.", EXAMPLES)
    made.add_argument("--out", default="build", metavar="DIR", help="folder to write into (default: build)")
    text = f"core: {TOP}; {tops} too, with the board's ports, and its registers' documents (default: core)"
    made.add_argument("--top", choices=("core", *BOARDS), default="core", help=text)
    made.add_argument("--json", action="store_true", help="print the paths (and what is estimated) as JSON")
    text = "estimate LUTs, flip-flops, RAMs and DSPs by Yosys; 'blocks': of each block, too (minutes)"
    made.add_argument("--resources", nargs="?", const="core", choices=("core", "blocks"), metavar="blocks", help=text)
    made.add_argument("--levels", action="store_true", help="count the LUTs in a row between registers, by Yosys")
    placed = made.add_argument_group("place and route by Yosys and nextpnr, of what --top says (minutes)")
    placed.add_argument("--place", choices=tuple(FAMILIES), metavar="DEVICE", help=", ".join(FAMILIES))
    placed.add_argument("--speed", type=cli.positive, metavar="N", help="speed grade (default: the fastest)")
    placed.add_argument("--seeds", type=cli.positive, metavar="N", help="placements, of which the median counts (1)")
    text = f"fail below this clock (without: aim for {place.AIM_MHZ})"
    placed.add_argument("--target", type=cli.clock, metavar="MHZ", help=text)
    serial = made.add_argument_group(f"a board without a processor (--top {', '.join(SERIAL_BOARDS)})")
    serial.add_argument(
        "--bitstream", action="store_true", help="its whole bitstream, by Yosys, nextpnr and a packer (minutes); "
        f"of the first of --seeds ({bitstream.SEEDS}) that meets timing",
    )  # fmt: skip
    serial.add_argument("--baud", type=cli.positive, metavar="N", help="of its serial line (default: the board's)")
    cli.add_config_options(made)
    return made


def main(arguments=None):
    """Run the command; returns the exit status."""
    options = parser().parse_args(arguments)
    config = cli.make_config(options)
    if options.resources or options.levels:
        resources.require_yosys()  # before anything is written
    if (options.bitstream or options.baud) and options.top not in SERIAL_BOARDS:
        raise UserError(f"--bitstream and --baud are for a board without a processor: --top {SERIAL_BOARDS[0]}")
    if options.place:
        place.require_tools(options.place, options.speed, options.target)
    if options.bitstream:
        place.require_tools(BOARDS[options.top].device)
    if not options.place and (options.speed or options.target or (options.seeds and not options.bitstream)):
        raise UserError("--speed, --seeds and --target say how to --place: name a device with that")
    board = BOARDS.get(options.top)
    if board:
        registers.check(config)
    elif config.evt3:
        top = next(iter(BOARDS))
        raise UserError(f"evt3 = 1: {TOP} takes events, not words; a board's top decodes them: --top {top}")
    if options.baud:
        divisor(board.clock_hz, options.baud)
    folder = cli.output_folder(options.out)
    paths = build(config, folder)
    if board:
        paths += build_top(config, board, folder, options.baud)
        if not documents.has_peakrdl():
            cli.note("no HTML or IP-XACT of the registers: pip install 'cmfpga[registers]'")
    wrapped = folder / f"{board.top}.v" if board else None
    if not options.json:
        print(*(f"wrote {path}" for path in paths), sep="\n", flush=True)
    emitted = wrapped or paths[0]
    verilog, top = emitted.read_text(encoding="utf-8"), {"top": emitted.stem, "report": cli.note}
    seeds = options.seeds or bitstream.SEEDS
    image = emitted.with_suffix(bitstream.FLOWS[board.name].suffix) if options.bitstream else None
    how = {"device": options.place, "speed": options.speed, "seeds": options.seeds, "aim_mhz": options.target}
    found = {}
    for name, what, measure in (
        ("resources", resources, lambda: _estimate(paths[0], wrapped, options.resources == "blocks")),
        ("levels", levels, lambda: levels.levels(verilog, **top)),
        ("place", place, lambda: place.place(verilog, **top, **{name: value for name, value in how.items() if value})),
        ("bitstream", bitstream, lambda: bitstream.bitstream(verilog, board, image, seeds=seeds, report=cli.note)),
    ):
        if getattr(options, name):
            found[name] = measure()
            made = [folder / f"{name}.json", *([image] if name == "bitstream" else [])]
            write_text(made[0], json.dumps(found[name], indent=2, ensure_ascii=False) + "\n")
            paths.extend(made)
            if not options.json:
                print(*(f"wrote {path}" for path in made), what.text(found[name]), sep="\n", flush=True)
    if options.json:
        print(json.dumps({"files": [str(path) for path in paths], **found}, indent=2, ensure_ascii=False))
    if options.target and found["place"]["fmax_mhz"] < options.target:
        print(f"error: {found['place']['fmax_mhz']:g} MHz: less than --target {options.target:g}", file=sys.stderr)
        return 1
    return 0
