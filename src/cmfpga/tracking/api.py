"""Tracking from Python: ``cmfpga.track(recording, …)``."""

import contextlib
import warnings

from ..config import DEFAULT_PRESET, preset
from ..engines import check_roi, open_engine
from ..errors import ConfigError
from ..events.batches import whole
from . import loop
from .fit import batch_cutter
from .result import Tracking
from .source import Source, sensor_fields, unit_note


def track(
    recording,
    *,
    roi=None,
    preset=DEFAULT_PRESET,
    engine="rtl",
    batch_events=None,
    batch_us=None,
    batch_roi_events=None,
    start_event=0,
    batches=None,
    sensor=None,
    time_unit=None,
    **fields,
):
    """Follow an object through a recording.

    Parameters
    ----------
    recording : str, Path, EventSource, Events or Synthetic
        What to track: a file of any known format, an opened recording or another
        :class:`~cmfpga.events.source.EventSource`, or events in memory (:class:`Events` need ``sensor``).
    roi : (int, int), optional
        Left column and top row of the first batch's ROI, px. Of a :class:`Synthetic` recording by default the place
        where the object is in its middle.
    preset : str
        Configuration to begin with.
    engine : {"rtl", "axi", "model", "float"}
        As ``--engine`` of the command.
    batch_events, batch_us, batch_roi_events : int, optional
        One of them: events of the whole sensor, µs, or events in the ROI. Without, as many events as suit the motion
        (:mod:`cmfpga.tracking.fit`), chosen anew for each batch; 5000 where the confidence is not measured.
    start_event, batches : int
        First event; stop after so many batches (default: at the end).
    sensor : (int, int), optional
        Width and height of the sensor, px; goes before what the file says.
    time_unit : {"s", "ms", "us", "ns"}, optional
        Of the time stamps; goes before what the file says, and before the µs of events in memory.
    **fields
        Fields of the configuration to change, such as ``roi_width=48``.

    Returns
    -------
    Tracking

    Raises
    ------
    UserError
        An argument, a field or the recording cannot be used; one line.
    """
    with contextlib.ExitStack() as stack:
        source = Source(recording, sensor=sensor, time_unit=time_unit)
        opened = source.open(stack)
        config = _config(opened, preset, fields)
        if roi is None:
            if source.motion is None:
                raise ConfigError("roi: the ROI's left column and top row are needed")
            roi = source.synthetic.roi_start(config.roi_width, config.roi_height)
        check_roi(config, roi)
        if batches is not None:
            batches = whole("batches", batches)
        sizes = {"events": batch_events, "duration_us": batch_us, "roi_events": batch_roi_events}
        size = {name: value for name, value in sizes.items() if value is not None}
        cutter = batch_cutter(opened, config, start_event=start_event, **size)
        running = stack.enter_context(contextlib.closing(open_engine(engine, config)))
        if running.note:
            warnings.warn(running.note, stacklevel=2)
        tracking = Tracking(config, engine, source)
        for _ in loop.track(running, cutter, roi=tuple(roi), batches=batches, consumers=[tracking]):
            pass
    if not len(tracking):
        raise cutter.too_few()
    return tracking


def _config(source, name, fields):
    given, note = sensor_fields(source, fields, lambda: preset(name), "sensor=(width, height)")
    for told in filter(None, (unit_note(source, "time_unit="), note)):
        warnings.warn(told, stacklevel=3)
    return preset(name).replace(**{**given, **fields})
