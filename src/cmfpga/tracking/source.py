"""What can be tracked: files, opened recordings and other sources of events, events in memory, synthetic scenes."""

import contextlib
import os

import h5py

from ..config import preset
from ..errors import ConfigError, RecordingError
from ..events import Events, EventSource, MemoryRecording, Synthetic, as_events, is_live, open_source
from ..events.recording import CHUNK_EVENTS, check_sensor
from ..imaging.camera import calibration_of, camera_fields

#: Sizes of sensors that are sold, px, of which the smallest that holds all events is taken where nothing says the size.
SENSORS = ((128, 128), (240, 180), (304, 240), (320, 320), (346, 260), (640, 480), (1280, 720), (1280, 800))

#: What a configuration without a table of regions takes from this preset; and how many events of the whole sensor its
#: store holds then.
_ROWS_OF, _FIELDS, _STORED = "objects", ("regions", "units", "bin_bits", "store_style"), 65535

#: Of each of the four banks of a rotation's image: with these in UltraRAM they fill the 64 of a KV260.
_MOST_WORDS = 16 << 12


class Source:
    """Where a track's events come from; arguments as of :func:`~cmfpga.api.track.track`.

    ``name`` is for people, ``synthetic`` the :class:`Synthetic` or None, ``motion`` the true one, where it is known.
    """

    def __init__(self, recording, *, sensor=None, time_unit=None, **layout):
        self._options = {"sensor": sensor, "time_unit": time_unit, **layout}
        self.synthetic = recording if isinstance(recording, Synthetic) else None
        if self.synthetic:
            recording = recording.recording("synthetic scene")
        elif not isinstance(recording, (EventSource, str, os.PathLike)):
            recording = as_events(recording, time_unit)
            if sensor is None:
                raise ConfigError("sensor: (width, height) in px is needed with events in memory")
            recording = MemoryRecording(recording, *check_sensor(sensor, "events in memory"))
        self._recording = recording
        self.name = recording.name if isinstance(recording, EventSource) else os.fspath(recording)
        shown = self.synthetic is not None and not self.synthetic.scene.rotation
        self.motion = self.synthetic.motion if shown else None

    def open(self, stack):
        """The :class:`EventSource`; a file that is opened here is closed by ``stack``, an ``ExitStack``."""
        if isinstance(self._recording, EventSource):
            return self._recording
        return stack.enter_context(open_source(self._recording, **self._options))

    def read(self, first, count):
        """Events ``first … first + count − 1``. Raises :exc:`RecordingError` where the source is not seekable."""
        parts, given = [], self._recording
        if not given.seekable if isinstance(given, EventSource) else is_live(given):
            raise RecordingError(f"{self.name}: its events cannot be read again; a recording is needed")
        with contextlib.ExitStack() as stack:
            opened = self.open(stack)
            for chunk in opened.chunks(first, CHUNK_EVENTS):
                parts.append(chunk[: count - sum(map(len, parts))])
                if sum(map(len, parts)) == count:
                    break
        return Events.concatenate(parts)


def sensor_fields(source, given, usual, how):
    """The configuration's fields that the size of a source's sensor determines; and a note where that is a guess.

    ``given`` are fields that the user gives, ``usual()`` is the :class:`Config` whose sensor is taken where nobody
    tells the size, and ``how`` a user says it.
    """
    if source.width is not None:
        return {"sensor_width": source.width, "sensor_height": source.height}, None
    if "sensor_width" in given:
        return {}, None
    config, covered = usual(), (0, 0)  # of a source that gives its events only once
    if getattr(source, "seekable", False) and (first := next(source.chunks(0, CHUNK_EVENTS), None)):
        covered = tuple(int(places.max()) + 1 for places in (first.x, first.y))
    least = config.sensor_width, config.sensor_height
    width, height = likely_sensor(covered, least)
    fields = {"sensor_width": width, "sensor_height": height} if (width, height) != least else {}
    size = f"taking {width}×{height} px"
    return fields, f"{source.name} does not say how large its sensor is: {size}; say it with {how}"


def likely_sensor(covered, least):
    """The size (width, height) that is taken of a sensor of unknown size, px.

    ``least``, the configuration's, where it holds the columns and rows up to the last event, which are ``covered``;
    else the smallest of :data:`SENSORS` that does, or what is covered.
    """
    sizes = (least, *(size for size in SENSORS if size[0] >= least[0] and size[1] >= least[1]), covered)
    return next(size for size in sizes if size[0] >= covered[0] and size[1] >= covered[1])


