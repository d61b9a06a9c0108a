"""The summary page of a sweep: one HTML file that needs nothing else."""

import importlib.resources

import jinja2
import pandas

from ..fpga import resources
from .tables import CRITERIA, FOUND_PX, number


def page(*, ranked, frame, run, preset, assignments, files):
    """The page as text.

    Parameters
    ----------
    ranked : list of dict
        Of :func:`~cmfpga.sweep.tables.ranking`.
    frame : DataFrame
        Of :func:`~cmfpga.sweep.tables.results`.
    run : Run
    preset : str
    assignments : list of str
        ``FIELD=VALUE`` that all configurations have.
    files : list of str
        Names of the tables beside the page.
    """
    rows = frame.to_dict("records")
    recordings = {}
    for row in rows:
        recordings.setdefault((row["recording"], _text(row["roi_x"]), _text(row["roi_y"])), []).append(row)
    shown = [name for name in CRITERIA if any(name in entry["ranks"] for entry in ranked)]
    template = importlib.resources.files(__package__).joinpath("page.html.jinja").read_text(encoding="utf-8")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    environment.filters |= {"number": number, "text": _text, "percent": _percent}
    return environment.from_string(template).render(
        ranked=ranked,
        criteria={name: CRITERIA[name][0] for name in shown},
        labels={entry["configuration"]: entry["label"] for entry in ranked},
        kinds=resources.KINDS if any(entry["resources"] for entry in ranked) else {},
        resource_label=resources.LABEL,
        recordings=recordings,
        bad=[row for row in rows if row["status"] != "ok"],
        roi_sizes=sorted({(row["config.roi_width"], row["config.roi_height"]) for row in rows}),
        found_px=FOUND_PX,
        run=run,
        preset=preset,
        assignments=assignments,
        version=rows[0]["cmfpga"],
        files=files,
    )


def _text(value):
    return "" if pandas.isna(value) else str(value)


def _percent(value):
    return "–" if value is None else f"{100 * value:.1f} %"
