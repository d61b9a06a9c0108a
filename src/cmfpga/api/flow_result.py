"""What was found in all windows: arrays, text and files."""

import csv
import json
from pathlib import Path

import numpy as np

from ..dense.fields import MODELS, fit_field
from ..dense.window import COLUMNS
from ..errors import naming

#: Files of a run, in its folder.
CSV, ARRAYS, FITS = "flow.csv", "flow.npz", "fit.csv"

#: Arrays of :data:`ARRAYS`: shape and meaning; W windows, n tiles, p parameters of the fit.
DOCS = {
    "x": ("[n]", "left column of each tile, px"),
    "y": ("[n]", "top row of each tile, px"),
    "size": ("[2]", "width and height of the tiles, px"),
    "grid": ("[2]", "rows and columns of the grid; tiles are row by row"),
    "t": ("[W, 2]", "times of the first and last event of each window, µs on the recording's clock"),
    "first_event": ("[W]", "number in the recording of the first event of each window"),
    "window_events": ("[W]", "events of each window, of the whole sensor"),
    "events": ("[W, n]", "events of each tile that its flow is found from"),
    "v": ("[W, n, 2]", "flow, px/s; NaN of degenerate tiles"),
    "confidence": ("[W, n]", "κ, 1/px²; NaN where it was not measured"),
    "covariance": ("[W, n, 3]", "of the flow, (px/s)²: xx, yy, xy; NaN of tiles that are not trusted"),
    "flags": ("[W, n]", "bits of `cmfpga.protocol.flags.Flag`"),
    "trusted": ("[W, n]", "neither degenerate nor doubtful"),
    "centres": ("[W, n, 2]", "mean position of the events of each tile, px"),
    "fit": ("[W, p]", "with a fit: its parameters, in the order of `fit.csv`"),
    "fit_errors": ("[W, p]", "their standard deviations"),
}

_DROPPED = ("time_back", "time_span", "hot", "noise")  # counts of a result


