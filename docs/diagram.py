"""Draws the blocks of the core into ``docs/images/blocks.svg``: ``python docs/diagram.py``; ``--check`` only compares.

Boxes stand on a grid of columns and rows; wires are given by the points that they go through. No font, script or
network is needed to show it, and it is legible in the dark, too.
"""

import itertools
import sys
from pathlib import Path

PATH = Path(__file__).parent / "images" / "blocks.svg"

X, Y, WIDTH, HEIGHT = 182, 104, 152, 46  # of the grid's steps, and of boxes
LEFT, TOP = 14, 18

#: name: (file, column, row); with a dash in front of the file only where the configuration asks for it.
BOXES = {
    "IngestControl": ("ingest_control.py", 1, 0),
    "Filters of noise": ("-noise_filter.py", 2, 0),
    "RoiFilter": ("roi_filter.py", 3, 0),
    "Thinner": ("thinner.py", 4, 0),
    "EventBuffer": ("event_buffer.py", 5, 0),
    "IterationControl": ("iteration_control.py", 1, 1),
    "Reciprocal": ("reciprocal.py", 4, 1),
    "Dither": ("-dither.py", 5, 2),
    "TimeScaler": ("time_scaler.py", 4, 2),
    "Warp, Evaluators": ("warp.py, evaluators.py", 3, 2),
    "BilinearVoter": ("voter.py", 2, 2),
    "TaggedAccumulator": ("tagged_accumulator.py", 2, 3.15),
    "OnePassGradient": ("one_pass_gradient.py", 3, 3.15),
    "Accumulator": ("accumulator.py", 4, 3.15),
    "GradientReader": ("gradient_reader.py", 5, 3.15),
    "RoiUpdater": ("roi_updater.py", 1, 4.4),
    "Schedule": ("-schedule.py", 2, 4.4),
    "Ascent, Velocity": ("newton.py, constant.py", 3, 4.4),
    "Gradient": ("gradient.py", 4, 4.4),
    "Means, Verdict": ("-verdict.py", 5, 4.4),
}
PILLS = {"event stream": (0, 0), "settings": (0, 0.55), "result stream": (0, 4.4)}
#: title: (first column, last column, row)
GROUPS = {
    "image: gradient = one_pass (fast)": (2, 3, 3.15),
    "image: gradient = sweep (paper)": (4, 5, 3.15),
    "ascent = newton (fast) or constant (paper)": (2, 3, 4.4),
}


def at(column, row, dx=0.5, dy=0.5):
    """A point of a box: 0 … 1 of its width and height."""
    return LEFT + column * X + dx * WIDTH, TOP + row * Y + dy * HEIGHT


def _wires():
    """``(points, label, place of the label or None)``; each wire ends in an arrow."""
    gap = LEFT + 2 * X - 12  # between the second and the third column
    edge = LEFT + X - 15  # between the first two
    right = LEFT + 5 * X + WIDTH + 16
    low, between = TOP + 4.4 * Y + HEIGHT + 20, TOP + 1.76 * Y
    for first, last in ((0, 1), (1, 2), (2, 3), (3, 4), (4, 5)):
        yield [at(first, 0, 1), at(last, 0, 0)], ""
    yield [at(0, 0.55, 1), (edge, at(0, 0.55)[1]), (edge, at(1, 0, 0, 0.75)[1]), at(1, 0, 0, 0.75)], ""
    yield [at(1, 0, 0.5, 1), at(1, 1, 0.5, 0)], "batch"
    yield [at(3, 0, 0.5, 1), at(3, 1), at(4, 1, 0)], "t_N − t_1"
    yield [at(4, 1, 0.5, 1), at(4, 2, 0.5, 0)], ""
    yield [at(5, 0, 0.6, 1), at(5, 2, 0.6, 0)], ""
    over = between - 9
    yield [at(1, 1, 1), (gap, at(1, 1)[1]), (gap, over), (at(5, 0, 0.25)[0], over), at(5, 0, 0.25, 1)], "replay"
    for first, last in ((5, 4), (4, 3), (3, 2)):
        yield [at(first, 2, 0), at(last, 2, 1)], ""
    yield [at(2, 2, 0.5, 1), at(2, 3.15, 0.5, 0)], "4 votes"
    yield [at(2, 2, 0.5, 1.45), (at(4, 0)[0], at(2, 2, 0, 1.45)[1]), at(4, 3.15, 0.5, 0)], ""
    yield [at(2, 3.15, 1), at(3, 3.15, 0)], ""
    yield [at(4, 3.15, 1, 0.35), at(5, 3.15, 0, 0.35)], ""
    yield [at(5, 3.15, 0, 0.7), at(4, 3.15, 1, 0.7)], ""
    middle = at(0, 3.15, 0, 1)[1] + 26
    yield [at(3, 3.15, 0.5, 1), (at(3, 0)[0], middle), (at(4, 0, 0.3)[0], middle), at(4, 4.4, 0.3, 0)], "sums"
    yield [at(5, 3.15, 0.5, 1), (at(5, 0)[0], middle), (at(4, 0, 0.7)[0], middle), at(4, 4.4, 0.7, 0)], ""
    yield [(right - 8, at(5, 3.15)[1]), (right, at(5, 3.15)[1]), (right, at(5, 0)[1]), at(5, 0, 1)], "room"
    yield [at(4, 4.4, 0), at(3, 4.4, 1)], ""
    yield [at(4, 4.4, 1), at(5, 4.4, 0)], ""
    yield [at(2, 4.4, 1), at(3, 4.4, 0)], ""
    under = low + 22
    yield [at(3, 4.4, 0.75, 1), (at(3, 0, 0.75)[0], under), (at(5, 0)[0], under), at(5, 4.4, 0.5, 1)], "curvature"
    yield [at(3, 4.4, 0.4, 1), (at(3, 0, 0.4)[0], low), (at(1, 0)[0], low), at(1, 4.4, 0.5, 1)], "v"
    below = between + 10
    around = [(at(2, 0)[0], low), (gap, low), (gap, below), (at(3, 0)[0], below)]
    yield [at(2, 4.4, 0.5, 1), *around, at(3, 2, 0.5, 0)], "v, level"
    above = at(0, 0.72)[1]
    around = [(edge, at(1, 4.4, 0, 0.25)[1]), (edge, above), (at(3, 0, 0.2)[0], above)]
    yield [at(1, 4.4, 0, 0.25), *around, at(3, 0, 0.2, 1)], "ROI"
    yield [at(1, 1, 0), (at(0, 0)[0], at(1, 1)[1]), at(0, 4.4, 0.5, 0.15)], ""
    yield [at(1, 4.4, 0, 0.6), at(0, 4.4, 1, 0.6)], ""


