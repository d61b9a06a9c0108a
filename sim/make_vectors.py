"""Write all that tb_cmfpga_core.v needs: the core, and what goes in and must come out, from the integer model.

Memories, and the Verilog that connects the core, follow from its ports: a new setting or field of the result needs
no edit here.
"""

import re
import shutil
import sys
from pathlib import Path

import numpy as np
import port_text as verilog
from batch_kinds import KINDS, Maker

from cmfpga import __version__, cli
from cmfpga.errors import ConfigError
from cmfpga.imaging.camera import node_writes
from cmfpga.protocol.confidence import Curvature
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.results import fields_of, sums_shape
from cmfpga.protocol.settings import settings_values, table_entry
from cmfpga.reference.integer.core import IntegerCore
from cmfpga.rtl.payloads import schedule_entry
from cmfpga.rtl.top import VerilogCore
from cmfpga.verilog.emit import TOP, emit_verilog

BENCH = Path(__file__).with_name(f"tb_{TOP}.v")
EXAMPLES = (
    "python sim/make_vectors.py --out build/sim",
    "python sim/make_vectors.py --preset paper --set roi_width=50 --batches 30 --seed 7 --out build/sim",
)


def leaves(value, name):
    """``{port: raw integer}`` of a dictionary of dictionaries, a curvature, pairs of x and y, and integers."""
    if isinstance(value, tuple):
        names = {1: ("least",), 2: "xy", 3: Curvature._fields}[len(value)]
        value = dict(zip(names, value, strict=True))
    if not isinstance(value, dict):
        return {name: value}
    return {port: leaf for key, part in value.items() for port, leaf in leaves(part, f"{name}_{key}").items()}


def pack(row, widths):
    """One word of a memory for ``$readmemb``: the first column at the top; X where the model says nothing."""
    bits = []
    for (name, value), width in zip(row.items(), widths.values(), strict=True):
        if value is not None and not -(1 << width >> 1) <= value < 1 << width:
            raise AssertionError(f"{name}: {value} does not fit {width} bits")
        bits.append("x" * width if value is None else f"{int(value) & ((1 << width) - 1):0{width}b}")
    return "".join(bits)


