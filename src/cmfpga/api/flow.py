"""Dense flow from Python: ``cmfpga.dense.flow(recording, …)``."""

import contextlib
import warnings

from ..config import preset as find_preset
from ..dense.fields import check
from ..dense.run import Run
from ..dense.tiles import fitting, store_fields
from ..engines import open_engine
from ..errors import ConfigError
from ..events import Recording, is_live
from ..events.source import EventSource
from ..imaging.camera import camera_fields
from ..imaging.survey import usual_survey, without_hot_pixels
from ..tracking.source import Source, own_camera, sensor_fields, unit_note
from .flow_result import Flow

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
    """The configuration and the table of regions for a source.

    Parameters
    ----------
    source : EventSource
    preset : str
    fields : dict
        Given ones, which go before what the source says.
    tile, step : int
        As of :func:`~.tiles.fitting`.
    option : callable
        ``option(name)``: how a user says ``sensor`` or ``time_unit``.

    Returns
    -------
    Config, Tiles, list of str
        And notes for the user. Raises :exc:`ConfigError`.
    """
    if is_live(source) if not isinstance(source, EventSource) else not source.seekable:
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
