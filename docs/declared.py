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
from cmfpga.protocol.registers.layout import ACCESS
from cmfpga.protocol.results import fields_of
from cmfpga.protocol.shapes import leaves
from cmfpga.tracking.columns import COLUMNS

RESOURCES = json.loads((Path(__file__).parents[1] / "tests" / "fpga" / "baselines.json").read_text(encoding="utf-8"))


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
        name = f"`{field.name}`" + "*" * meta["runtime"]
        rows.append((name, field.default, " ".join(filter(None, (allowed, meta["unit"]))), meta["doc"]))
    return table(("field", "default", "allowed", "meaning"), rows)


def resources_table():
    """LUT, FF, block RAM and DSP of the core, alone and with AXI, of `fast` and of `paper` side by side."""
    stored = RESOURCES["presets"]
    kinds = [list(resources.KINDS).index(kind) + 1 for kind in ("lut", "ff", "bram36", "dsp")]
    found = [{row[0]: [row[k] for k in kinds] for row in resources.rows(stored[name])} for name in ("fast", "paper")]
    what = [*found[0]]
    what = what[what.index("sum of the blocks") + 1 :]
    titles = [title for name in ("fast", "paper") for title in (f"`{name}`: LUT", "FF", "BRAM36", "DSP")]
    rows = [(name, *(value for one in found for value in one[name])) for name in what]
    made = table(("", *titles), rows, right=range(1, 9))
    return f"{made}\nYosys {stored['fast']['yosys']}.\n"


def brief(registers, ports=None):
    """One line for each register, two halves of a number in one: shorter than what ``build --top`` writes of them.

    Neighbours of one number that mean what the core's ports of their names do share a line; ``ports``: names by group.
    """
    rows, last = [], None
    for register in registers:
        name, kinds = register.name, {f.access for f in register.fields}
        if name.endswith("_HIGH"):
            rows[-1][1] += ", `_HIGH`"
            continue
        said = f"`{name}`" + f" × {register.count}" * (register.count > 1)
        kind = kinds.pop() if len(kinds) == 1 else ""
        number, known = register.fields[0], (ports or {}).get(register.group, ())
        same = number.name == "VALUE" and name.removeprefix("RESULT_").lower() in known
        if same and number.writable and number.reset:
            said += f" ({number.reset:#x})"
        if same and last == (kind, register.offset - 4):
            rows[-1][1] += f", {said}"
        else:
            bits = [field_in_brief(f, "" if kind else f" ({f.access})") for f in register.fields]
            rows.append([f"`{register.offset:#05x}`", said, kind, "" if same else "<br>".join(bits)])
        last = (kind, register.offset) if same else None
    return table(("offset", "register", "access", "bits"), rows, right=(0,))


def field_in_brief(f, access):
    """Name, bits, access where a register has several, and meaning of a field, unless its name says it."""
    doc = "" if f.doc.startswith(("as the flag of", "interrupt when")) else f.doc
    doc += f" ({f.unit})" * bool(f.unit)
    doc += f", reset {f.reset:#x}" * bool(f.reset and f.writable)
    doc += "".join(f", {value} = {key}" for key, value in f.values.items())
    if (f.width, f.name) == (32, "VALUE"):
        return doc
    bits = f"{f.lsb + f.width - 1}:{f.lsb}" if f.width > 1 else f"{f.lsb}"
    return f"`{bits} {f.name}`{access} {doc}".rstrip()


def region_registers_table():
    """What hardware of preset ``flow`` has besides."""
    known = {register.name for name in ("fast", "paper") for register in register_map(preset(name))}
    more = register_map(preset("flow"))
    return brief([register for register in more if register.name not in known])


def registers_table():
    """All registers of the default preset, and what the other ascent has in their place."""
    shared, others = register_map(preset("fast")), register_map(preset("paper"))
    only = [register for register in others if register.name not in shared]
    kinds = table(("access", "meaning"), [item for item in ACCESS.items() if item[0] != "written"])
    constant = "With `ascent=constant` (preset `paper`), instead of `COLD`, `WARM` and `SCHEDULE`:"
    config = preset("fast")
    results = {leaf for f in fields_of("batch", "region", config=config) for leaf in leaves(f.name, f.shape(config))}
    ports = {"Result": results, "Settings": set(shared.linked("Settings"))}
    return f"{brief(shared, ports)}\n{kinds}\n{constant}\n\n{brief(only)}"


DECLARED = {
    "registers": registers_table,
    "region_registers": region_registers_table,
    "flags": flags_table,
    "csv": lambda: columns_table(COLUMNS),
    "flow_columns": lambda: columns_table(FLOW, "column, or array with this shape"),
    "sweep": sweep_table,
    "fields": fields_table,
    "resources": resources_table,
}