class Vectors:
    """The memories' words, filled batch by batch.

    ``columns`` are of each memory ``{column: bits}``: those that have the name of a port go there, or must come from
    there. ``rows`` are of each memory a list of ``{column: value}``.
    """

    def __init__(self, config):
        self.config = config
        self.core = VerilogCore(config)
        self.verilog = emit_verilog(self.core)
        self.model = IntegerCore(config)
        self.seen = Flag(0)
        self.ports = {**self.core.inputs, **self.core.outputs}
        self.columns = {
            "batches": {"count": 32, "stall": 16, "reset_after": 32, "alone": 1, **self.widths("settings_")},
            "events": {"gap": 8, **self.widths("event_")},
            "results": {"count": 32, **self.widths("result_")},
            "trace": self.widths("trace_(?!pixels_)"),
            "schedule": self.widths("schedule_"),
            "nodes": self.widths("node_"),
        }
        self.table = ()
        self.rows = {memory: [] for memory, columns in self.columns.items() if columns}

    def widths(self, prefix):
        """``{port: bits}`` of those that carry values, not valid and ready."""
        names = (name for name in self.ports if re.match(prefix, name) and not name.endswith(("_valid", "_ready")))
        return {name: len(self.ports[name]) for name in names}

    def write_schedule(self, table):
        """Have the bench fill the core's table of schedules."""
        self.table = table
        for address, values in enumerate(table):
            entry = dict(zip(schedule_entry(self.config).members, table_entry(self.config, values), strict=True))
            self._put("schedule", leaves({"address": address, "entry": entry}, "schedule"))

    def write_nodes(self):
        """Have the bench fill the core's table that undistorts."""
        for node in node_writes(self.config, self.config.lens) if self.columns["nodes"] else ():
            self._put("nodes", leaves(dict(zip(("column", "row", "x", "y"), node, strict=True)), "node"))

    def settings(self, batch):
        """``{port: value}``; the schedules are looked up in the table."""
        values = settings_values(self.config, batch.settings)
        for name in ("cold", "warm") if self.table else ():
            plan = getattr(batch.settings, name)
            values[f"{name}_first"] = next(k for k in range(len(self.table)) if self.table[k : k + len(plan)] == plan)
        return values

    def add(self, batch):
        """Play ``batch`` into the model and append what it needs and gives."""
        config = self.config
        n = len(batch.t)
        if n > config.max_batch_events:
            raise ConfigError(f"max_batch_events = {config.max_batch_events}: a batch of {n} events is made here")
        cut = batch.by_count and n == config.max_batch_events
        result = self.model.run(batch.t, batch.x, batch.y, batch.settings, cut=cut, keep=True)
        inputs = self.settings(batch)
        if batch.by_count and not cut:
            inputs["batch_events"] = n
        cycles, reset_after = None, 0
        sums = dict.fromkeys(sums_shape(config))  # they mean nothing in a degenerate batch
        if Flag.DEGENERATE not in result.flags:
            sums = dict(zip(sums, result.trace.last_sums, strict=True))
            work = {"roi_events": result.roi_events, "iterations": self.model.plan}
            # The formula holds for a batch that finds the core idle.
            if batch.alone or config.buffers == 1:
                cycles = self.core.cycles(events=n + int(batch.gaps[1:].sum()), **work)
            reset_after = int(batch.reset_at * self.core.cycles(events=0, **work))
        t = batch.t & ((1 << config.time_bits) - 1)
        for k in range(n):
            event = {"t": t[k], "x": batch.x[k], "y": batch.y[k], "last": k == n - 1 and not batch.by_count}
            self._put("events", {"gap": batch.gaps[k], **leaves(event, "event")})
        names = config.motion_model.names
        each = config.ascent_rule.evaluations  # of an iteration, whose v is that of a round's centre
        for k, iteration in enumerate(self.model.iterations):
            v = dict(zip(names, result.trace.v[k // each].tolist(), strict=True))
            self._put("trace", leaves({"v": v, "sums": iteration.sums.named(config)}, "trace"))
        header = {"count": n, "stall": batch.stall, "reset_after": reset_after, "alone": batch.alone}
        self._put("batches", header | leaves(inputs, "settings"))
        outputs = {field.name: getattr(result, field.name) for field in fields_of("batch", "region")}
        outputs |= {"v": dict(zip(names, self.model.v, strict=True)), "t_first": t[0], "flags": int(result.flags)}
        outputs |= {"sums": sums, "cycles": cycles}
        self._put("results", {"count": result.iterations * each, **leaves(outputs, "result")})
        if reset_after:
            self.model = IntegerCore(self.config)
        else:
            self.seen |= result.flags
        return result

    def _put(self, memory, row):
        self.rows[memory].append({name: row[name] for name in self.columns[memory]})

    def constants(self):
        """Numbers that the bench needs, by name."""
        config, core = self.config, self.core
        swept = core.sweep_cycles + core.image.latency if config.gradient == "sweep" else config.geometry.bank_depth
        return {
            "BUFFERS": config.buffers,
            **{memory.upper(): len(rows) for memory, rows in self.rows.items()},
            **{f"{memory.upper()}_BITS": sum(columns.values()) for memory, columns in self.columns.items()},
            "BANK_WORDS": config.geometry.bank_words,
            # After a reset the banks are swept; with a sweep per iteration, the sums of this one settle.
            "CLEARING": 1 + swept,
            # Twice the longest time in which nothing that the bench counts can happen.
            "PATIENCE": 2 * (config.buffer_events + config.geometry.bank_words + 500),
        }

    def include(self):
        """``vectors.vh``."""
        made = f"make_vectors.py of cmfpga {__version__} for configuration {self.config.hardware_hash[:16]}"
        lines = [
            f"// Written by {made}.",
            "// Numbers of words and clock cycles; the core's ports, and what is done with all of them.",
            *(f"localparam {name} = {value};" for name, value in self.constants().items()),
            *verilog.declarations(self.core),
            *verilog.fill_banks(self.core),
        ]
        for name in ("events", "batches"):
            lines += verilog.drive(name, self.columns[name], self.ports)
        for name, port in (("schedule", "schedule"), ("nodes", "node")):
            lines += verilog.write_table(name, port, self.columns[name])
        for name in ("results", "trace"):
            lines += verilog.compare(name, self.columns[name], self.ports)
        lines += verilog.pixels(self.widths("trace_pixels_"), self.columns["trace"])
        return "\n".join(lines) + "\n"

    def write(self, folder):
        """All files of the simulation into ``folder``."""
        (folder / f"{TOP}.v").write_text(self.verilog, encoding="ascii")
        shutil.copyfile(BENCH, folder / BENCH.name)
        (folder / "vectors.vh").write_text(self.include(), encoding="ascii")
        for memory, rows in self.rows.items():
            words = (pack(row, self.columns[memory]) for row in rows)
            (folder / f"{memory}.mem").write_text("".join(f"{word}\n" for word in words), encoding="ascii")


def make_vectors(config, *, batches, seed):
    """:class:`Vectors` of ``batches`` batches, each kind in turn; :exc:`ConfigError` of what the bench cannot play."""
    if config.hot_pixels:
        raise ConfigError("hot_pixels = 1: hot_pixels = 0 is needed, this bench has no more")
    config.motion_model.lens(config)  # raises where a rotation has none
    vectors = Vectors(config)
    maker = Maker(config, np.random.default_rng(seed))
    vectors.write_schedule(maker.table)
    vectors.write_nodes()
    roi = (0, 0)
    for number in range(batches):
        batch = maker.make(list(KINDS)[number % len(KINDS)], roi)
        result = vectors.add(batch)
        roi = (0, 0) if batch.reset_at else result.roi_next
    return vectors


def main(arguments=None):
    """Run the command; returns the exit status."""
    made = cli.parser("make_vectors", "Write the core and the vectors of its Verilog test bench.", EXAMPLES)
    made.prog = "python sim/make_vectors.py"
    made.add_argument("--out", default="build/sim", metavar="DIR", help="folder to write into (default: build/sim)")
    made.add_argument(
        "--batches", type=cli.positive, default=len(KINDS), metavar="B", help=f"batches (default: {len(KINDS)})"
    )
    made.add_argument("--seed", type=cli.natural, default=1, metavar="S", help="of the random events (default: 1)")
    cli.add_config_options(made)
    options = made.parse_args(arguments)
    config = cli.make_config(options)
    folder = cli.output_folder(options.out)
    vectors = make_vectors(config, batches=options.batches, seed=options.seed)
    vectors.write(folder)
    counts = ", ".join(f"{len(rows)} {memory}" for memory, rows in vectors.rows.items() if memory != "results")
    print(f"wrote {folder}: {counts}; flags {vectors.seen.text or 'none'}")
    return 0


if __name__ == "__main__":
    sys.exit(cli.run(main))
