"""Tracking from Python: ``cmfpga.track(recording, …)``, and ``cmfpga.Tracker(…)`` for events as they come."""

import contextlib
import itertools
import threading
import warnings

from ..config import preset
from ..config.windows import needs_batches
from ..engines import check_roi, open_engine, usual_preset
from ..errors import ConfigError
from ..events import Feed, Recording, as_events
from ..events.batches import whole
from ..events.recording import check_sensor
from ..imaging.camera import camera_fields
from ..imaging.survey import hot_mask, survey_and_propose, usual_survey, without_hot_pixels
from ..tracking import loop
from ..tracking.fit import batch_cutter
from ..tracking.source import Source, binning_note, rotation_fields, sensor_fields, unit_note, whole_sensor
from .track_result import Tracking


def track(
    recording, *, roi=None, preset=None, engine="rtl", batch_events=None, batch_us=None, batch_roi_events=None,
    start_event=0, batches=None, every=1, sensor=None, time_unit=None, columns=None, dataset=None, form=None,
    drop=False, **fields,
):  # fmt: skip
    """Follow an object through a recording.

    Parameters
    ----------
    recording : str, Path, EventSource, Synthetic, or events in memory
        What to track: a file of any known format, a stream (``"-"``, ``"tcp://host:port"``, ``"camera:"``, a named
        pipe: see :class:`~cmfpga.events.LiveSource`), an opened recording or another
        :class:`~cmfpga.events.EventSource`; or whatever :func:`~cmfpga.events.as_events` takes, with ``sensor``:
        a structured array, a tuple (t, x, y, p), N×4, …
    roi : (int, int) or "auto", optional
        Left column and top row of the first batch's ROI, px; or where something moves clearly, in batches that suit it
        unless they are told. Of a :class:`Synthetic` recording by default the place where the object is in its middle;
        a rotation needs none.
    preset : str, optional
        Configuration to begin with. By default ``"sliding"``, whose windows slide; ``"fast"`` with a batch option, and,
        with a warning, where windows cannot slide.
    engine : {"rtl", "axi", "model", "float"}
        As ``--engine`` of the command.
    batch_events, batch_us, batch_roi_events : int, optional
        One of them: events of the whole sensor, µs, or events in the ROI. Without, windows that slide; or, with
        ``preset="fast"``, batches of as many events as suit the motion (:mod:`cmfpga.tracking.fit`), chosen anew for
        each; 5000 where the confidence is not measured.
    start_event, batches : int
        First event; stop after so many batches, or windows (default: at the end).
    every : int
        Where windows slide, keep the first of so many results.
    sensor : (int, int), optional
        Width and height of the sensor, px; goes before what the file says.
    time_unit : {"s", "ms", "us", "ns"}, optional
        Of the time stamps; goes before what the file says, and before the µs of events in memory.
    columns, dataset, form : optional
        As of :func:`~cmfpga.events.open_recording`; of a stream ``form`` alone.
    drop : bool
        Of a stream: as of :class:`~cmfpga.events.LiveSource`.
    **fields
        Fields of the configuration to change, such as ``roi_width=48``. ``hot_mask="auto"``, beside ``hot_pixels=1``,
        is that of the pixels that a reading of the recording finds. Without either these are dropped, too, with a
        warning, but of a stream, or behind AXI or a serial line. ``hot_pixels=0`` keeps them. ``camera`` undistorts, so
        that ROI and velocity are in the undistorted image: a file as ``--camera`` of the command takes it, a
        :class:`~cmfpga.imaging.camera.Camera`, or its numbers.

    Returns
    -------
    Tracking

    Raises
    ------
    UserError
        An argument, a field or the recording cannot be used; one line.
    """
    size = _batch_size(batch_events, batch_us, batch_roi_events)
    with contextlib.ExitStack() as stack:
        layout = {"columns": columns, "dataset": dataset, "form": form, "drop": drop}
        source = Source(recording, sensor=sensor, time_unit=time_unit, **layout)
        batches_found, cutter, tracking = _begin(
            stack, source, roi, preset, engine, size, start_event, batches, fields, every=every
        )
        for _ in batches_found:
            pass
    if not len(tracking):
        raise cutter.too_few()
    return tracking


