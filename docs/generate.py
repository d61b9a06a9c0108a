"""Tables of the documentation that the code determines.

They stand in README.md and docs/*.md between ``<!-- generated: NAME -->`` and ``<!-- end -->``.

    python docs/generate.py            rewrite them
    python docs/generate.py --check    change nothing; exit status 1 if a table is out of date

The resource estimates are those that ``PYTHONPATH=tests python -m support.baselines`` measured last.
"""

import argparse
import dataclasses
import inspect
import json
import re
import sys
from pathlib import Path

from amaranth.hdl import Fragment, Shape
from amaranth.lib import data, wiring

from cmfpga.build import formats, ports
from cmfpga.config import PRESETS, Config, preset
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.registers import register_map
from cmfpga.protocol.registers.documents import markdown
from cmfpga.protocol.results import RESULTS, trace_shape
from cmfpga.protocol.settings import SETTINGS
from cmfpga.protocol.shapes import leaves
from cmfpga.rtl import payloads
from cmfpga.rtl.top import VerilogCore
from cmfpga.tracking.loop import COLUMNS
from cmfpga.verilog import resources

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "boards").rglob("*.md"))]
BLOCK = re.compile(r"(<!-- generated: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
RESOURCES = ROOT / "tests" / "verilog" / "baselines.json"

#: The two architectures, the default one first.
BOTH = ("fast", "paper")

# What no docstring says in a few words: how often a block takes an item.
THROUGHPUT = {
    "ingest_control": "one event a cycle",
    "roi_filter": "one event a cycle",
    "thinner": "one event a cycle",
    "event_buffer": "one event a cycle, in and out",
    "reciprocal": "one division at a time",
    "dither": "one event a cycle",
    "time_scaler": "one event a cycle",
    "warp": "one event a cycle",
    "voter": "one event a cycle",
    "accumulator": "one event, or one swept address, a cycle",
    "gradient_reader": "four pixels a cycle",
    "tagged_accumulator": "one event a cycle",
    "one_pass_gradient": "one event a cycle",
    "gradient": "one gradient in {lead} cycles",
    "schedule": "one iteration a cycle",
    "ascent": "one gradient in two cycles",
    "roi_updater": "one move in {latency} cycles",
    "iteration_control": "one batch at a time",
}

# The CSV of `track`: unit and meaning.
CSV = {
    "batch": ("", "number of the batch, from 0"),
    "t_ref_us": ("µs", "middle of the batch's time range, on the recording's clock; empty for a batch without events"),
    "events": ("events", "N, events of the batch, of the whole sensor"),
    "roi_events": ("events", "n, events in the ROI that the buffer holds; these are what v is found from"),
    "roi_x": ("px", "left column of the ROI that the batch was cut with"),
    "roi_y": ("px", "top row of that ROI"),
    "vx": ("px per half batch", "velocity along x, positive to the right; of a degenerate batch, the one before it"),
    "vy": ("px per half batch", "velocity along y, positive downwards"),
    "vx_px_per_s": ("px/s", "the same in px/s; empty for a degenerate batch"),
    "vy_px_per_s": ("px/s", "the same in px/s; empty for a degenerate batch"),
    "iterations": ("", "iterations done; 0 for a degenerate batch"),
    "cycles": ("clock cycles", "from the offer of the first event to the result; empty for engines without a clock"),
    "contrast": (
        "(events/px)²",
        "population variance of the image of warped events at (vx, vy), computed in float64 for every engine",
    ),
    "flags": ("", "names of the flags that are set, joined by `\\|`; empty where nothing was unusual"),
}

# Ports of the emitted Verilog, beside those that the tables of settings and results tell.
PORTS = {
    "clk": "the only clock; rising edge",
    "rst": "synchronous reset, active high",
    "event_valid": "an event is offered",
    "event_ready": "it is accepted in this cycle",
    "event_t": "time stamp, µs; may wrap",
    "event_x": "column, px, 0 = left",
    "event_y": "row, px, 0 = top",
    "event_last": "this event ends the batch",
    "schedule_valid": "write an entry of the schedule's table; only while no batch is under way",
    "schedule_address": "which entry",
    "schedule_entry_level": "pixels 2^level px wide",
    "schedule_entry_shift": "v moves by 2^shift units of its last bit",
    "schedule_entry_stride": "every 2^stride-th of the stored events",
    "result_valid": "a result is offered, and stays as it is until it is taken",
    "result_ready": "take it",
    "result_sums_i": "ΣI of the last iteration, raw; no sum means anything in a degenerate batch",
    "trace_valid": "an iteration's sums are valid (for verification; leave open)",
    "trace_pixels_valid": "the sweep has read four pixels (for verification; leave open)",
    "trace_pixels_i": "I of the pixel in bank 0 … 3",
    "trace_pixels_dx": "Dx of that pixel",
    "trace_pixels_dy": "Dy of that pixel",
}


def table(head, rows, right=()):
    """Markdown of a table; ``right`` are the columns that hold numbers."""
    rule = ["---:" if k in right else "---" for k in range(len(head))]
    return "".join(f"| {' | '.join(map(str, row))} |\n" for row in (head, rule, *rows))


def elaborated(config):
    """A core that has been elaborated once (Amaranth warns of those that never are)."""
    core = VerilogCore(config)
    Fragment.get(core, None)
    return core


# -------------------------------------------------------------------- tables


def formats_table():
    """Formats of `fast` and of `paper`, side by side."""
    fast, paper = (formats(preset(name)) for name in BOTH)
    rows = [
        (name, fast[name]["format"], fast[name]["bits"], paper[name]["format"], paper[name]["bits"], what["meaning"])
        for name, what in fast.items()
    ]
    rows = [(*row[:-1], re.sub(r", 1\.0 = \d+", "", row[-1])) for row in rows]
    return table(("value", "`fast`", "bits", "`paper`", "bits", "meaning"), rows, right=(2, 4))


def latencies_table():
    cores = [elaborated(preset(name)) for name in BOTH]
    rows = []
    for name in THROUGHPUT:
        latencies = [core.latencies.get(name, "") for core in cores]
        if any(latencies):
            files = dict.fromkeys(block_file(core.blocks[name]) for core in cores if name in core.blocks)
            rows.append((", or ".join(files), *latencies))
    return table(("block", "`fast`", "`paper`"), rows, right=(1, 2))


def block_file(block):
    """Where the block stands, below ``src``."""
    return f"`{type(block).__module__.replace('.', '/')}.py`"


def constants_table():
    """What L and the batch's constant are the sums of."""
    rows = []
    for name in BOTH:
        core = elaborated(preset(name))
        steps = ("warp", "voter", [*core.image.blocks][-1], "gradient", "ascent")
        if core.sweep_cycles:
            counted, more, why = "swept address counts in P/4", 2, "`OPEN`, `JUDGE`"
            before, after = (), ("roi_updater",)
        else:
            counted, more, why = "event counts in n", 3, "`OPEN`, `JUDGE`, `RESULT`"
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


def cycles_table():
    """Formula of each preset, and of `paper` in other sizes, beside the article's."""
    events, roi_events = 5000, 800
    rows = []
    sizes = [("paper", size) for size in (32, 48, 128)]
    for name, size in [*((name, None) for name in PRESETS), *sizes]:
        config = preset(name)
        config = config.replace(roi_width=size, roi_height=size) if size else config
        core = elaborated(config)
        schedules = ((None,) * config.iterations,)
        if hasattr(core, "schedule_write"):
            schedules = (config.cold_schedule, config.warm_schedule)
        ours = [core.cycles(events=events, roi_events=roi_events, iterations=one) for one in schedules]
        shown = " / ".join(f"{cycles:,} (T = {len(one)})" for cycles, one in zip(ours, schedules, strict=True))
        article = events + 100 * (roi_events + 32 + config.geometry.pixels // 4 + 35)
        what = f"`{name}`" if size is None else f"`{name}`, other size"
        size = f"{config.roi_width}×{config.roi_height}"
        rows.append((what, size, f"`{core.cycle_formula}`", shown, f"{article:,}"))
    head = ("preset", "ROI, px", "cycles of a batch", f"N = {events}, n = {roi_events}", "article's formula, T = 100")
    return table(head, rows, right=(3, 4))


def memories_table():
    rows = []
    for name in BOTH:
        config = preset(name)
        word = payloads.pixel(config)
        event = Shape.cast(payloads.roi_event(config).as_shape()).width
        rows.append((f"`{name}`: ROI events (t, x, y)", 1, config.buffers * config.buffer_events, event))
        widths = {
            title: Shape.cast(word[member].shape).width for member, title in (("i", "I"), ("dx", "Dx"), ("dy", "Dy"))
        }
        if config.gradient == "one_pass":
            bits = config.tag_bits + sum(widths.values())
            rows.append((f"`{name}`: tag, Dy, Dx and I, by parity", 4, config.geometry.bank_depth, bits))
        else:
            rows += [
                (f"`{name}`: {title}, by parity", 4, config.geometry.bank_depth, bits) for title, bits in widths.items()
            ]
    rows = [(*row, f"{row[1] * row[2] * row[3]:,}") for row in rows]
    return table(("memory", "number", "words", "bits a word", "bits in all"), rows, right=(1, 2, 3, 4))


def flags_table():
    """From the comments beside the flags."""
    meanings = dict(re.findall(r"^    (\w+) = \d+  # (.+)$", inspect.getsource(Flag), re.MULTILINE))
    rows = [(f"`{flag.text}`", flag.bit_length() - 1, meanings[flag.name]) for flag in Flag]
    return table(("flag", "bit", "meaning"), rows, right=(1,))


def csv_table():
    return table(("column", "unit", "meaning"), [(f"`{name}`", *CSV[name]) for name in COLUMNS])


def sweep_table():
    """Columns of a sweep's results; pandas need not be installed for the other tables."""
    from cmfpga.sweep.tables import RESULTS

    rows = [(f"`{name}`", meaning) for name, (_, meaning) in RESULTS.items()]
    return table(("column of `results`", "meaning"), rows)


def meanings(config):
    """What each port is for, by its name."""
    found = {}
    declared = [("settings", s.name, s.shape_of(config), s.places, *s.doc_of(config)) for s in SETTINGS]
    declared += [("result", f.name, f.shape(config), f.places, f.doc, f.unit) for f in RESULTS if f.when(config)]
    for group, name, shape, places, doc, unit in declared:
        for leaf in leaves(name, shape):
            place = next((place for place in places if name + place.part == leaf), None)
            text = doc
            if place and place.part:
                text = place.doc if place.field == "VALUE" else f"{doc}: {place.doc}"
            found[f"{group}_{leaf}"] = f"{text} ({unit})" if unit else text
    of_trace = (leaf for name, shape in trace_shape(config).items() for leaf in leaves(name, shape))
    return found | {f"trace_{leaf}": f"as `result_{leaf}`, of this iteration" for leaf in of_trace} | PORTS


def ports_table():
    """Ports of `fast`, then what only `paper` has."""
    rows = {}
    for name in BOTH:
        config = preset(name)
        values = meanings(config)
        for port in ports(elaborated(config)):
            key = re.sub(r"^trace_pixels_\d_", "trace_pixels_", port["name"])
            shown = re.sub(r"^(trace_pixels)_(i|dx|dy)$", r"\1_0_\2 … \1_3_\2", key)
            row = rows.setdefault(
                key,
                {"port": f"`{shown}`".replace(" … ", "` … `"), "direction": port["direction"],
                 "meaning": values[key]},
            )  # fmt: skip
            row[name] = f"{port['bits']}{' signed' if port['signed'] else ''}"
    head = ("port", "direction", *(f"bits, `{name}`" for name in BOTH), "meaning")
    lines = [[row.get(part, "–") for part in ("port", "direction", *BOTH, "meaning")] for row in rows.values()]
    return table(head, lines, right=(2, 3))


def fields_table():
    rows = []
    for field in dataclasses.fields(Config):
        meta = field.metadata
        if meta["choices"]:
            allowed = ", ".join(meta["choices"])
        else:
            low, high = meta["low"], meta["high"]
            allowed = "" if low is None else f"{low:g} …" if high is None else f"{low:,} … {high:,}"
        rows.append((f"`{field.name}`", field.default, allowed, meta["unit"], meta["doc"], "yes" * meta["runtime"]))
    return table(("field", "default", "allowed", "unit", "meaning", "run-time"), rows)


def blocks_table():
    """Blocks in the order of the diagram, with ports and latency."""
    rows = {}
    for preset_name in BOTH:
        core = elaborated(preset(preset_name))
        for name in THROUGHPUT:
            block = core.blocks.get(name)
            if block is None:
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
        return f"{arrow} `{name}` ({', '.join(member.signature.members)})"
    kind = "flow" if member.signature.always_ready else "stream"
    return f"{arrow} `{name}` {kind}{_fields(member.signature.members['payload'].shape)}"


def _fields(shape):
    if isinstance(shape, data.StructLayout):
        return f" ({', '.join(shape.members)})"
    if isinstance(shape, data.ArrayLayout):
        return f" {shape.length} ×{_fields(shape.elem_shape)}"
    return ""


def resources_table(name):
    stored = json.loads(RESOURCES.read_text(encoding="utf-8"))["presets"][name]
    head, families = (f"preset `{name}`", *resources.KINDS.values()), ("Yosys family", *resources.FAMILY.values())
    made = table(head, [families, *resources.rows(stored)], right=range(1, len(head)))
    return f"{made}\nYosys {stored['yosys']}.\n"


def widths_table():
    stored = json.loads(RESOURCES.read_text(encoding="utf-8"))["widths"]
    kinds = ("lut", "ff", "bram36", "dsp")
    rows = [(name, *(f"{row[kind]:,}".removesuffix(".0") for kind in kinds)) for name, row in stored.items()]
    head = ("fraction bits: dt, v, position, weight, derivative, dither", *(resources.KINDS[kind] for kind in kinds))
    return table(head, rows, right=range(1, len(head)))


def registers_table():
    """All registers of the default preset, and what the other ascent has in their place."""
    shared, others = register_map(preset("fast")), register_map(preset("paper"))
    only = [register for register in others if register.name not in shared]
    text = markdown(shared)
    rows = "\n".join(line for line in markdown(only).split("\n\n| access")[0].splitlines()[2:])
    return f"{text}\nWith `ascent=constant` (preset `paper`), in place of `COLD`, `WARM` and `SCHEDULE`:\n\n{rows}\n"


TABLES = {
    "registers": registers_table,
    "formats": formats_table,
    "latencies": latencies_table,
    "constants": constants_table,
    "cycles": cycles_table,
    "memories": memories_table,
    "flags": flags_table,
    "csv": csv_table,
    "sweep": sweep_table,
    "ports": ports_table,
    "fields": fields_table,
    "blocks": blocks_table,
    "resources_fast": lambda: resources_table("fast"),
    "resources_paper": lambda: resources_table("paper"),
    "resources_of_widths": widths_table,
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
