"""The core's ports as people need them: direction, width, what each is for, what to tie it to.

All follows from the tables of settings, results and tables: a port that is added there appears by itself.
"""

import re
from dataclasses import dataclass

from ..protocol.results import RESULTS, trace_shape
from ..protocol.settings import SETTINGS
from ..protocol.shapes import leaves
from ..protocol.tables import tables_of

#: Ports that no table declares.
PORTS = {
    "clk": "the only clock; rising edge",
    "rst": "synchronous reset, active high",
    "aclk": "the only clock; rising edge",
    "aresetn": "synchronous reset, active low",
    "irq": "interrupt, active high",
    "uart_rx": "serial line to the core",
    "uart_tx": "serial line from the core",
    "busy": "a window, or what is evaluated of it, is under way",
    "event_valid": "an event is offered",
    "event_ready": "it is accepted in this cycle",
    "event_t": "time stamp, µs; may wrap",
    "event_x": "column, px, 0 = left",
    "event_y": "row, px, 0 = top",
    "event_last": "this event ends the batch",
    "schedule_valid": "write an entry of the schedule's table; only while no batch is under way",
    "schedule_address": "which entry",
    "schedule_entry_level": "pixels 2^level px wide",
    "schedule_entry_distance": "evaluated beside v: ¾, 1, 1½, 2 or 3 px, by its number from 0 on",
    "schedule_entry_limit": "v moves by at most ((2 + c mod 2) << c div 2) >> 1 units of its last bit",
    "schedule_entry_shift": "v moves by 2^shift units of its last bit",
    "schedule_entry_stride": "one event in 2^stride is used",
    "node_valid": "write a node of the table that undistorts; only while no batch is under way",
    "row_valid": "write a row of the table of regions; only while no batch is under way",
    "mask_valid": "write a word of the mask of hot pixels; only while no batch is under way",
    "mask_column": "which word of the row",
    "mask_row": "row, px",
    "mask_bits": "bit k: the pixel 32·column + k is hot",
    "result_valid": "a result is offered, and stays as it is until it is taken",
    "result_ready": "take it",
    "result_region": "whose result it is: row of the table of regions",
    "result_last": "1: the last region's result of its batch",
    "result_sums_i": "ΣI of the last iteration, raw; no sum means anything in a degenerate batch",
    "trace_valid": "an iteration's sums are valid (for verification; leave open)",
    "trace_region": "whose iteration it is",
    "trace_pixels_valid": "the sweep has read four pixels (for verification; leave open)",
    "trace_pixels_i": "I of the pixel in bank 0 … 3",
    "trace_pixels_dx": "Dx of that pixel",
    "trace_pixels_dy": "Dy of that pixel",
}


#: What tools that know ASCII alone read instead.
_PLAIN = (
    ("1½", "1.5"), ("¾", "0.75"), ("µ", "u"), ("Σ ", "sum of "), ("Σ", "sum of "), ("²", "^2"), ("·", "*"),
    ("−", "-"), ("…", "..."), ("×", "x"), ("∂", "d"), ("η", "eta"), ("←", "<-"), ("→", "->"), ("≤", "<="),
    ("≥", ">="), ("±", "+-"), ("–", "-"), ("°", " degrees"), ("½", "0.5"), ("φ", "phi"), ("ρ", "rho"),
    ("α", "alpha"), ("⌊", "floor("), ("⌋", ")"), ("⌈", "ceil("), ("⌉", ")"),
)  # fmt: skip


def plain(text):
    """A text of ours in ASCII."""
    for sign, word in _PLAIN:
        text = text.replace(sign, word)
    return text


@dataclass(frozen=True)
class Port:
    """A port of the core; ``group`` is the first word of its name."""

    name: str
    direction: str  # input or output
    bits: int
    signed: bool
    meaning: str

    @property
    def group(self):
        return self.name.partition("_")[0]

    @property
    def field(self):
        """The name without the group."""
        return self.name.partition("_")[2]


def meanings(config):
    """What each port is for, by :func:`key` of its name."""
    declared = [("settings", s.name, s.shape_of(config), s.places, *s.doc_of(config)) for s in SETTINGS]
    declared += [("result", f.name, f.shape(config), f.places, f.doc, f.unit) for f in RESULTS if f.when(config)]
    for name, row in tables_of(config).items():
        declared += [(name, s.name, s.shape_of(config), s.places, *s.doc_of(config)) for s in row]
    found = {}
    for group, name, shape, places, doc, unit in declared:
        for leaf in leaves(name, shape):
            place = next((place for place in places if name + place.part == leaf), None)
            text = doc
            if place and place.part:
                text = place.doc if place.field == "VALUE" else f"{doc}: {place.doc}"
            found[f"{group}_{leaf}"] = f"{text} ({unit})" if unit else text
    of_trace = (leaf for name, shape in trace_shape(config).items() for leaf in leaves(name, shape))
    return found | {f"trace_{leaf}": f"as `result_{leaf}`, of this iteration" for leaf in of_trace} | PORTS


def key(name):
    """A port's name without the number of a unit or bank, which all mean the same."""
    return re.sub(r"^(trace_pixels|trace)_\d+_", r"\1_", name)


def comments(core):
    """``{port: what it is for}`` in order, in ASCII; "" where no table says it."""
    known = meanings(core.config)
    return {name: plain(known.get(key(name), "")) for name in core.port_order}


def port_table(core):
    """All ports of a core, in order: list of :class:`Port`. A port that nothing tells the meaning of is an error."""
    known = meanings(core.config)
    listed = [Port(name, "input", 1, False, PORTS[name]) for name in ("clk", "rst")]
    for direction, signals in (("input", core.inputs), ("output", core.outputs)):
        listed += [
            Port(name, direction, len(port), port.shape().signed, known[key(name)]) for name, port in signals.items()
        ]
    return listed


GROUPS = ("event", "settings", "result")


def packed(table, group):
    """``([(port, its lowest bit)], bits)`` of the fields of one of :data:`GROUPS`, without the handshake."""
    found, lsb = [], 0
    for port in table:
        if port.group == group and port.field not in ("valid", "ready"):
            found.append((port, lsb))
            lsb += port.bits
    return found, lsb