class Tracker(contextlib.AbstractContextManager):
    """Follow an object through events that come piece by piece: from a camera, a socket, a program of your own.

    What it finds is what :func:`track` finds in all of them together, however they are cut into pieces. A context
    manager; or :meth:`close` it. Several threads may push: one after the other, each in order of time.

    Parameters
    ----------
    roi : (int, int)
        Left column and top row of the first batch's ROI, px.
    sensor : (int, int)
        Width and height of the sensor, px.
    time_unit : {"s", "ms", "us", "ns"}, optional
        Of the time stamps; whole numbers are µs by default.
    keep : bool
        Keep what is found in :attr:`tracking`, which grows by some kB a batch. False for tracks without an end.
    preset, engine, batch_events, batch_us, batch_roi_events, every, **fields
        As of :func:`track`.

    Attributes
    ----------
    tracking : Tracking
        All batches so far; empty without ``keep``.

    Raises
    ------
    UserError
        An argument or a field cannot be used; one line.
    """

    def __init__(
        self, *, roi, sensor, time_unit=None, keep=True, preset=None, engine="rtl", batch_events=None,
        batch_us=None, batch_roi_events=None, every=1, **fields,
    ):  # fmt: skip
        self._time_unit, self._feed = time_unit, Feed(check_sensor(sensor, "Tracker"), "pushed events")
        self._lock = threading.RLock()
        size = _batch_size(batch_events, batch_us, batch_roi_events)
        with contextlib.ExitStack() as stack:
            self._batches, self._cutter, self.tracking = _begin(
                stack, Source(self._feed), roi, preset, engine, size, 0, None, fields, keep=keep, every=every
            )
            self._open = stack.pop_all()

    def push(self, events):
        """Take events, which follow the last ones in time; returns the batches that they complete.

        Parameters
        ----------
        events : Events, tuple, structured array, N×4 array …
            As :func:`cmfpga.events.as_events` takes them; none are fine, too.

        Returns
        -------
        list of TrackedBatch

        Raises
        ------
        UserError
            The tracker is closed; or the events cannot be used: then none of them is taken.
        """
        taken = as_events(events, self._time_unit)
        with self._lock:
            if self._open is None:
                raise ConfigError("Tracker: it is closed")
            self._feed.push(taken)
            try:
                return [*itertools.takewhile(lambda batch: batch is not None, self._batches)]
            except BaseException:
                self.close()
                raise

    @property
    def leftover(self):
        """Events after the last batch, which is known once the tracker is closed."""
        return self._cutter.leftover

    def close(self):
        """Release the engine. Events after the last complete batch are not tracked. May be called more than once."""
        with self._lock:
            if self._open is None:
                return
            self._feed.end()
            with self._open:
                self._open = None
                for _ in self._batches:  # those that waited for a first length
                    pass

    def __exit__(self, *_):
        self.close()


def _batch_size(events, us, roi_events):
    """What makes a batch complete, as :class:`BatchCutter` takes it; ``{}``: whatever suits."""
    given = {"events": events, "duration_us": us, "roi_events": roi_events}
    return {name: value for name, value in given.items() if value is not None}


def _begin(stack, source, roi, preset, engine, size, start_event, batches, fields, keep=True, every=1):
    """``(the loop's batches, their cutter, the Tracking that collects them)``; ``stack`` closes what is opened."""
    opened, first = source.open(stack), None
    if preset is None:
        given = {name: value for name, value in fields.items() if name not in ("camera", "hot_mask")}
        preset, note = usual_preset(given, batches=bool(size), engine=engine)
        _warn(note)
    _warn(*(opened.notes() if isinstance(opened, Recording) else ()))
    config, note = without_hot_pixels(
        _config(opened, preset, fields), usual_survey(opened, engine, fields), "hot_pixels=0"
    )
    _warn(note)
    if (roi is None or isinstance(roi, str)) and whole_sensor(config):
        roi = whole_sensor(config)
    elif isinstance(roi, str) and roi == "auto":
        (found,) = survey_and_propose(opened, config, start_event=start_event or None)
        roi, start_event = found.roi, found.start_event
        if not size:
            first, config = found.batch_events, found.suited(config, fields)
    elif roi is None:
        if source.motion is None:
            raise ConfigError("roi: the ROI's left column and top row are needed, or 'auto'")
        roi = source.synthetic.roi_start(*config.roi_px)
    check_roi(config, roi, config.pixel)
    every = whole("every", every)
    if size:
        needs_batches(config, f"batch_{next(iter(size))}")
    if every > 1 and not config.slides:
        raise ConfigError(f"every = {every}: windows = sliding is needed")
    if batches is not None:
        batches = whole("batches", batches)
    cutter = batch_cutter(opened, config, start_event=start_event, first=first, **size)
    running = stack.enter_context(contextlib.closing(open_engine(engine, config)))
    _warn(running.note)
    tracking = Tracking(config, engine, source)
    how = {"batches": batches, "consumers": [tracking] if keep else [], "every": every}
    return loop.track(running, cutter, roi=tuple(roi), **how), cutter, tracking


def _warn(*notes, level=4):
    """Where the user calls :func:`track` or :class:`Tracker`, so many functions up."""
    for note in filter(None, notes):
        warnings.warn(note, stacklevel=level)


def _config(source, name, fields):
    given, note = sensor_fields(source, fields, lambda: preset(name), "sensor=(width, height)")
    _warn(unit_note(source, "time_unit="), note, level=5)
    if fields.get("hot_mask") == "auto":
        fields = {**fields, "hot_mask": hot_mask(source)}
    if fields.get("camera"):
        fields = {**fields, **camera_fields(fields["camera"], source)}
    motion = fields.get("motion", preset(name).motion)
    given |= rotation_fields(source, motion, fields, "camera=")
    config = preset(name).replace(**{**given, **fields})
    _warn(binning_note(config, fields), level=5)
    return config
