"""``python -m cmfpga.build``: emit the accelerator as Verilog, with what a user must know of it."""

import json
import sys

from . import __version__, cli
from .boards import BOARDS
from .errors import write_text
from .protocol import registers
from .protocol.registers import documents
from .rtl.axi.top import AxiTop
from .rtl.top import VerilogCore
from .verilog import resources
from .verilog.description import describe, describe_axi, summary
from .verilog.emit import TOP, emit_verilog

EXAMPLES = (
    "python -m cmfpga.build                                     # preset fast, into ./build",
    "python -m cmfpga.build --preset fast-128 --out build-128",
    "python -m cmfpga.build --preset paper --resources --out build-paper",
    "python -m cmfpga.build --top kv260                         # with AXI ports and registers, for Vivado",
    "python -m cmfpga.build --list-fields",
)


def build(config, folder):
    """Write ``cmfpga_core.v``, ``build-info.json`` and ``build-info.md`` into ``folder``; returns their paths."""
    core = VerilogCore(config)
    verilog = emit_verilog(core)
    info = describe(config, core, verilog)
    contents = {
        f"{TOP}.v": verilog,
        "build-info.json": json.dumps(info, indent=2, ensure_ascii=False) + "\n",
        "build-info.md": summary(info),
    }
    for name, text in contents.items():
        write_text(folder / name, text)
    return [folder / name for name in contents]


def build_axi(config, board, folder):
    """Write a board's top, such as ``cmfpga_kv260.v``, ``kv260-info.json`` and the documents of the registers.

    Returns their paths.
    """
    top = AxiTop(config)
    verilog = emit_verilog(top, board.top)
    paths = [folder / f"{board.top}.v", folder / f"{board.name}-info.json"]
    info = describe_axi(board, top, verilog)
    write_text(paths[0], verilog)
    write_text(paths[1], json.dumps(info, indent=2, ensure_ascii=False) + "\n")
    title = f"Registers of {board.top}, cmfpga {__version__}, configuration {config.hardware_hash[:16]}."
    return paths + documents.write_documents(top.shell.registers, title, folder)


def estimate(verilog, axi=None):
    """Write ``resources.json`` beside the core's Verilog at this path; returns what is in it, and its path.

    ``axi``, the path of the AXI top's Verilog, adds a row of that.
    """

    def report(doing):
        print(f"note: {doing}", file=sys.stderr, flush=True)

    estimated = resources.estimate(verilog.read_text(encoding="utf-8"), report=report)
    if axi is not None:
        report(f"the same of {axi.stem}")
        estimated["axi"] = resources.core(axi.read_text(encoding="utf-8"), report=report, top=axi.stem)
    path = verilog.with_name("resources.json")
    write_text(path, json.dumps(estimated, indent=2, ensure_ascii=False) + "\n")
    return estimated, path


def main(arguments=None):
    """Run the command; returns the exit status."""
    tops = "; ".join(f"{board.name}: {board.top}" for board in BOARDS.values())
    made = cli.parser("build", "Emit the accelerator as Verilog.", EXAMPLES)
    made.add_argument("--out", default="build", metavar="DIR", help="folder to write into (default: build)")
    made.add_argument(
        "--top",
        choices=("core", *BOARDS),
        default="core",
        help=f"core: {TOP}; {tops} too, with AXI ports, and its registers' documents (default: core)",
    )
    made.add_argument("--json", action="store_true", help="print the paths (and the resources) as JSON")
    made.add_argument(
        "--resources", action="store_true", help="estimate LUTs, flip-flops, RAMs and DSPs by Yosys (minutes)"
    )
    cli.add_config_options(made)
    options = made.parse_args(arguments)
    config = cli.make_config(options)
    if options.resources:
        resources.require_yosys()  # before anything is written
    board = BOARDS.get(options.top)
    if board:
        registers.check(config)
    folder = cli.output_folder(options.out)
    paths = build(config, folder)
    if board:
        paths += build_axi(config, board, folder)
        if not documents.has_peakrdl():
            print(
                "note: no C header, HTML or IP-XACT of the registers: pip install 'cmfpga[registers]'", file=sys.stderr
            )
    estimated = {}
    if not options.json:
        print(*(f"wrote {path}" for path in paths), sep="\n", flush=True)
    if options.resources:
        estimated, path = estimate(paths[0], folder / f"{board.top}.v" if board else None)
        paths.append(path)
        if not options.json:
            print(f"wrote {path}\n{resources.text(estimated)}")
    if options.json:
        shown = {"files": [str(path) for path in paths], **({"resources": estimated} if estimated else {})}
        print(json.dumps(shown, indent=2, ensure_ascii=False))
    return 0


if __name__ == "__main__":
    sys.exit(cli.run(main))
