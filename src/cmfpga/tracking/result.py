"""Tracking from Python: ``cmfpga.track(recording, …)`` and the object that it returns."""

import contextlib
import csv
import os
import warnings

import numpy as np

from ..config import DEFAULT_PRESET, preset
from ..engines import check_roi, make_engine
from ..errors import ConfigError, RecordingError
from ..events import BatchCutter, Events, MemoryRecording, Synthetic, open_recording
from ..events.recording import Recording
from ..imaging.gallery import Gallery
from ..report import CLOCK_MHZ
from . import loop as tracker
from .kept import Kept
from .loop import COLUMNS
from .replay import Replay

#: Events of a batch where nothing else is said.
BATCH_EVENTS = 5000

#: Columns that may be empty; NaN in their arrays.
MAY_BE_MISSING = ("t_ref_us", "vx_px_per_s", "vy_px_per_s", "cycles")


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
    recording : str, Path, Recording, Events or Synthetic
        What to track: a file of any known format, or events in memory (:class:`Events` need ``sensor``).
    roi : (int, int), optional
        Left column and top row of the first batch's ROI, px. Of a :class:`Synthetic` recording by default the place
        where the object is in its middle.
    preset : str
        Configuration to begin with.
    engine : {"rtl", "axi", "model", "float"}
        As ``--engine`` of the command.
    batch_events, batch_us, batch_roi_events : int, optional
        One of them: events of the whole sensor (default: 5000), µs, or events in the ROI.
    start_event, batches : int
        First event; stop after so many batches (default: at the end).
    sensor : (int, int), optional
        Width and height of the sensor, px; goes before what the file says.
    time_unit : {"s", "ms", "us", "ns"}, optional
        Of the time stamps; goes before what the file says, and before the µs of events in memory.
    **fields
        Fields of the configuration to change, such as ``eta=0.5``.

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
        if batch_events is batch_us is batch_roi_events is None:
            batch_events = BATCH_EVENTS
        cutter = BatchCutter(
            opened,
            start_event=start_event,
            events=batch_events,
            duration_us=batch_us,
            roi_events=batch_roi_events,
            max_events=config.max_batch_events,
        )
        running = stack.enter_context(contextlib.closing(open_engine(engine, config)))
        if running.note:
            warnings.warn(running.note, stacklevel=2)
        tracking = Tracking(config, engine, source)
        for batch in tracker.track(running, cutter, roi=tuple(roi), batches=batches):
            tracking.add(batch)
    if not len(tracking):
        raise ConfigError(
            f"{opened.name}: too few events for one batch after event {start_event} ({cutter.leftover} left)"
        )
    return tracking


def open_engine(name, config, *, option="engine"):
    """:func:`~cmfpga.engines.make_engine`, where a missing torch is the user's to mend; ``option`` is what chose it."""
    try:
        return make_engine(name, config)
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise ConfigError(f"{option} {name}: torch is not installed; pip install 'cmfpga[reference]'") from None


def _config(recording, name, fields):
    given = {}
    if recording.width is not None:
        given = {"sensor_width": recording.width, "sensor_height": recording.height}
    elif "sensor_width" not in fields:
        size = preset(name)
        warnings.warn(
            f"{recording.name} does not say how large its sensor is: taking {size.sensor_width}×{size.sensor_height} "
            "px; say it with sensor=(width, height)",
            stacklevel=3,
        )
    return preset(name).replace(**{**given, **fields})


class Source:
    """Where a track's events come from, and can be read again.

    Parameters
    ----------
    recording, sensor, time_unit
        As of :func:`track`.

    Attributes
    ----------
    name : str
        For people.
    synthetic : Synthetic or None
    motion : Motion or None
        The true motion, where it is known.
    """

    def __init__(self, recording, *, sensor=None, time_unit=None):
        self._options = {"sensor": sensor, "time_unit": time_unit}
        self.synthetic = recording if isinstance(recording, Synthetic) else None
        if self.synthetic:
            recording = recording.recording("synthetic scene")
        elif isinstance(recording, Events):
            if sensor is None:
                raise ConfigError("sensor: (width, height) in px is needed with events in memory")
            recording = MemoryRecording(recording, *sensor, time_unit=time_unit)
        elif not isinstance(recording, (Recording, str, os.PathLike)):
            raise RecordingError(f"{type(recording).__name__}: a path, a Recording, Events or Synthetic is needed")
        self._recording = recording
        self.name = recording.name if isinstance(recording, Recording) else os.fspath(recording)
        self.motion = self.synthetic.motion if self.synthetic else None

    def open(self, stack):
        """The :class:`Recording`; a file that is opened here is closed by ``stack``, an ``ExitStack``."""
        if isinstance(self._recording, Recording):
            return self._recording
        return stack.enter_context(open_recording(self._recording, **self._options))

    def read(self, first, count):
        """Events ``first … first + count − 1``."""
        parts = []
        with contextlib.ExitStack() as stack:
            for chunk in self.open(stack).chunks(first):
                parts.append(chunk[: count - sum(map(len, parts))])
                if sum(map(len, parts)) == count:
                    break
        return Events.concatenate(parts)


