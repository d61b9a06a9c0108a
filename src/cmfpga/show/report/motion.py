"""What a page shows of a motion: its parameters, and how each moves an event; beyond translation, rates over time.

The script draws the images, and the contrast over two of the parameters, by what :func:`shown_motion` gives.
"""

import html

from ..gallery import CHARTS, SPEED

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


def rates_figure(config):
    """The figure for them; empty of a translation."""
    return "".join(
        f'<figure>\n<h2>{html.escape(title.capitalize())}</h2>\n<div id="rates" class="plot chart" role="img"></div>\n'
        f"<figcaption>{html.escape(label)} over time.</figcaption>\n</figure>\n"
        for title, label, _ in _rates(config)
    )


def velocity_title(config):
    """Title of the chart of (vx, vy)."""
    return "Velocity at the principal point" if config.motion == "rotation" else "Velocity of the object"


def parameter_choice(config):
    """The choice of two parameters to draw the contrast over; the others are those found."""
    motion = config.motion_model
    pairs = {
        ",".join(str(motion.names.index(name)) for name in pair): " and ".join(_title(motion, name) for name in pair)
        for pair in reversed(_PAIRS[config.motion])
    }
    return choice("pair", "Contrast over", pairs)


def choice(name, legend, values):
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
