"""Tables of what the package declares beside the core, and of the resources that were measured last.

Those are of the last run of ``PYTHONPATH=tests python -m support.baselines``, and of that with ``placed``.
"""

import dataclasses
import inspect
import json
import re
from pathlib import Path

from cmfpga.config import Config, preset
from cmfpga.dense.window import COLUMNS as FLOW
from cmfpga.fpga import resources
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.registers import register_map
from cmfpga.protocol.registers.documents import markdown
from cmfpga.tracking.columns import COLUMNS

RESOURCES = Path(__file__).resolve().parents[1] / "tests" / "fpga" / "baselines.json"


def table(head, rows, right=()):
    """Markdown of a table; ``right`` are the columns that hold numbers."""
    rule = ["---:" if k in right else "---" for k in range(len(head))]
    return "".join(f"| {' | '.join(map(str, row))} |\n" for row in (head, rule, *rows))


def flags_table():
    """From the comments beside the flags."""
    meanings = dict(re.findall(r"^    (\w+) = \d+  # (.+)$", inspect.getsource(Flag), re.MULTILINE))
    rows = [(f"`{flag.text}`", flag.bit_length() - 1, meanings[flag.name]) for flag in Flag]
    return table(("flag", "bit", "meaning"), rows, right=(1,))


def columns_table(columns, head="column"):
    """What is declared of columns; of arrays with their shapes."""
    columns = columns.values()
    more = [name for name in ("shape", "unit") if any(getattr(column, name) for column in columns)]
    rows = [(f"`{one.name}`", *(getattr(one, name) for name in more), one.doc.replace("|", "\\|")) for one in columns]
    return table((head, *more, "meaning"), rows)


def sweep_table():
    """Columns of a sweep's results; pandas need not be installed for the other tables."""
    from cmfpga.sweep.tables import RESULTS

    return columns_table(RESULTS, "column of `results`")


def fields_table():
    rows = []
    for field in dataclasses.fields(Config):
        meta = field.metadata
        if meta["choices"]:
            allowed = ", ".join(map(str, meta["choices"]))
        else:
            low, high = meta["low"], meta["high"]
            allowed = "" if low is None else f"{low:g} …" if high is None else f"{low:,} … {high:,}"
        rows.append((f"`{field.name}`", field.default, allowed, meta["unit"], meta["doc"], "yes" * meta["runtime"]))
    return table(("field", "default", "allowed", "unit", "meaning", "run-time"), rows)


def resources_table(name):
    stored = json.loads(RESOURCES.read_text(encoding="utf-8"))["presets"][name]
    head, families = (f"preset `{name}`", *resources.KINDS.values()), ("Yosys family", *resources.FAMILY.values())
    made = table(head, [families, *resources.rows(stored)], right=range(1, len(head)))
    return f"{made}\nYosys {stored['yosys']}.\n"


def region_registers_table():
    """What hardware of preset ``flow`` has beside that, and the word of a record that says whose it is."""
    known = {register.name for name in ("fast", "paper") for register in register_map(preset(name))}
    more = register_map(preset("flow"))
    return markdown([register for register in more if register.name not in known or register.name == "RESULT_FLAGS"])


def motion_registers_table():
    """What hardware of presets ``similarity`` and ``rotation`` has beside those of ``fast``, and of a camera."""
    known = {register.name for name in ("fast", "flow") for register in register_map(preset(name))}
    more = {register.name: register for name in ("similarity", "rotation") for register in register_map(preset(name))}
    return markdown(sorted((more[name] for name in {*more} - known), key=lambda register: register.offset))


def registers_table():
    """All registers of the default preset, and what the other ascent has in their place."""
    shared, others = register_map(preset("fast")), register_map(preset("paper"))
    only = [register for register in others if register.name not in shared]
    text = markdown(shared)
    rows = "\n".join(line for line in markdown(only).split("\n\n| access")[0].splitlines()[2:])
    return f"{text}\nWith `ascent=constant` (preset `paper`), in place of `COLD`, `WARM` and `SCHEDULE`:\n\n{rows}\n"


DECLARED = {
    "registers": registers_table,
    "region_registers": region_registers_table,
    "motion_registers": motion_registers_table,
    "flags": flags_table,
    "csv": lambda: columns_table(COLUMNS),
    "flow_columns": lambda: columns_table(FLOW, "column, or array with this shape"),
    "sweep": sweep_table,
    "fields": fields_table,
    "resources_fast": lambda: resources_table("fast"),
    "resources_paper": lambda: resources_table("paper"),
}
