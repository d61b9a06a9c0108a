"""Tables of the documentation that the code determines.

They stand in README.md and docs/*.md between ``<!-- generated: NAME -->`` and ``<!-- end -->``.

    python docs/tables.py            rewrite them
    python docs/tables.py --check    change nothing; exit status 1 if a table is out of date

``declared.py`` beside this has the tables that are not of the core, ``timed.py`` those of cycles and clock.
"""

import argparse
import re
import sys
from pathlib import Path

import numpy as np
from amaranth.hdl import Shape
from amaranth.lib import data, wiring
from declared import DECLARED, table
from status import status_table
from timed import TIMED, elaborated

from cmfpga.config import preset
from cmfpga.imaging.camera import Camera, nearest, undistort
from cmfpga.rtl import payloads
from cmfpga.rtl.ingest.noise_filter import stamps
from cmfpga.verilog.description import formats
from cmfpga.verilog.ports import port_table

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "boards").rglob("*.md"))]
BLOCK = re.compile(r"(<!-- generated: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
BOTH = ("fast", "paper")  # the two architectures, the default one first

# What no docstring says in a few words: how often a block takes an item; blocks in the order of the diagram.
THROUGHPUT = {
    **dict.fromkeys(("ingest_control", "roi_filter", "thinner"), "one event a cycle"),
    "event_buffer": "one event a cycle, in and out",
    "reciprocal": "one division at a time",
    **dict.fromkeys(("dither", "time_scaler", "warp", "voter"), "one event a cycle"),
    "evaluators": "one event, four times, in four cycles; or side by side in one",
    "accumulator": "one event, or one swept address, a cycle",
    "gradient_reader": "four pixels a cycle",
    **dict.fromkeys(("tagged_accumulator", "one_pass_gradient"), "one event a cycle"),
    "gradient": "one gradient in {lead} cycles",
    "schedule": "one iteration a cycle",
    "means": "one round at a time",
    "ascent": "one step in {latency} cycles",
    "judge": "one verdict in {latency} cycles",
    "roi_updater": "one move in {latency} cycles",
    "iteration_control": "one batch at a time",
}


# -------------------------------------------------------------------- tables


def formats_table():
    """Formats of `fast` and of `paper`, side by side."""
    fast, paper = (formats(preset(name)) for name in BOTH)
    rows = []
    for name, what in fast.items():
        both = (each[key] for each in (what, paper[name]) for key in ("format", "bits"))
        rows.append((name, *both, re.sub(r", 1\.0 = \d+", "", what["meaning"])))
    return table(("value", "`fast`", "bits", "`paper`", "bits", "meaning"), rows, right=(2, 4))


def constants_table():
    """What L and the batch's constant are the sums of."""
    rows = []
    for name in BOTH:
        core = elaborated(preset(name))
        moves = [name for name in ("warp", "voter", "evaluators") if name in core.blocks]
        steps = (*moves, [*core.image.blocks][-1], "gradient", "ascent")
        if core.sweep_cycles:
            counted, more, why = "swept address counts in P/4", 5, "`OPEN`, `TAKE`, three of `JUDGE`"
            before, after = (), ("roi_updater",)
        else:
            counted, more, why = "event counts in n", 6, "`OPEN`, `TAKE`, three of `JUDGE`, `RESULT`"
            before, after = ("dither",), ()
        whole = ("roi_filter", "thinner", "reciprocal", "event_buffer", *before, "time_scaler", *after)
        for what, blocks, extra, reason, total in (
            (f"L, `{name}`", steps, -1, f"−1 because the last {counted}", core.iteration_latency),
            (f"per batch, `{name}`", whole, more, f"+{more} for {why}", core.batch_latency),
        ):
            if sum(core.latencies[block] for block in blocks) + extra != total:
                raise AssertionError(f"{what}: {blocks} and {extra} do not make {total}")
            made = " + ".join(f"{core.latencies[block]} `{block}`" for block in blocks)
            rows.append((what, f"{made}; {reason}", total))
    return table(("constant", "made of", "cycles"), rows, right=(2,))


def memories_table():
    rows = []
    for name in BOTH:
        config = preset(name)
        word = payloads.pixel(config)
        event = Shape.cast(payloads.roi_event(config).as_shape()).width
        rows.append((f"`{name}`: ROI events (t, x, y)", 1, config.buffers * config.buffer_events, event))
        widths = {title: Shape.cast(word[title.lower()].shape).width for title in ("I", "Dx", "Dy")}
        if config.gradient == "one_pass":
            widths = {"tag, Dy, Dx and I": config.tag_bits + sum(widths.values())}
        depth = config.geometry.bank_depth
        rows += [(f"`{name}`: {title}, by parity", 4, depth, bits) for title, bits in widths.items()]
    rows = [(*row, f"{row[1] * row[2] * row[3]:,}") for row in rows]
    return table(("memory", "number", "words", "bits a word", "bits in all"), rows, right=(1, 2, 3, 4))


def ports_table():
    """Ports of `fast`, then what only `paper` has. Those that are left open need no line each."""
    rows = {}
    for name in BOTH:
        for port in port_table(elaborated(preset(name))):
            row = rows.setdefault(port.name, {"direction": port.direction, "meaning": port.meaning})
            row[name] = f"{port.bits}{' signed' if port.signed else ''}"
    head = ("port", "direction", *(f"bits, `{name}`" for name in BOTH), "meaning")
    lines = [(f"`{port}`", *(row.get(part, "–") for part in ("direction", *BOTH, "meaning")))
             for port, row in rows.items() if not port.startswith("trace_")]  # fmt: skip
    lines.append(("`trace_…`", "output", "", "", "for verification; leave open"))
    return table(head, lines, right=(2, 3))


def blocks_table():
    """Blocks with ports and latency."""
    rows = {}
    for preset_name in BOTH:
        core = elaborated(preset(preset_name))
        for name in THROUGHPUT:
            if (block := core.blocks.get(name)) is None:
                continue
            kind = type(block)
            latency = core.latencies.get(name, "")
            rate = THROUGHPUT[name].format(latency=latency, lead=getattr(block, "lead", ""))
            members = "; ".join(_port(*item) for item in block.signature.members.items())
            what = f"`{kind.__module__.removeprefix('cmfpga.')}.{kind.__name__}`"
            row = rows.setdefault((name, kind), {"what": what, "members": members, "rate": rate})
            row[preset_name] = latency
    order = sorted(rows, key=lambda key: list(THROUGHPUT).index(key[0]))
    head = ("block", "ports", *(f"latency, `{name}`" for name in BOTH), "throughput")
    lines = [[rows[key].get(part, "–") for part in ("what", "members", *BOTH, "rate")] for key in order]
    return table(head, lines, right=(2, 3))


def _port(name, member):
    arrow = "→" if member.flow == wiring.In else "←"
    if not member.is_signature:
        return f"{arrow} `{name}`{_fields(member.shape)}"
    if "payload" not in member.signature.members:
        return f"{arrow} `{name}`{_named(member.signature.members)}"
    kind = "flow" if member.signature.always_ready else "stream"
    return f"{arrow} `{name}` {kind}{_fields(member.signature.members['payload'].shape)}"


def _fields(shape):
    if isinstance(shape, data.StructLayout):
        return _named(shape.members)
    if isinstance(shape, data.ArrayLayout):
        return f" {shape.length} ×{_fields(shape.elem_shape)}"
    return ""


def _named(members):
    """Names of fields, but of the settings, which stand among the ports."""
    return f" ({', '.join(members)})" if len(members) < 8 else f" ({len(members)} fields)"


def noise_table():
    rows = []
    for width, height in ((240, 180), (346, 260), (640, 480), (1280, 720)):
        bits = [f"{32 * preset().replace(sensor_width=width, sensor_height=height).geometry.mask_depth:,}"]
        for cell in (2, 3, 4):
            sized = {"sensor_width": width, "sensor_height": height, "background": 1, "background_cell": cell}
            config = preset().replace(**sized)
            bits.append(f"{Shape.cast(stamps(config).as_shape()).width * config.geometry.cell_depth:,}")
        rows.append((f"{width}×{height} px", *bits))
    heads = ("sensor", "mask, bits", *(f"cells of {1 << cell}×{1 << cell} px, bits" for cell in (2, 3, 4)))
    return table(heads, rows, right=(1, 2, 3, 4))


#: Measured lenses: that of a DAVIS 240C, and the same distortion on a larger sensor.
LENSES = {
    (240, 180): "199.092367,198.82882,132.192071,110.71266,-0.368436,0.150947,-0.000296,-0.000759,0",
    (640, 480): "530,530,320,240,-0.368436,0.150947,-0.000296,-0.000759,0",
}


def undistortion_table():
    rows = []
    for (width, height), lens in LENSES.items():
        config = preset().replace(sensor_width=width, sensor_height=height, undistortion="on", camera=lens)
        y, x = (axis.ravel() for axis in np.mgrid[0:height, 0:width])
        true = Camera(*config.lens).undistorted(x, y)
        _, _, there = nearest(config, *true)
        bits = config.formats.node_x.width + config.formats.node_y.width
        pixel_bits = bits - 4  # no bits for an interpolation
        kinds, cells = [("per pixel", width * height * pixel_bits, np.floor(true * 16 + 0.5))], (2, 3, 4, 5)
        if width > 240:  # what the presets have, and twice that
            kinds, cells = [], (3, 4)
        for cell in cells:
            sized = config.replace(undistortion_cell=cell)
            memory = sized.geometry.node_columns * sized.geometry.node_rows * bits
            kinds.append((f"nodes of {1 << cell} px", memory, np.stack(undistort(sized, sized.lens, x, y))))
        for kind, memory, found in kinds:
            error = np.hypot(*(found / 16 - true))[there]
            rms = np.sqrt((error**2).mean())
            rows.append((f"{width}×{height}", kind, f"{memory:,}", f"{rms:.3f}", f"{error.max():.2f}"))
    heads = ("sensor, px", "table", "memory, bits", "error, rms, px", "at most")
    return table(heads, rows, right=(2, 3, 4))


TABLES = {
    **DECLARED,
    **TIMED,
    "formats": formats_table,
    "constants": constants_table,
    "memories": memories_table,
    "noise": noise_table,
    "undistortion": undistortion_table,
    "ports": ports_table,
    "blocks": blocks_table,
    "status": status_table,
}


# -------------------------------------------------------------------- pages


def rewritten(text, tables):
    """``text`` with those of its generated tables that ``tables`` names; any other name is an error."""

    def replace(match):
        begin, name, end = match.groups()
        if name not in tables:
            raise KeyError(f"no table is called {name}; the names are {', '.join(TABLES)}")
        return begin + tables[name] + end

    return BLOCK.sub(replace, text)


def main(arguments=None):
    """Run the command; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="change nothing; status 1 if a table is out of date")
    options = parser.parse_args(arguments)
    tables = {name: make() for name, make in TABLES.items()}
    stale = []
    for page in PAGES:
        old = page.read_text(encoding="utf-8")
        new = rewritten(old, tables)
        if new != old:
            stale.append(page)
            if not options.check:
                page.write_text(new, encoding="utf-8")
    for page in stale:
        print(f"{'out of date' if options.check else 'rewrote'}: {page.relative_to(ROOT)}")
    return int(options.check and bool(stale))


if __name__ == "__main__":
    sys.exit(main())