class Flow:
    """The flow of all windows, in arrays, which grow by some kB a window.

    Parameters
    ----------
    config : Config
    tiles : Tiles
    recording, engine : str
        Their names.
    fit : str or None
        One of :data:`~.fields.MODELS`.

    Attributes
    ----------
    leftover : int
        Events after the last window.
    limited : bool
        The windows would be longer, had the hardware room for their events.
    outside, dropped : int
        Events off the undistorted image, in no tile; and those that the hardware dropped: time stepped back, noise.
    passed_over : int
        Slices without events, which are in no window.
    cycles : list of int
        Clock cycles of each window with events; empty of engines without a clock.
    moved : list of float
        Motion of the image in each window, px per half window; NaN where too few tiles are trusted.
    fields : list of Field
        The fits of each window; of None without one.
    """

    def __init__(self, config, tiles, recording, engine, fit=None):
        self.config, self.tiles, self.engine, self.model = config, tiles, engine, fit
        self.recording = Path(recording).name
        self.leftover, self.limited, self.moved, self.fields = 0, False, [], []
        self.outside, self.dropped, self.passed_over, self.cycles = 0, 0, 0, []
        self._kept = {name: [] for name in (*DOCS,)[4 : None if fit else -2]}

    def __len__(self):
        return len(self.moved)

    def add(self, window):
        """Take the next :class:`~.window.Window`; returns its :class:`~.fields.Field`, or None."""
        events, result = window.events, window.result
        self.moved.append(np.nan if window.moved is None else window.moved)
        self.fields.append(field := fit_field(self.model, window) if self.model else None)
        self.outside += window.outside
        self.cycles += [window.cycles] if window.cycles else []
        self.dropped += sum(getattr(result, name) for name in _DROPPED)
        found = {
            "t": [int(events.t[0]), int(events.t[-1])] if len(events) else [-1, -1],
            "first_event": events.first_event,
            "window_events": len(events),
            "events": window.counts,
            "v": window.px_per_s,
            "confidence": window.kappa,
            "covariance": window.covariance,
            "flags": window.flags,
            "trusted": window.trusted,
            "centres": window.centres,
        }
        found |= {"fit": field.values, "fit_errors": field.errors} if field else {}
        for name, value in found.items():
            self._kept[name].append(value)
        return field

    @property
    def arrays(self):
        """``{name: array}``, see :data:`DOCS`."""
        x, y = np.array(self.tiles.corners).T
        grid = len(self.tiles.rows), len(self.tiles.columns)
        size = self.tiles.width, self.tiles.height
        return {
            "x": x, "y": y, "size": np.array(size), "grid": np.array(grid),
            **{name: np.array(values) for name, values in self._kept.items()},
        }  # fmt: skip

    def ended(self, run):
        """Take over what a :class:`~.run.Run` knows when its last window has come."""
        self.leftover, self.limited, self.passed_over = run.leftover, run.limited, run.passed_over

    def save(self, path):
        """Write :attr:`arrays` as ``.npz``, with what made them as JSON in ``head``."""
        told = {"recording": self.recording, "engine": self.engine, "image": self.config.image, "fit": self.model}
        told |= {"fit_names": MODELS.get(self.model, ()), "config": self.config.to_dict()}
        with naming(path):
            np.savez_compressed(path, head=np.array(json.dumps(told)), **self.arrays)

    def summary(self):
        """What all windows tell, JSON-ready."""
        kept = self._kept
        measured = sum(int(np.isfinite(v[:, 0]).sum()) for v in kept["v"])
        trusted = sum(int(one.sum()) for one in kept["trusted"])
        speeds = [np.hypot(*v[one].T) for v, one in zip(kept["v"], kept["trusted"], strict=True)]
        speeds = np.concatenate(speeds)
        return {
            "recording": self.recording,
            "engine": self.engine,
            "windows": len(self),
            "tiles": len(self.tiles),
            "tile_px": self.tiles.width,
            "image": self.config.image or "sensor",
            "events": int(sum(kept["window_events"])),
            "leftover": self.leftover,
            "outside": self.outside,
            "dropped": self.dropped,
            **({"passed_over": self.passed_over} if self.config.slices > 1 else {}),
            "cycles": round(float(np.mean(self.cycles)), 1) if self.cycles else None,
            "measured": measured,
            "trusted": trusted,
            "speed_px_per_s": [round(float(q), 3) for q in np.percentile(speeds, (50, 95))] if trusted else None,
            "moved_px": plain(np.nanmedian(self.moved)) if np.isfinite(self.moved).any() else None,
            **({"fit": self.model, "fits": [self.fitted(k) for k in range(len(self))]} if self.model else {}),
        }

    def fitted(self, k):
        """What was fitted to window ``k``, JSON-ready; None where there is no value."""
        field, middle = self.fields[k], np.mean(self._kept["t"][k])
        values = zip(MODELS[self.model], field.values, field.errors, strict=True)
        told = {
            name: plain(one) for axis, value, error in values for name, one in ((axis, value), (f"{axis}_sd", error))
        }
        t_ref = plain(middle) if self._kept["window_events"][k] else None
        return {"window": k, "t_ref_us": t_ref, **told, "tiles": field.tiles, "agree": plain(field.agree)}


def plain(value):
    """A number as JSON can hold it, with six digits behind the point; None for NaN."""
    return round(float(value), 6) if np.isfinite(value) else None


def csv_writer(file, config):
    """A function that writes a window's rows into ``flow.csv``; a last column says which image, if not the sensor's."""
    image = [config.image] * bool(config.image)
    write = csv.writer(file, lineterminator="\n").writerow
    write((*COLUMNS, *["image"] * bool(image)))

    def rows(window):
        for row in window.rows():
            write((*row, *image))

    return rows


def fit_writer(file):
    """A function that writes what :meth:`Flow.fitted` tells of a window into ``fit.csv``."""
    writer = csv.writer(file, lineterminator="\n")

    def row(told):
        if not told["window"]:
            writer.writerow(told)
        writer.writerow("" if value is None else value for value in told.values())

    return row
