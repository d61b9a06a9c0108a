"""Columns of tables, each declared once: CSV, arrays, the report and the documentation follow from that.

A track's are :data:`COLUMNS`, those of flow :data:`cmfpga.dense.window.COLUMNS`, of a sweep
:data:`cmfpga.sweep.tables.RESULTS`.
"""

import csv
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..forms import Number, Text
from ..imaging.camera import RATES
from ..protocol.flags import Flag

_ARRAYS = {int: np.int64, float: np.float64, str: str}


@dataclass(frozen=True, kw_only=True)
class Column:
    """One column.

    ``value(one)`` is that of what a row, or several, tell of: a :class:`~cmfpga.tracking.loop.TrackedBatch`, a window.
    """

    name: str
    dtype: type = float  # or int or str
    title: str = ""  # its name for people
    unit: str = ""  # empty for a number of things
    doc: str  # its meaning
    value: Callable | None = None
    text: str | Callable | None = "{}"  # format of the value in the CSV; None: only in arrays
    shape: str = ""  # of an array beside the CSV, if there is one
    may_be_missing: bool = False  # the value may be None: empty in the CSV, NaN in an array

    @property
    def form(self):
        """What a value must be that was kept."""
        if self.dtype is str:
            return Text(parse=Flag.parse)
        if self.dtype is int:  # sums over a track are int64
            return Number(int, 0, 1 << 40, self.may_be_missing)
        return Number(float, -(1 << 62), 1 << 62, self.may_be_missing)

    def array(self, values):
        """One value per batch as an array: int64, float64 or str."""
        if self.may_be_missing:
            return np.array([np.nan if value is None else value for value in values], np.float64)
        return np.array(values, _ARRAYS[self.dtype])

    def shown(self, value):
        """Text of a value; equal values give equal text."""
        if value is None or (self.may_be_missing and value != value):
            return ""
        return self.text(value) if callable(self.text) else self.text.format(value)


def declared(*columns):
    """``{name: Column}``, in their order."""
    return {column.name: column for column in columns}


def csv_writer(file, names, image=""):
    """A function that writes a row into a CSV, which has its head of ``names`` already.

    ``image``, where it is told, is what a last column says: which image places and velocities are in.
    """
    writer, more = csv.writer(file, lineterminator="\n"), [image] * bool(image)
    writer.writerow((*names, *["image"] * bool(image)))
    return lambda row: writer.writerow((*row, *more))


def _deviation(name, title, unit, text="{:.6f}"):
    return Column(name=f"{name}_sd", dtype=float, title=f"{title}, standard deviation", unit=unit, text=text,
                  value=lambda b: b.deviations.get(name), may_be_missing=True,
                  doc="its standard deviation; empty where in doubt")  # fmt: skip


_HALF_BATCH, _PER_SECOND = "px/half batch", "the same in px/s; empty for a degenerate batch"

