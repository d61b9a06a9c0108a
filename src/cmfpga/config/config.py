"""The one configuration that shapes everything: hardware, integer model, float reference, tools.

A :class:`Config` is frozen and validated on construction. Fields marked *run-time* only set the value that the
tools write to an input of the hardware before a batch; all others shape the hardware itself. Everything
derived from the fields is a property, so that no width is written twice.
"""

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from functools import cached_property, partial

from ..errors import ConfigError, one_of
from .checks import binned_camera, check_field, check_together, parse_camera, parse_pixels
from .choices import ASCENTS, CHOICES, GRADIENTS, UNDISTORTION, WINDOWS
from .derived import Formats, Geometry, OnePass
from .motion import MOTIONS, motion_model
from .regions import Regions
from .schedule import AUTO, Schedules
from .widths import Widths

START_MODES = ("zero", "given", "last")
WHEN_FULL = ("drop", "thin")
RAM_STYLES = ("auto", "block", "ultra")


def _field(default, doc, *, unit="", low=None, high=None, choices=None, runtime=False):
    """A documented field; ``low … high`` or ``choices`` is what validation allows."""
    meta = {"doc": doc, "unit": unit, "low": low, "high": high, "choices": choices, "runtime": runtime}
    return dataclasses.field(default=default, metadata=meta)


_runtime = partial(_field, runtime=True)
#: Of a number of events, and of a time, that a batch or a window is told.
_EVENTS, _US = {"unit": "events", "low": 0, "high": 1 << 17}, {"unit": "µs", "low": 0, "high": 1 << 31}


def unread(fields):
    """``{name: why}`` of those ``fields``, a dictionary of all, that the choices among them do not read."""
    fields, found = {**fields}, {}
    for choice, own in CHOICES.items():
        chosen = fields[choice]
        for other, names in own.items():
            for name in names if chosen in [*own] else ():
                if name in own[chosen] or name in found:
                    continue
                found[name] = f"{name} = {fields[name]!r}: {choice} = {other} is needed; {choice} = {chosen} ignores it"
                fields[name] = getattr(Config, name)
    return found


