"""Draws a batch at the ports of the core into ``docs/images/batch.svg``: ``python docs/waveform.py``.

From the example that ``cmfpga build`` writes, run in Icarus Verilog with ``+waves``: every level and number is that of
the simulation. ``--check`` only compares.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from vcd.reader import TokenKind, tokenize

from cmfpga.cli.build import build
from cmfpga.config import preset
from cmfpga.rtl.top import verilog_top
from cmfpga.verilog.emit import TOP
from cmfpga.verilog.example import BENCH, EXAMPLE
from cmfpga.verilog.ports import packed, port_table

PATH = Path(__file__).parent / "images" / "batch.svg"
LEFT, TOP_EDGE, CELL, ROW, GAP = 104, 34, 32, 30, 20  # of the drawing, px
LEVELS = ("rst", "loaded", "event_valid", "event_ready", "event_last", "result_valid", "result_ready")
#: Numbers, and the valid that tells when they mean something.
NUMBERS = {"event_t": "event_valid", "result_v_x": "result_valid"}
ROWS = ("clk", *LEVELS[:5], "event_t", *LEVELS[5:], "result_v_x")


def simulate(config, folder):
    """The example's waveforms, as Icarus writes them."""
    build(config, folder)
    sources = [f"{BENCH}.v", f"{EXAMPLE}.v", f"{TOP}.v"]
    for command in (["iverilog", "-o", "example", "-s", BENCH, *sources], ["vvp", "-n", "example", "+waves"]):
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder / f"{EXAMPLE}.vcd"


def sampled(path):
    """``[{signal: value}]`` of the example, as they are when the clock rises; X is None."""
    names, values, rows, scope = {}, {}, [], []
    with path.open("rb") as file:
        for token in tokenize(file):
            if token.kind is TokenKind.SCOPE:
                scope.append(token.scope.ident)
            elif token.kind is TokenKind.UPSCOPE:
                scope.pop()
            elif token.kind is TokenKind.VAR and scope == [BENCH, "example"]:
                names.setdefault(token.var.id_code, []).append(token.var.reference)
            elif token.kind in (TokenKind.CHANGE_SCALAR, TokenKind.CHANGE_VECTOR):
                change = token.data
                for name in names.get(change.id_code, ()):
                    if name == "clk" and change.value == "1":
                        rows.append(dict(values))
                    # Later changes at the same time are the clock's.
                    values[name] = int(change.value) if str(change.value).isdigit() else None
    return rows


def course(config, rows):
    """``{row of the drawing: [a value each cycle]}``."""
    table = port_table(verilog_top(config))
    places = {port.name: (port, lsb) for group in ("event", "result") for port, lsb in packed(table, group)[0]}

    def field(row, name):
        port, lsb = places[name]
        word = row["event_word" if port.group == "event" else "result"]
        if word is None:
            return None
        value = (word >> lsb) & ((1 << port.bits) - 1)
        return value - (1 << port.bits) if port.signed and value >> (port.bits - 1) else value

    found = {name: [row.get(name) for row in rows] for name in LEVELS if name != "event_last"}
    found["event_last"] = [row["event_valid"] and field(row, "event_last") for row in rows]
    return found | {name: [field(row, name) if row[valid] else None for row in rows] for name, valid in NUMBERS.items()}


def windows(found):
    """Parts of the course that tell something: ``[(first cycle, cycles, what)]``."""
    ready, last, done = (found[name].index(1) for name in ("event_ready", "event_last", "result_valid"))
    begin = found["rst"].index(0)
    return [
        (begin - 2, 11, "reset, tables"),
        (ready - 2, 7, "ready, first events"),
        (last - 3, 7, "last event"),
        (done - 2, 4, "result"),
    ]


def _level(values, x, y):
    """A line, high or low in each cycle; what is X counts as low."""
    points = []
    for k, value in enumerate(values):
        height = y + (4 if value else ROW - 10)
        points += [(x + k * CELL, height), (x + (k + 1) * CELL, height)]
    return '<path class="wire" d="M' + "L".join(f"{a:g} {b:g}" for a, b in points) + '"/>'


def _clock(cycles, x, y):
    high, low = y + 4, y + ROW - 10
    one = "".join(f"M{x + k * CELL:g} {low}V{high}h{CELL / 2:g}V{low}h{CELL / 2:g}" for k in range(cycles))
    return f'<path class="wire" d="{one}"/>'


def _numbers(values, x, y):
    for k, value in enumerate(values):
        if value is not None:
            at = x + k * CELL
            yield f'<rect class="box" x="{at + 1:g}" y="{y + 3:g}" width="{CELL - 2}" height="{ROW - 12}" rx="4"/>'
            yield f'<text class="small" x="{at + CELL / 2:g}" y="{y + 16:g}">{value}</text>'


def svg(found):
    """The drawing of a course."""
    parts = windows(found)
    width = LEFT + sum(cycles for _, cycles, _ in parts) * CELL + GAP * len(parts)
    height = TOP_EDGE + ROW * len(ROWS) + 24
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" role="img">',
        "<title>A batch at the ports of the core: reset, the first events, the last one, and the result</title>",
        "<style>",
        "text{font:12px sans-serif;text-anchor:middle;fill:#1c2733}.small{font-size:9.5px}.name{text-anchor:end}",
        ".back{fill:#fff}.box{fill:#fdf0dc;stroke:#b8781a}.wire{fill:none;stroke:#2f6aa8;stroke-width:1.5}",
        ".part{fill:none;stroke:#8a97a5;stroke-dasharray:2 4}",
        "@media(prefers-color-scheme:dark){text{fill:#e6edf3}.back{fill:#161b22}.box{fill:#4a3514;stroke:#e0a84a}",
        ".wire{stroke:#6fa8dc}}",
        "</style>",
        f'<rect class="back" width="{width:g}" height="{height:g}" rx="8"/>',
    ]
    for number, name in enumerate(ROWS):
        lines.append(f'<text class="name" x="{LEFT - 10}" y="{TOP_EDGE + number * ROW + 16:g}">{name}</text>')
    x = LEFT
    for first, cycles, what in parts:
        lines.append(f'<text x="{x + cycles * CELL / 2:g}" y="20">{what}</text>')
        bottom = TOP_EDGE + ROW * len(ROWS)
        lines.append(f'<path class="part" d="M{x} {TOP_EDGE}V{bottom}M{x + cycles * CELL} {TOP_EDGE}V{bottom}"/>')
        lines.append(f'<text class="small" x="{x + CELL:g}" y="{bottom + 14:g}">cycle {first}</text>')
        for number, name in enumerate(ROWS):
            y = TOP_EDGE + number * ROW
            if name == "clk":
                lines.append(_clock(cycles, x, y))
                continue
            values = found[name][first : first + cycles]
            lines += _numbers(values, x, y) if name in NUMBERS else [_level(values, x, y)]
        x += cycles * CELL + GAP
    return "\n".join([*lines, "</svg>"]) + "\n"


def main(arguments):
    """Write the drawing; with ``--check`` say whether it is up to date. Returns the exit status."""
    config = preset("fast")
    with tempfile.TemporaryDirectory() as folder:
        drawn = svg(course(config, sampled(simulate(config, Path(folder)))))
    if arguments == ["--check"]:
        return int(PATH.read_text(encoding="utf-8") != drawn)
    PATH.write_text(drawn, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
