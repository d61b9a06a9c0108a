"""What was found in all windows: arrays, text and files."""

import json
from pathlib import Path

import numpy as np

from ..dense.fields import MODELS, fit_field
from ..dense.window import COLUMNS
from ..errors import naming
from ..show.export import export_flow

#: Files of a run, in its folder.
CSV, ARRAYS, FITS = "flow.csv", "flow.npz", "fit.csv"

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
        names = (name for name, column in COLUMNS.items() if column.shape.startswith("[W"))
        self._kept = {name: [] for name in names if fit or COLUMNS[name].value}

    def __len__(self):
        return len(self.moved)

    def add(self, window):
        """Take the next :class:`~.window.Window`; returns its :class:`~.fields.Field`, or None."""
        self.moved.append(np.nan if window.moved is None else window.moved)
        self.fields.append(field := fit_field(self.model, window) if self.model else None)
        self.outside += window.outside
        self.cycles += [window.cycles] if window.cycles else []
        self.dropped += sum(getattr(window.result, name) for name in _DROPPED)
        fitted = {"fit": field.values, "fit_errors": field.errors} if field else {}
        for name, kept in self._kept.items():
            kept.append(fitted[name] if name in fitted else COLUMNS[name].value(window))
        return field

    @property
    def arrays(self):
        """``{name: array}``, as :data:`~cmfpga.dense.window.COLUMNS` declares them."""
        shared = {name: column.value(self) for name, column in COLUMNS.items() if column.shape in ("[n]", "[2]")}
        return {name: np.array(values) for name, values in (shared | self._kept).items()}

    def ended(self, run):
        """Take over what a :class:`~.run.Run` knows when its last window has come."""
        self.leftover, self.limited, self.passed_over = run.leftover, run.limited, run.passed_over

    def save(self, path):
        """Write :attr:`arrays` as ``.npz``, with what made them as JSON in ``head``."""
        told = {"recording": self.recording, "engine": self.engine, "image": self.config.image, "fit": self.model}
        told |= {"fit_names": MODELS.get(self.model, ()), "config": self.config.to_dict()}
        with naming(path):
            np.savez_compressed(path, head=np.array(json.dumps(told)), **self.arrays)

    def export(self, path):
        """Write the flow as ``flow --export`` does: :func:`~cmfpga.show.export.export_flow`."""
        export_flow(self, path)

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
        t_ref = plain(middle) if self._kept["window_events"][k] else None
        values = [plain(one) for pair in zip(field.values, field.errors, strict=True) for one in pair]
        told = (k, t_ref, *values, field.tiles, plain(field.agree))
        return dict(zip(fit_columns(self.model), told, strict=True))


def fit_columns(model):
    """Names of the columns of ``fit.csv``."""
    return ["window", "t_ref_us", *(part for name in MODELS[model] for part in (name, f"{name}_sd")), "tiles", "agree"]


def plain(value):
    """A number as JSON can hold it, with six digits behind the point; None for NaN."""
    return round(float(value), 6) if np.isfinite(value) else None