class Tracking:
    """What a track found, batch by batch.

    Each column of ``track.csv`` is an attribute of the same name: an array with one element per batch, in the units of
    :doc:`docs/track.md`. They are not rounded; a value that the CSV leaves empty is NaN.

    Parameters
    ----------
    config : Config
    engine : str
        Name of the engine that ran the batches.
    source : Source
        Where the events come from.

    Attributes
    ----------
    batch, events, roi_events, roi_x, roi_y, iterations : int64 arrays [B]
    t_ref_us, vx, vy, vx_px_per_s, vy_px_per_s, cycles, contrast : float64 arrays [B]
    flags : str array [B]
        Names joined by ``|``; empty where nothing was unusual.
    results : list of BatchResult
        All that the engine returned.
    """

    def __init__(self, config, engine, source):
        self.config = config
        self.engine = engine
        self.source = source
        self.results = []
        self._rows = []  # text, as in the CSV
        self._columns = {name: [] for name in COLUMNS}
        self._first_events = []
        self._runs = []
        self._replay = Replay(config)
        self._kept = Kept(config, engine, source.name, source.motion)
        self._gallery = Gallery(config, source.name, source.motion)

    def add(self, batch):
        """Take one :class:`~cmfpga.tracking.loop.TrackedBatch`, which follows the last one."""
        result, speed = batch.result, batch.v_px_per_s or (np.nan, np.nan)
        values = (
            batch.index,
            np.nan if batch.t_ref is None else batch.t_ref,
            result.events,
            result.roi_events,
            *result.roi,
            *result.v,
            *speed,
            result.iterations,
            np.nan if result.cycles is None else result.cycles,
            batch.contrast,
            batch.flags.text,
        )
        for name, value in zip(COLUMNS, values, strict=True):
            self._columns[name].append(value)
        self._rows.append(batch.row())
        self.results.append(result)
        self._first_events.append(batch.events.first_event)
        self._runs.append(self._replay.settings_of(result))
        self._gallery.add(batch)
        self._kept.add(batch)

    def __len__(self):
        return len(self.results)

    def __getattr__(self, name):
        if name in COLUMNS:
            dtype = str if name == "flags" else np.float64 if self._is_real(name) else np.int64
            return np.array(self._columns[name], dtype)
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    @staticmethod
    def _is_real(name):
        return name in MAY_BE_MISSING or name in ("vx", "vy", "contrast")

    def __dir__(self):
        return [*super().__dir__(), *COLUMNS]

    def __repr__(self):
        return f"<Tracking of {self.source.name}: {len(self)} batches, {self.engine} engine>"

    def to_csv(self, path):
        """Write ``track.csv``, the same text as the command's."""
        with open(path, "w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            writer.writerows(self._rows)

    def to_dataframe(self):
        """A pandas ``DataFrame`` with the columns of ``track.csv``. Needs pandas: ``pip install 'cmfpga[pandas]'``."""
        try:
            import pandas
        except ModuleNotFoundError:
            raise ConfigError("to_dataframe: pandas is not installed; pip install 'cmfpga[pandas]'") from None
        return pandas.DataFrame({name: getattr(self, name) for name in COLUMNS})

    def plot(self, path=None):
        """The picture that the command writes as ``track.png``: a Matplotlib ``Figure``.

        Parameters
        ----------
        path : str or Path, optional
            Write it there as well (PNG, or what the suffix says).
        """
        figure = self._gallery.figure()
        if path is not None:
            figure.savefig(path)
        return figure

    def report(self, path, *, clock_mhz=CLOCK_MHZ):
        """Write the page of ``track --report``: one HTML file that needs nothing else. Needs plotly.

        Parameters
        ----------
        path : str or Path
            The file.
        clock_mhz : float
            Assumed clock of the hardware, MHz.
        """
        from ..report.page import write_page

        write_page(self._kept, path, clock_mhz=clock_mhz)

    def trace(self, batch):
        """Every intermediate of a batch: :class:`~cmfpga.tracking.trace.BatchTrace`. Needs torch; not for ``axi``.

        The batch's events are read again from the recording.

        Parameters
        ----------
        batch : int
            Its number; negative from the end.
        """
        try:
            from .trace import BatchTrace
        except ModuleNotFoundError as error:
            if error.name != "torch":
                raise
            raise ConfigError("trace: torch is not installed; pip install 'cmfpga[reference]'") from None
        if not -len(self) <= batch < len(self):
            raise ConfigError(f"batch {batch}: 0 to {len(self) - 1} is needed")
        result = self.results[batch]
        events = self.source.read(self._first_events[batch], result.events) if result.events else Events.empty()
        plan, thinning = self._runs[batch]
        return BatchTrace(self.config, self.engine, events, result, plan=plan, thinning=thinning, name=self.source.name)