#: ``{name: Column}``, in the order of the CSV.
COLUMNS = declared(
    Column(name="batch", dtype=int, title="batch", doc="number of the batch, from 0", value=lambda b: b.index),
    Column(name="t_ref_us", dtype=float, title="middle of the batch", unit="µs", value=lambda b: b.t_ref,
           doc="middle of the batch's time range, on the recording's clock; empty for a batch without events",
           text="{:.1f}", may_be_missing=True),
    Column(name="events", dtype=int, title="events of the sensor", value=lambda b: b.result.events,
           doc="N, events of the batch, of the whole sensor; of windows those since the last row"),
    Column(name="roi_events", dtype=int, title="events in the ROI", value=lambda b: b.result.roi_events,
           doc="n, events in the ROI that the buffer holds; these are what v is found from"),
    Column(name="roi_x", dtype=int, title="ROI, left column", unit="px", value=lambda b: b.roi[0],
           doc="left column of the ROI that the batch was cut with"),
    Column(name="roi_y", dtype=int, title="ROI, top row", unit="px", value=lambda b: b.roi[1],
           doc="top row of that ROI"),
    Column(name="vx", dtype=float, title="velocity to the right", unit=_HALF_BATCH, value=lambda b: b.v[0],
           doc="velocity along x, positive to the right; of a degenerate batch, the one before it", text="{!r}"),
    Column(name="vy", dtype=float, title="velocity downwards", unit=_HALF_BATCH, value=lambda b: b.v[1],
           doc="velocity along y, positive downwards", text="{!r}"),
    Column(name="vx_px_per_s", dtype=float, title="velocity to the right", unit="px/s", text="{:.3f}",
           value=lambda b: b.v_px_per_s and b.v_px_per_s[0], doc=_PER_SECOND, may_be_missing=True),
    Column(name="vy_px_per_s", dtype=float, title="velocity downwards", unit="px/s", text="{:.3f}",
           value=lambda b: b.v_px_per_s and b.v_px_per_s[1], doc=_PER_SECOND, may_be_missing=True),
    _deviation("vx_px_per_s", "velocity to the right", "px/s", "{:.3f}"),
    _deviation("vy_px_per_s", "velocity downwards", "px/s", "{:.3f}"),
    Column(name="iterations", dtype=int, title="iterations", value=lambda b: b.result.iterations,
           doc="iterations done; 0 for a degenerate batch"),
    Column(name="cycles", dtype=int, title="clock cycles", value=lambda b: b.result.cycles, may_be_missing=True,
           doc="clock cycles from the offer of the first event to the result, of one of several objects those of "
           "its unit alone; empty for engines without a clock"),
    Column(name="contrast", dtype=float, title="contrast", unit="(events/px)²", value=lambda b: b.contrast,
           doc="population variance of the image of warped events at (vx, vy), computed in float64 for every "
           "engine", text="{:.6f}"),
    Column(name="confidence", dtype=float, title="confidence", unit="1/px²", value=lambda b: b.confidence,
           doc="κ, how sharp the peak of the contrast is; v is known to about 1/√κ px; empty where it was not "
           "measured", text="{:.3f}", may_be_missing=True),
    Column(name="trusted", dtype=int, title="trusted", value=lambda b: int(b.trusted),
           doc="1: to be trusted; 0 also where that was not measured"),
    Column(name="flags", dtype=str, title="flags", value=lambda b: b.flags.text,
           doc="names of the flags that are set, joined by `|`; empty where nothing was unusual"),
    Column(name="ambiguity", dtype=int, title="what is open", value=lambda b: int(b.ambiguity),
           doc="sum of 1: few time stamps, 2: stripes, 4: one direction, 8: two motions, 16: hot pixels, 32: sharper "
           "elsewhere, 64: parts apart, 128: alone, 256: thinned, 512: changes; trusted with none but 8"),
)  # fmt: skip


def _rate(name, title, unit, doc):
    return Column(name=name, dtype=float, title=title, unit=unit, value=lambda b: b.rates[name], doc=doc,
              text="{:.6f}", may_be_missing=True)  # fmt: skip


_DEGENERATE = "; empty for a degenerate batch"

#: Of motions beyond translation, beside those: what :func:`cmfpga.imaging.camera.rates` tells.
MORE = declared(
    _rate("wx_rad_per_s", "angular velocity about x", "rad/s",
          "the camera's angular velocity about its x axis, which points to the right" + _DEGENERATE),
    _rate("wy_rad_per_s", "angular velocity about y", "rad/s", "the same about y, which points down"),
    _rate("wz_rad_per_s", "angular velocity about z", "rad/s", "the same about z, which points forward"),
    *(_deviation(f"w{axis}_rad_per_s", f"angular velocity about {axis}", "rad/s") for axis in "xyz"),
    _deviation("zoom_per_s", "zoom", "1/s"),
    _deviation("roll_rad_per_s", "roll", "rad/s"),
    _rate("zoom_per_s", "zoom", "1/s", "growth of the image per s, positive of what comes nearer" + _DEGENERATE),
    _rate("roll_rad_per_s", "roll", "rad/s", "turn of the image, positive clockwise" + _DEGENERATE),
    _rate("time_to_contact_s", "time to contact", "s",
          "1/zoom_per_s, negative of what goes away; empty without a zoom"),
)  # fmt: skip


#: Names of what has a standard deviation, by motion.
DEVIATIONS = {
    motion: ("vx_px_per_s", "vy_px_per_s", *(name for name in names if f"{name}_sd" in MORE))
    for motion, names in RATES.items()
}

#: Where windows slide, beside those.
HOPS = declared(
    Column(name="t_us", dtype=int, title="last event", unit="µs", value=lambda b: b.t_us, may_be_missing=True,
           doc="time of the window's last event, on the recording's clock; v is the mean over the window"),
    Column(name="window_us", dtype=int, title="length of the window", unit="µs", value=lambda b: b.result.span,
           doc="v is px per half of it; 0 of a degenerate window"),
)  # fmt: skip


def columns(motion, slides=False):
    """``{name: Column}`` of a track with this motion, of windows that slide or batches, in the order of its CSV."""
    found = {}
    for name, column in COLUMNS.items():
        if slides and name == "t_ref_us":
            found |= HOPS
        found[name] = column
        if name == "vy_px_per_s_sd":
            more = (part for rate in RATES[motion] for part in (rate, f"{rate}_sd"))
            found |= {part: MORE[part] for part in more if part in MORE}
    return found


def row(values):
    """Text of a batch's values, ``{name: value}``."""
    every = COLUMNS | MORE | HOPS
    return tuple(every[name].shown(value) for name, value in values.items())