def rotation_fields(source, motion, given, how):
    """Fields that a rotation takes from the recording by itself; none of another ``motion``, or that are ``given``.

    Its calibration, the whole sensor as the ROI, the binning by which the image fits an FPGA, and the tags that it
    needs. Raises :exc:`ConfigError` without a calibration, which says ``how`` a user gives one.
    """
    if motion != "rotation":
        return {}
    size = {"width": source.width, "height": source.height}
    found = {}
    if not given.get("camera"):
        if not (camera := own_camera(source)):
            raise ConfigError(f"{source.name}: it holds no calibration, which motion = rotation needs: {how}")
        found |= camera
    usual = preset("rotation")
    sensor = {f"sensor_{side}": given.get(f"sensor_{side}", px) for side, px in size.items()}
    told = {name: given[name] for name in ("roi_width", "roi_height", "camera") if name in given}
    known = None not in sensor.values()
    own = {f"roi_{side}": px for side, px in zip(size, sensor.values(), strict=True)}
    for binning in (given.get("binning", 0),) if "binning" in given or not known else range(4):
        with contextlib.suppress(ConfigError):  # what is wrong with it is said of the configuration itself
            image = preset("paper").replace(**sensor, binning=binning, roi_width=2, roi_height=2).geometry.size
            own = {f"roi_{side}": px for side, px in zip(size, image, strict=True)}
            if binning:  # a pixel of the image has the events of many of the sensor
                own |= {"binning": binning, "max_batch_events": (usual.max_batch_events + 1 << 2 * binning) - 1}
            config = usual.replace(**{**sensor, **found, **own, **told, "tag_bits": 20})
            if (bits := config.one_pass.fewest_tag_bits) > usual.tag_bits:
                own["tag_bits"] = bits
            if config.geometry.bank_depth > _MOST_WORDS:
                continue
        break
    found |= own
    return {name: value for name, value in found.items() if value is not None and name not in given}


def binning_note(config, given):
    """A note for the user where pixels are binned because nobody says otherwise, or None."""
    if not config.binning or "binning" in given:
        return None
    pixels, image = (f"{w}×{h}" for w, h in ((config.pixel, config.pixel), config.geometry.size))
    return (
        f"the image of {config.sensor_width}×{config.sensor_height} px does not fit a KV260: pixels are binned "
        f"{pixels}, to {image} (binning = {config.binning}); places and velocities are in the sensor's pixels"
    )


def own_calibration(path):
    """The :class:`~cmfpga.imaging.camera.Calibration` that a recording's file itself holds; None without one."""
    if path is None or not h5py.is_hdf5(path):
        return None
    with h5py.File(path) as file:
        return calibration_of(file, path)


def own_camera(source):
    """The fields that undistort by the calibration that a recording itself holds; none without one."""
    calibration = own_calibration(getattr(source, "path", None))
    return camera_fields(calibration, source) if calibration else {}


def whole_sensor(config):
    """(0, 0), the only place of an ROI for a rotation that is the whole sensor; None of any other."""
    place = config.geometry.roi_x_max, config.geometry.roi_y_max
    return (0, 0) if config.motion == "rotation" and place == (0, 0) else None


def unit_note(source, how):
    """A note for the user where the unit of a source's time is a guess, or None; ``how`` a user says the unit."""
    if getattr(source, "time_unit_source", None) != "assumed":
        return None
    return f"{source.name} does not say its unit of time: taking {source.time_unit}, a guess; say it with {how}"


def with_rows(config, count, given):
    """``config`` with a table that has a row for each of ``count`` objects; as it is where it has regions.

    None of the fields that a user has ``given`` is changed. Raises :exc:`ConfigError` where the hardware cannot have
    regions, or has too few.
    """
    if not config.regions:
        usual = preset(_ROWS_OF)
        fields = {name: getattr(usual, name) for name in _FIELDS} | {"max_batch_events": _STORED}
        fields["regions"] = max(count, usual.regions)
        try:
            config = config.replace(**{name: value for name, value in fields.items() if name not in given})
        except ConfigError as error:
            raise ConfigError(
                f"several objects are regions of one hardware, which this cannot have: {error}; without --preset and "
                "--set it can, and with one --roi it need not"
            ) from None
    if config.slices > 1:
        raise ConfigError(f"slices = {config.slices}: windows that overlap are for cmfpga flow; 1 is needed")
    if count > config.regions:
        raise ConfigError(f"regions = {config.regions}: {count} objects need as many; --set regions={count}")
    return config