@dataclass(frozen=True, kw_only=True)
class Config:
    """Parameters of one accelerator.

    A field that the gradient or the ascent does not read has its default.

    Raises
    ------
    ConfigError
        Names the field, its value and what is allowed.
    """

    # Geometry
    sensor_width: int = _field(240, "columns of the sensor", unit="px", low=2, high=4096)
    sensor_height: int = _field(180, "rows of the sensor", unit="px", low=2, high=4096)
    binning: int = _field(0, "pixels of ROI, v and image are 2^binning of the sensor's wide", low=0, high=3)
    evt3: int = _field(0, "1: behind AXI the hardware takes EVT 3.0, too", low=0, high=1)
    roi_width: int = _field(64, "columns of the region of interest (ROI), even", unit="px", low=2, high=4096)
    roi_height: int = _field(64, "rows of the ROI, even", unit="px", low=2, high=4096)

    # Motion
    motion: str = _field("translation", "what the ascent looks for", choices=tuple(MOTIONS))

    # Camera
    undistortion: str = _field("off", "on: the hardware undistorts at ingest", choices=tuple(UNDISTORTION))
    undistortion_cell: int = _field(3, "its table has a node every 2^undistortion_cell px", low=1, high=6)
    undistortion_frac: int = _field(4, "fraction bits of an undistorted position", unit="bits", low=1, high=8)
    camera: str = _runtime("", "calibration: fx,fy,cx,cy,k1,k2,p1,p2,k3; empty: nothing is undistorted")

    # Noise
    hot_pixels: int = _field(0, "1: the hardware has a mask of hot pixels", low=0, high=1)
    hot_mask: str = _runtime("", "hot pixels, whose events are dropped: X,Y;X,Y;…")
    background: int = _field(0, "1: the hardware has a filter of background activity", low=0, high=1)
    background_cell: int = _field(2, "cells of that filter are 2^background_cell px wide", low=1, high=6)
    background_us: int = _runtime(
        0, "drop events without one of another pixel of their cell in so many µs before them; 0: drop none",
        **_US | {"high": (1 << 31) - 1},
    )  # fmt: skip

    # Batches, or windows
    windows: str = _field(
        "batches", "what is evaluated: batches, one after the other; or sliding, the newest events again and again",
        choices=tuple(WINDOWS),
    )  # fmt: skip
    buffer_events: int = _field(
        2048, "ROI events that the event buffer holds, or a ring at least", **_EVENTS | {"low": 1}
    )
    buffers: int = _field(
        1, "event buffers; with 2 a batch is taken in while the one before is optimised", low=1, high=2
    )
    max_batch_events: int = _field(
        65535, "largest batch, or hop, in events of the whole sensor", unit="events", low=1, high=(1 << 31) - 1
    )
    when_full: str = _field(
        "drop", "more ROI events than the buffer holds: drop the surplus, or thin, keep every second one, as often as "
        "needed", choices=WHEN_FULL,
    )  # fmt: skip
    time_bits: int = _field(32, "width of the camera's time stamps, which wrap", unit="bits of µs", low=8, high=48)
    span_bits: int = _field(24, "width of times relative to the batch's first event", unit="bits of µs", low=4, high=32)
    min_roi_events: int = _runtime(1, "fewer ROI events make a batch degenerate", **_EVENTS | {"low": 1})
    thinning: int = _runtime(1, "store one ROI event in so many", low=1, high=Widths.thinning_max)
    thin_target: int = _runtime(0, "choose the thinning so that about so many are stored; 0: off", **_EVENTS)
    window_events: int = _runtime(0, "most events of a window; 0: as suits the motion", **_EVENTS)
    window_us: int = _runtime(
        0, "oldest event of a window when its hop ends; 0: half of what a span counts to, or as suits the motion", **_US
    )
    hop_events: int = _runtime(0, "a hop ends with so many new ROI events; 0: with a 16th of a window's", **_EVENTS)
    hop_us: int = _runtime(4000, "or before the first event that is so much later; 0: at any time", **_US)

    # Regions
    regions: int = _field(0, "rows of the table of regions; 0: a core of one ROI", low=0, high=1024)
    units: int = _field(1, "units that iterate over regions side by side", low=1, high=64)
    slices: int = _field(1, "slices of a window, each of which gives results: windows overlap", low=1, high=16)
    bin_bits: int = _field(4, "bins of the store of events are 2^bin_bits px wide", low=2, high=12)
    store_style: str = _field(
        "auto", "RAM of that store; above four units, of event buffers", choices=("auto", "ultra")
    )

    # Ascent
    gradient: str = _field("sweep", "gradient architecture", choices=tuple(GRADIENTS))
    ascent: str = _field(
        "constant", "constant: v + η·∂C/∂v; newton: rounds of a schedule; sign: steps of one", choices=tuple(ASCENTS)
    )
    evaluators: int = _field(1, "images that an iteration of ascent = newton fills at a time", choices=(1, 4))
    border: str = _field(
        "corners", "what changes the derivatives at the image's border: corners inside; or whole, events with all four "
        "inside", choices=("corners", "whole"),
    )  # fmt: skip
    iterations: int = _runtime(100, "iterations of a batch (T)", low=1, high=65535)
    max_iterations: int = _field(1023, "largest T that the hardware counts to", low=1, high=65535)
    cold: str = _runtime(AUTO, "schedule without a last v; auto: the best measured")
    warm: str = _runtime(AUTO, "schedule from the last v; auto: the best measured")
    follow: str = _runtime(
        AUTO, "rounds that begin before a hop's last event; auto: the best measured; empty: warm, after it"
    )
    after: str = _runtime(AUTO, "the round after a result that judges the window; auto: the best measured; empty: none")
    schedule_entries: int = _field(32, "iterations that the table of schedules holds, of all of them", low=2, high=256)
    max_level: int = _field(0, "coarsest level: pixels 2^level px wide", low=0, high=3)
    eta: float = _runtime(1.0, "step η of the constant ascent", unit="(px/half batch)² per (events/px)²", low=0.0)
    start: str = _runtime("last", "start velocity of a batch", choices=START_MODES)
    v_start_x: float = _runtime(0.0, "start velocity along x when start = given", unit="px/half batch")
    v_start_y: float = _runtime(0.0, "start velocity along y when start = given", unit="px/half batch")
    roi_gain: float = _runtime(2.0, "ROI displacement per v; 2 because v is per half batch", low=0.0)

    # Confidence
    confidence: int = _field(0, "1: the hardware can tell how sure v is; not with sweep or constant", low=0, high=1)
    judge: int = _runtime(1, "1: tell how sure v is, and flag doubtful batches", low=0, high=1)
    confidence_limit: float = _runtime(
        30.0, "smallest confidence of a batch that is not doubtful", unit="1/px²", low=1.0, high=341.0
    )
    cold_after_doubtful: int = _runtime(1, "1: a batch that follows a doubtful one starts cold", low=0, high=1)

    # Fixed-point formats
    dt_frac: int = _field(12, "fraction bits of dt (range −1 … 1)", unit="bits", low=2, high=16)
    v_int: int = _field(5, "integer bits of v", unit="bits", low=1, high=10)
    v_frac: int = _field(12, "fraction bits of v", unit="bits", low=1, high=16)
    position_frac: int = _field(8, "fraction bits of a warped position", unit="bits", low=1, high=12)
    weight_frac: int = _field(8, "fraction bits of a vote", unit="bits", low=1, high=16)
    derivative_frac: int = _field(8, "fraction bits of a vote's derivative", unit="bits", low=1, high=16)
    reciprocal_bits: int = _field(16, "precision of the reciprocal of the batch's range", unit="bits", low=4, high=17)
    gradient_int: int = _field(11, "integer bits of the contrast's gradient", unit="bits", low=1, high=20)
    gradient_frac: int = _field(24, "fraction bits of the contrast's gradient", unit="bits", low=4, high=32)
    eta_int: int = _field(6, "integer bits of η", unit="bits", low=0, high=10)
    eta_frac: int = _field(10, "fraction bits of η", unit="bits", low=1, high=16)
    roi_gain_int: int = _field(2, "integer bits of roi_gain", unit="bits", low=1, high=4)
    roi_gain_frac: int = _field(4, "fraction bits of roi_gain", unit="bits", low=0, high=8)
    dither_frac: int = _field(0, "fraction bits of the dither of positions; 0: none", unit="bits", low=0, high=8)
    tag_bits: int = _field(8, "width of the iteration's number in the one-pass banks", unit="bits", low=2, high=20)

    # Memories
    ram_style: str = _field("auto", "kind of RAM of the banks", choices=RAM_STYLES)

    def __post_init__(self):
        for field in dataclasses.fields(self):
            check_field(self, field, getattr(self, field.name))
        for name, why in unread(vars(self)).items():
            if getattr(self, name) != self.__dataclass_fields__[name].default:
                raise ConfigError(why)
        check_together(self)

    def replace(self, **changes):
        """A copy with some fields changed; what its gradient or ascent does not read goes back to the default.

        Unknown names, and fields that are not read, raise :exc:`ConfigError`.
        """
        self._check_names(changes)
        idle = unread(self.to_dict() | changes)
        for name in changes:
            if name in idle:
                raise ConfigError(idle[name])
        return Config(**self.to_dict() | {name: getattr(Config, name) for name in idle} | changes)

    @classmethod
    def _check_names(cls, names):
        known = [field.name for field in dataclasses.fields(cls)]
        for name in names:
            if name not in known:
                raise ConfigError(f"{name!r}: no such field; {one_of(name, known, '`cmfpga build --list-fields`')}")

    @classmethod
    def parse(cls, assignments):
        """Turn ``FIELD=VALUE`` strings into a dictionary for :meth:`replace`."""
        types = {field.name: field.type for field in dataclasses.fields(cls)}
        changes = {}
        for text in assignments:
            name, equals, value = text.partition("=")
            if not equals:
                raise ConfigError(f"{text!r}: FIELD=VALUE is needed")
            cls._check_names([name])
            try:
                changes[name] = types[name](value)
            except ValueError:
                kind = "an integer" if types[name] is int else "a number"
                raise ConfigError(f"{name} = {value!r}: {kind} is needed") from None
        return changes

    def to_dict(self):
        """All fields, JSON-ready."""
        return dataclasses.asdict(self)

    @cached_property
    def hardware_fields(self):
        """The fields that shape the hardware: run-time values left out, and a binning of none, as before it came."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if not f.metadata["runtime"]}
        return fields if self.binning else {name: value for name, value in fields.items() if name != "binning"}

    @cached_property
    def hardware_hash(self):
        """Hexadecimal SHA-256 of the hardware fields: equal hash, equal Verilog."""
        return hashlib.sha256(json.dumps(self.hardware_fields, sort_keys=True).encode()).hexdigest()

    formats = cached_property(Formats)
    geometry = cached_property(Geometry)
    widths = cached_property(Widths)
    schedules = cached_property(Schedules)
    one_pass = cached_property(OnePass)
    store = cached_property(Regions)
    motion_model = cached_property(motion_model)

    @cached_property
    def hot(self):
        """The pixels of ``hot_mask``: tuple of (column, row)."""
        return parse_pixels(self.hot_mask, self)

    @cached_property
    def lens(self):
        """The nine numbers of ``camera``, in the order of :data:`cmfpga.config.checks.CAMERA_NAMES`; () without one.

        In pixels of the image, which are wider than the sensor's with ``binning``.
        """
        return binned_camera(self.calibration, self.binning)

    @cached_property
    def calibration(self):
        """The numbers of ``camera`` as they are given, in pixels of the sensor."""
        return parse_camera(self.camera)

    @property
    def pixel(self):
        """Width of a pixel of ROI, v and image, in pixels of the sensor: users are told all in those."""
        return 1 << self.binning

    @property
    def roi_px(self):
        """Columns and rows of the ROI, in pixels of the sensor."""
        return self.roi_width << self.binning, self.roi_height << self.binning

    @property
    def slice_events(self):
        """The most events that are taken in for a result: those of a batch, or of a slice of a window."""
        return self.max_batch_events // self.slices

    @property
    def skips(self):
        """Whether a vector's events outside the ROI are dropped at once: nothing in front of its filter needs them."""
        front = self.hot_pixels or self.background or self.binning or self.undistortion == "on"
        return bool(self.evt3 and not (front or self.regions or self.slides))

    @property
    def slides(self):
        """Whether windows slide."""
        return self.windows == "sliding"

    @property
    def noun(self):
        """What a result is of, for people; :attr:`nouns` of several."""
        return "window" if self.slides else "batch"

    @property
    def nouns(self):
        return "windows" if self.slides else "batches"

    @property
    def roi_stays(self):
        """Whether the ROI of an object that is lost stays. Where windows slide it follows v, trusted or not."""
        return bool(self.cold_after_doubtful and not self.slides)

    @property
    def image(self):
        """Which image ROI and v are in, for people: ``undistorted``; empty where it is what the sensor sees."""
        return "undistorted" if self.lens else ""

    @cached_property
    def ascent_rule(self):
        """How v ascends: an entry of :data:`cmfpga.config.choices.ASCENTS`."""
        return ASCENTS[self.ascent]
