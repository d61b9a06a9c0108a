"""Dense flow from Python: ``cmfpga.dense.flow(recording, …)``, and what was found in all windows: arrays and files."""

import contextlib
import json
import warnings
from pathlib import Path

import numpy as np

from ..config import preset as find_preset
from ..dense.fields import MODELS, check, fit_field
from ..dense.tiles import fitting, store_fields
from ..dense.window import COLUMNS, Run
from ..engines import open_engine
from ..errors import ConfigError, naming
from ..events import Recording
from ..imaging.camera import camera_fields
from ..imaging.survey import usual_survey, without_hot_pixels
from ..show.export import export_flow
from ..show.page import plain
from ..tracking.source import Source, own_camera, sensor_fields, unit_note

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
        speeds = np.concatenate([np.hypot(*v[one].T) for v, one in zip(kept["v"], kept["trusted"], strict=True)])
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


#: What the command and :func:`flow` take if nothing is told.
PRESET, ENGINE = "flow", "rtl"

#: Rows that a table of regions can have (field ``regions``).
MOST_REGIONS = 1024


def flow(
    recording, *, tile=None, step=None, window_events=None, window_us=None, start_event=0, windows=None, fit=None,
    preset=PRESET, engine=ENGINE, sensor=None, time_unit=None, columns=None, dataset=None, **fields,
):  # fmt: skip
    """Dense optical flow of a recording, by the simulated hardware.

    Parameters
    ----------
    recording : str, Path, EventSource, Synthetic, or events in memory
        As of :func:`cmfpga.track`, but no stream. Where a file holds its calibration, events are undistorted by it.
    tile, step : int
        Width and height of a tile, and from a tile to the next one, px; by default 32 (48 where the sensor is HD), and
        half a tile (three quarters, or a whole one, where the sensor would have more tiles than the largest table).
    window_events, window_us : int, optional
        Events, or µs, of each window; without either as many events as suit the motion.
    start_event, windows : int
        First event; stop after so many windows (default: at the end).
    fit : {"translation", "similarity", "affine", "rotation"}, optional
        Fit one motion to the field of each window; a rotation needs a calibration.
    preset : str
        Configuration to begin with; one with regions.
    engine : {"rtl", "model", "float"}
    sensor, time_unit, columns, dataset : optional
        As of :func:`cmfpga.track`.
    **fields
        Fields of the configuration to change; ``camera`` and hot pixels as of :func:`cmfpga.track`.

    Returns
    -------
    Flow

    Raises
    ------
    UserError
        An argument, a field or the recording cannot be used; one line.
    """
    with contextlib.ExitStack() as stack:
        source = Source(recording, sensor=sensor, time_unit=time_unit, columns=columns, dataset=dataset)
        opened = source.open(stack)
        if fields.get("camera"):
            fields |= camera_fields(fields["camera"], opened)
        config, tiles, notes = configure(opened, preset, fields, tile, step, lambda name: f"{name}=")
        config, hot = without_hot_pixels(config, usual_survey(opened, engine, fields), "hot_pixels=0")
        for note in (*(opened.notes() if isinstance(opened, Recording) else ()), *notes, *filter(None, [hot])):
            warnings.warn(note, stacklevel=2)
        if fit:
            check(fit, config)
        running = stack.enter_context(contextlib.closing(open_engine(engine, config)))
        size = {"window_events": window_events, "window_us": window_us}
        run = Run(opened, running, tiles, start_event=start_event, windows=windows, **size)
        found = Flow(config, tiles, source.name, engine, fit)
        for window in run:
            found.add(window)
        found.ended(run)  # which looks at the recording
    if not len(found):
        raise run.cutter.too_few()
    return found


def configure(source, preset, fields, tile, step, option):
    """The configuration and the table of regions for a source: :class:`Config`, :class:`Tiles`, and notes for the user.

    ``fields`` are given ones, which go before what the source says. ``tile`` and ``step`` are as of
    :func:`~.tiles.fitting`. ``option(name)`` is how a user says ``sensor`` or ``time_unit``. Raises :exc:`ConfigError`.
    """
    if not source.seekable:
        raise ConfigError(f"{source.name}: a stream; a recording is needed")
    usual = find_preset(preset)
    if not fields.get("regions", usual.regions):
        raise ConfigError(f"preset {preset!r} has no regions; preset 'flow' is needed, or regions = 1 or more")
    found, size_note = sensor_fields(source, fields, lambda: usual, option("sensor"))
    notes = [note for note in (unit_note(source, option("time_unit")), size_note) if note]
    if fields.get("undistortion", usual.undistortion) != "off" and not fields.get("camera"):
        found |= own_camera(source)
    config = usual.replace(**{**found, **fields})
    config = config.replace(**store_fields(config, fields))
    tiles = fitting(config, config.regions if "regions" in fields else MOST_REGIONS, tile, step)
    if len(tiles.regions) > config.regions:
        config = config.replace(regions=len(tiles.regions))
    grown = [name for name in ("regions", *store_fields(usual, {})) if getattr(config, name) != getattr(usual, name)]
    if {*grown} - {*fields}:
        words = (f"--set {name}={getattr(config, name)}" for name in ("sensor_width", "sensor_height", *grown))
        notes.append(
            f"{len(tiles)} tiles of {tiles.width} px every {(*tiles.columns, 0)[1] or tiles.width} px; the hardware: "
            f"cmfpga build --preset {preset} {' '.join(words)}"
        )
    return config, tiles, notes