def _label(points, text):
    """In the middle of the longest horizontal part, or of the only one."""
    parts = [*itertools.pairwise(points)]
    across, down = (max(parts, key=lambda part: abs(part[0][axis] - part[1][axis])) for axis in (0, 1))
    (x0, y0), (x1, y1) = across if abs(across[0][0] - across[1][0]) > 40 else down
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    width = 6.4 * len(text) + 6
    back = f'<rect class="back" x="{x - width / 2:g}" y="{y - 8:g}" width="{width:g}" height="16"/>'
    return f'{back}<text class="small" x="{x:g}" y="{y + 4:g}">{text}</text>'


def svg():
    """The drawing."""
    width, height = LEFT + 5 * X + WIDTH + 34, TOP + 4.4 * Y + HEIGHT + 58
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" role="img">',
        "<title>The blocks of the core, and what travels between them</title>",
        "<style>",
        "text{font:600 12px sans-serif;text-anchor:middle;fill:#1c2733}.small{font-weight:400;font-size:11px}",
        ".end{text-anchor:end}",
        ".back{fill:#fff}.box{fill:#e8f1fb;stroke:#2f6aa8}.group{fill:none;stroke:#8a97a5;stroke-dasharray:2 4}",
        ".wire{fill:none;stroke:#4a5866;stroke-width:1.3;marker-end:url(#a)}.pill{fill:#fdf0dc;stroke:#b8781a}",
        ".asked{stroke-dasharray:6 3}#a path{fill:#4a5866}",
        "@media(prefers-color-scheme:dark){text{fill:#e6edf3}.back{fill:#161b22}.box{fill:#1d3450;stroke:#6fa8dc}",
        ".pill{fill:#4a3514;stroke:#e0a84a}.wire{stroke:#aab6c2}#a path{fill:#aab6c2}}",
        "</style>",
        '<defs><marker id="a" viewBox="0 0 8 8" refX="7.5" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0L8 4L0 8z"/></marker></defs>',
        f'<rect class="back" width="{width:g}" height="{height:g}" rx="8"/>',
    ]
    for title, (first, last, row) in GROUPS.items():
        (x, y), (end, bottom) = at(first, row, 0, 0), at(last, row, 1, 1)
        size = f'width="{end - x + 16:g}" height="{bottom - y + 32:g}"'
        lines.append(f'<rect class="group" x="{x - 8:g}" y="{y - 24:g}" {size} rx="6"/>')
        lines.append(f'<text class="small end" x="{end:g}" y="{y - 10:g}">{title}</text>')
    wires = [*_wires()]
    for points, _ in wires:
        lines.append('<path class="wire" d="M' + "L".join(f"{x:g} {y:g}" for x, y in points) + '"/>')
    lines += [_label(points, text) for points, text in wires if text]
    for name, (file, column, row) in BOXES.items():
        (x, y), (middle, _) = at(column, row, 0, 0), at(column, row)
        asked = " asked" if file.startswith("-") else ""
        lines.append(f'<rect class="box{asked}" x="{x:g}" y="{y:g}" width="{WIDTH}" height="{HEIGHT}" rx="5"/>')
        lines.append(f'<text x="{middle:g}" y="{y + 19:g}">{name}</text>')
        lines.append(f'<text class="small" x="{middle:g}" y="{y + 36:g}">{file.removeprefix("-")}</text>')
    for name, (column, row) in PILLS.items():
        (x, y), (middle, centre) = at(column, row, 0.08, 0.15), at(column, row)
        size = f'width="{0.92 * WIDTH:g}" height="{0.7 * HEIGHT:g}"'
        lines.append(f'<rect class="pill" x="{x:g}" y="{y:g}" {size} rx="16"/>')
        lines.append(f'<text x="{middle:g}" y="{centre + 4:g}">{name}</text>')
    return "\n".join([*lines, "</svg>"]) + "\n"


def main(arguments):
    """Write the drawing; with ``--check`` say whether it is up to date. Returns the exit status."""
    if arguments == ["--check"]:
        return int(PATH.read_text(encoding="utf-8") != svg())
    PATH.write_text(svg(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
