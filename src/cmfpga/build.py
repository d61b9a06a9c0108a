"""``python -m cmfpga.build``: emit the accelerator as Verilog, with what a user must know of it."""

import json
import sys

from . import __version__, cli
from .protocol import registers
from .protocol.registers import documents
from .rtl.axi.top import KV260Top
from .rtl.top import VerilogCore
from .verilog import resources
from .verilog.description import describe, describe_axi, summary
from .verilog.emit import AXI_TOP, TOP, emit_verilog

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
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name in contents]


def build_axi(config, folder):
    """Write ``cmfpga_kv260.v``, ``kv260-info.json`` and the documents of its registers; returns their paths."""
    top = KV260Top(config)
    verilog = emit_verilog(top, AXI_TOP)
    paths = [folder / f"{AXI_TOP}.v", folder / "kv260-info.json"]
    info = describe_axi(config, top, verilog)
    paths[0].write_text(verilog, encoding="utf-8")
    paths[1].write_text(json.dumps(info, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    title = f"Registers of {AXI_TOP}, cmfpga {__version__}, configuration {config.hardware_hash[:16]}."
    return paths + documents.write_documents(top.registers, title, folder)


def estimate(verilog, axi=None):
    """Write ``resources.json`` beside the core's Verilog at this path; returns what is in it, and its path.

    ``axi``, the path of the AXI top's Verilog, adds a row of that.
    """

    def report(doing):
        print(f"note: {doing}", file=sys.stderr, flush=True)

    estimated = resources.estimate(verilog.read_text(encoding="utf-8"), report=report)
    if axi is not None:
        report(f"the same of {AXI_TOP}")
        estimated["axi"] = resources.core(axi.read_text(encoding="utf-8"), report=report, top=AXI_TOP)
    path = verilog.with_name("resources.json")
    path.write_text(json.dumps(estimated, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    return estimated, path


def main(arguments=None):
    """Run the command; returns the exit status."""
    made = cli.parser("build", "Emit the accelerator as Verilog.", EXAMPLES)
    made.add_argument("--out", default="build", metavar="DIR", help="folder to write into (default: build)")
    made.add_argument(
        "--top",
        choices=("core", "kv260"),
        default="core",
        help="core: cmfpga_core; kv260: cmfpga_kv260 too, with AXI ports, and its registers' documents (default: core)",
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
    if options.top == "kv260":
        registers.check(config)
    folder = cli.output_folder(options.out)
    paths = build(config, folder)
    if options.top == "kv260":
        paths += build_axi(config, folder)
        if not documents.has_peakrdl():
            print(
                "note: no C header, HTML or IP-XACT of the registers: pip install 'cmfpga[registers]'", file=sys.stderr
            )
    estimated = {}
    if not options.json:
        print(*(f"wrote {path}" for path in paths), sep="\n", flush=True)
    if options.resources:
        estimated, path = estimate(paths[0], folder / f"{AXI_TOP}.v" if options.top == "kv260" else None)
        paths.append(path)
        if not options.json:
            print(f"wrote {path}\n{resources.text(estimated)}")
    if options.json:
        shown = {"files": [str(path) for path in paths], **({"resources": estimated} if estimated else {})}
        print(json.dumps(shown, indent=2, ensure_ascii=False))
    return 0


if __name__ == "__main__":
    sys.exit(cli.run(main))
