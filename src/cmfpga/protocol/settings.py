"""The settings of a batch: each declared once, in :data:`SETTINGS`.

The core's inputs, its Verilog ports, the registers, :class:`BatchSettings` and the tables of the documentation follow
from that table. How to add a setting: docs/adding.md.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import attrgetter

from ..config.schedule import DISTANCES, STRIDES
from ..config.windows import USUAL_EVENTS, hop_events, hop_of, window_events
from ..fixed import Q, saturate
from .confidence import LIMIT_SCALE
from .shapes import REQUIRED, Declared, Place, leaves, pair, record, up_to, whole

# Which hardware has something: ``when(config)``.
by_signs, with_confidence, with_hot_pixels, with_background, with_windows, with_regions = map(
    attrgetter, ("ascent_rule.has_table", "confidence", "hot_pixels", "background", "slides", "regions")
)


def with_undistortion(config):
    """Only with ``undistortion="on"``."""
    return config.undistortion == "on"


def in_batches(config):
    """Only where no windows slide."""
    return not config.slides


def with_one_roi(config):
    """Only without a table of regions."""
    return not config.regions


def with_rotation(config):
    """Only with ``motion="rotation"``."""
    return config.motion == "rotation"


@dataclass(frozen=True, kw_only=True)
class Setting(Declared):
    """One input of the hardware that may change from batch to batch.

    ``name`` is that of the member of :func:`cmfpga.rtl.payloads.settings`, of the Verilog port behind ``settings_``, of
    the link of its register's fields, and of the field of :class:`BatchSettings`; one without ``field``, ``asked`` and
    ``default`` is no field there, but found from others by ``raw``. Without a ``shape`` it is a whole number that holds
    ``high``.
    """

    high: Callable | None = None  # high(config): largest value; by default the format's, if it has fraction bits
    low: int = 0  # smallest value of an unsigned number; a register limits and flags others
    field: str | None = None  # run-time field of Config that says it; gives doc, unit and reset if nothing else does
    asked: Callable | None = None  # asked(config): its value in BatchSettings, where it is not just that of field
    raw: Callable | None = None  # raw(config, settings): the input's value, where it is not that of BatchSettings
    blocks: tuple = ("core",)  # core, shell (where batches end, in the AXI top), or both
    reset: int | Callable | None = None  # the register's raw value after a reset; reset(config)

    @property
    def of_batch(self):
        """Whether :class:`BatchSettings` has a field for it."""
        return bool(self.field or self.asked or self.default is not REQUIRED)

    def shape_of(self, config):
        if self.shape:
            return self.shape(config)
        high = self.high(config)
        return {part: up_to(most) for part, most in high.items()} if isinstance(high, dict) else up_to(high)

    def limits(self, config, leaf, part):
        q = leaves(self.name, self.shape_of(config))[leaf]
        if self.high:
            high = self.high(config)
            return (None, high[part]) if isinstance(high, dict) else (self.low, high)
        return (q.min if q.signed else self.low, q.max) if q.f else (None, None)

    def reset_of(self, config, q, high):
        if self.reset is not None or not self.field:
            return self.reset(config) if callable(self.reset) else self.reset or 0
        value = int(_field_of(config, self.field).default * (1 << q.f))
        return value if high is None else min(value, high)

    def doc_of(self, config):
        meta = _field_of(config, self.field).metadata if self.field and not self.doc else vars(self)
        return meta["doc"], meta["unit"]

    def ask(self, config):
        """The value that a configuration's run-time fields ask for."""
        if self.asked:
            return self.asked(config)
        if not self.field:
            return self.default
        value, shape = getattr(config, self.field), self.shape_of(config)
        return shape.raw(value) if shape.f else value

    def values(self, config, settings):
        """``{leaf: raw value}`` of the input."""
        value = self.raw(config, settings) if self.raw else getattr(settings, self.name)
        names = leaves(self.name, self.shape_of(config))
        return dict(zip(names, map(int, value if isinstance(value, tuple) else (value,)), strict=True))


def _field_of(config, name):
    return type(config).__dataclass_fields__[name]


def velocity_shape(config):
    """The motion's parameters."""
    return {parameter.name: parameter.fmt for parameter in config.motion_model.parameters}


def _start(config):
    """Raw start velocity; what is no translation starts at 0."""
    start = {"x": config.v_start_x, "y": config.v_start_y} if config.start == "given" else {}
    return tuple(parameter.fmt.raw(start.get(parameter.name, 0.0)) for parameter in config.motion_model.parameters)


def plan_high(config):
    """A part of the schedule's table: largest first entry and number of entries."""
    return {"first": config.schedule_entries - 1, "count": config.schedule_entries}


def plan_places(word, doc):
    """Places of such a part in a register."""
    return (
        Place(word=word, part="_first", field="FIRST", width=16, doc="first entry",
              register_doc=f"{doc}: entries of SCHEDULE"),
        Place(word=word, part="_count", field="COUNT", lsb=16, width=16,
              doc="number of entries; 0: a degenerate batch"),
    )  # fmt: skip


#: Settings that may change while windows slide.
LENGTHS = ("window_events", "window_us", "hop_events", "hop_us", "min_roi_events")

#: The parts of the table of schedules, in order.
PLANS = ("cold", "warm", "follow", "after")


def _plan(name, doc, word=None, when=by_signs):
    """A schedule, behind those before it in the table."""
    before = PLANS[: PLANS.index(name)]
    return Setting(
        name=name, high=plan_high, when=when, default=(), doc=doc, shown=with_one_roi,
        asked=lambda config: getattr(config.schedules, name) if when(config) else (),
        raw=lambda config, settings: (
            sum(len(getattr(settings, one)) for one in before) % config.schedule_entries, len(getattr(settings, name))
        ),
        places=plan_places(word, doc) if word else (),
    )  # fmt: skip


def _length(name, word, low=0, asked=None, reset=None):
    """How long a window or a hop is, at most."""
    return Setting(
        name=name, field=name, low=low, default=0, when=with_windows,
        high=lambda c: c.buffer_events if asked else 1 << (c.span_bits - 1),
        asked=lambda c: (asked(c) if asked else getattr(c, name)) if c.slides else 0,
        reset=reset, places=(Place(word=word),),
    )  # fmt: skip


_ROI = "position of the ROI, for ROI_LOAD; limited to the sensor, with the flag ROI_CLAMPED"

#: In the order of the Verilog ports. Words of the registers' group are given by ``places`` and never change.
SETTINGS = (
    Setting(name="roi_load", shape=lambda c: whole(1), raw=lambda c, s: s.roi is not None, shown=with_one_roi,
            doc="1: crop the batch at the ROI that is given; 0: where the last one moved it",
            places=(Place(word=5, field="LOAD", width=1, access="flag",
                          doc="1: at ROI, instead of where the last one moved it; cleared when used",
                          register_doc="where the next batch is cropped"),)),
    Setting(name="roi_x", shape=lambda c: whole(c.geometry.x_bits), raw=lambda c, s: (s.roi or (0, 0))[0],
            shown=with_one_roi,
            doc="left column of the ROI, limited to the sensor", unit="px",
            places=(Place(word=4, register="ROI", field="X", width=16, doc="left column", register_doc=_ROI),)),
    Setting(name="roi_y", shape=lambda c: whole(c.geometry.y_bits), raw=lambda c, s: (s.roi or (0, 0))[1],
            shown=with_one_roi,
            doc="top row of the ROI, limited to the sensor", unit="px",
            places=(Place(word=4, register="ROI", field="Y", lsb=16, width=16, doc="top row"),)),
    Setting(name="batch_events", high=lambda c: c.slice_events, blocks=("core", "shell"), raw=lambda c, s: 0,
            when=in_batches,
            doc="end a batch after so many events; 0: not by their number", unit="events", places=(Place(word=0),)),
    Setting(name="batch_roi_events", high=lambda c: c.buffer_events, raw=lambda c, s: 0, unit="events",
            shown=with_one_roi, when=in_batches,
            doc="end a batch after so many stored ROI events; 0: not by their number", places=(Place(word=1),)),
    Setting(name="duration", high=lambda c: (1 << c.span_bits) - 1, blocks=("shell",), raw=lambda c, s: 0, unit="µs",
            when=in_batches,
            doc="end a batch before the event that is so much later than its first; 0: not by time",
            places=(Place(word=2, register="BATCH_DURATION"),)),
    Setting(name="by_tlast", shape=lambda c: whole(1), blocks=("shell",), raw=lambda c, s: 0, reset=1, when=in_batches,
            doc="end a batch with TLAST",
            places=(Place(word=3, register="BATCH_TLAST", field="ENABLE", width=1,
                          register_doc="batches and TLAST"),)),
    Setting(name="thinning", field="thinning", shape=lambda c: whole(c.widths.thinning_bits), low=1, default=1,
            high=lambda c: c.widths.thinning_max, shown=with_one_roi, places=(Place(word=11),)),
    Setting(name="thin_target", field="thin_target", high=lambda c: c.buffer_events, default=0, shown=with_one_roi,
            when=in_batches, places=(Place(word=12),)),
    Setting(name="iterations", field="iterations", high=lambda c: c.max_iterations, shown=lambda c: not by_signs(c),
            # The sign ascent does not read it: the hardware may then count to less than the default.
            asked=lambda c: min(c.iterations, c.max_iterations), places=(Place(word=13),)),
    Setting(name="eta", field="eta", shape=lambda c: c.formats.eta, shown=lambda c: not by_signs(c),
            doc="step of the gradient ascent, raw", places=(Place(word=14),)),
    Setting(name="roi_gain", field="roi_gain", shape=lambda c: c.formats.roi_gain,
            shown=lambda c: any(parameter.moves_roi for parameter in c.motion_model.parameters),
            doc="displacement of the ROI per v, raw", places=(Place(word=6),)),
    Setting(name="start_last", shape=lambda c: whole(1), asked=lambda c: c.start == "last", reset=1,
            shown=with_one_roi, when=in_batches,
            doc="1: start from the last batch's v; 0: from the start velocity",
            places=(Place(word=7, register="START_MODE", field="LAST", width=1,
                          doc="1: the last batch's v; 0: V_START_X, V_START_Y",
                          register_doc="start velocity of a batch"),)),
    Setting(name="v_start", shape=velocity_shape, asked=_start, doc="start velocity, raw",
            unit="px/half batch",
            places=(Place(word=8, register="V_START_X", part="_x", unit="", doc="start velocity along x, raw"),
                    Place(word=9, register="V_START_Y", part="_y", unit="", doc="start velocity along y, raw"),
                    Place(word=23, register="V_START_ZOOM", part="_zoom", unit="", doc="start of the zoom, raw"),
                    Place(word=24, register="V_START_ROLL", part="_roll", unit="", doc="start of the roll, raw"))),
    Setting(name="min_roi_events", field="min_roi_events", high=lambda c: c.buffer_events, places=(Place(word=10),)),
    _plan("cold", "schedule of a batch without a last v", 15),
    _plan("warm", "schedule of a batch with a last v", 16),
    _plan("follow", "rounds that begin before a hop's last event; without, warm begins behind it", 135, with_windows),
    _plan("after", "the round after a result that judges the window; at most one", 140, with_windows),
    _length("window_events", 128, low=1, asked=window_events, reset=lambda c: min(USUAL_EVENTS, c.buffer_events)),
    _length("window_us", 130),
    _length("hop_events", 129, low=1, asked=hop_events, reset=lambda c: hop_of(min(USUAL_EVENTS, c.buffer_events))),
    _length("hop_us", 131),
    Setting(name="every", shape=lambda c: whole(16), high=lambda c: (1 << 16) - 1, low=1, blocks=("shell",), reset=1,
            raw=lambda c, s: 1, when=with_windows, unit="results", places=(Place(word=141),),
            doc="send the first of so many results; the ROI moves at each"),
    Setting(name="judge", field="judge", shape=lambda c: whole(1), default=1, when=with_confidence,
            places=(Place(word=17, register="CONFIDENCE", field="JUDGE", width=1,
                          register_doc="how sure v is, and what follows"),)),
    Setting(name="cold_after_doubtful", field="cold_after_doubtful", shape=lambda c: whole(1), default=1,
            when=lambda c: with_confidence(c) and in_batches(c),
            places=(Place(word=17, register="CONFIDENCE", field="COLD_AFTER_DOUBTFUL", lsb=1, width=1),)),
    Setting(name="confidence_limit", low=1, high=lambda c: (1 << c.widths.limit_bits) - 1, when=with_confidence,
            asked=lambda c: round(LIMIT_SCALE * c.confidence_limit), default=90, reset=90,
            doc=f"{LIMIT_SCALE} times the smallest confidence that is not doubtful", unit="1/px²",
            places=(Place(word=18),)),
    Setting(name="hot_mask", shape=lambda c: whole(1), when=with_hot_pixels, default=(), asked=lambda c: c.hot,
            raw=lambda c, s: bool(s.hot_mask), doc="1: drop the events of the pixels that are marked as hot",
            places=(Place(word=19, field="ENABLE", width=1),)),
    Setting(name="background_us", field="background_us", high=lambda c: c.widths.background_us_max, default=0,
            when=with_background, places=(Place(word=20),)),
    Setting(name="camera", shape=lambda c: whole(1), when=with_undistortion, default=(),
            asked=lambda c: c.motion_model.lens(c), raw=lambda c, s: bool(s.camera),
            doc="1: undistort, as the table of nodes says",
            places=(Place(word=21, field="ENABLE", width=1),)),
    Setting(name="centre", when=with_rotation,
            shape=lambda c: {axis: Q(getattr(c.geometry, f"{axis}_bits"), c.motion_model.place_frac, signed=False)
                             for axis in "xy"},
            high=lambda c: pair(*(size - 1 << c.motion_model.place_frac for size in c.geometry.size)),
            raw=lambda c, s: c.motion_model.centre(s.camera), doc="principal point, raw: quarters of a pixel",
            places=(Place(word=25, part="_x", field="X", width=16, doc="column, in quarters of a pixel"),
                    Place(word=25, part="_y", field="Y", lsb=16, width=16, doc="row"))),
    Setting(name="rows", high=lambda c: c.regions, low=1, when=with_regions, default=1,
            doc="rows of the table of regions that are in use", unit="regions", reset=1, places=(Place(word=22),)),
    Setting(name="curve", when=with_rotation, high=lambda c: (1 << c.motion_model.curve_bits) - 1,
            raw=lambda c, s: c.motion_model.curve(s.camera), doc="2^27/f² of the focal length f in px",
            places=(Place(word=26),)),
)  # fmt: skip


def settings_of(config, block):
    """The settings that a block (``core`` or ``shell``) of a configuration has."""
    return tuple(setting for setting in SETTINGS if block in setting.blocks and setting.when(config))


@dataclass(frozen=True, kw_only=True)
class BatchSettings(record("_OfBatch", __name__, (s for s in SETTINGS if s.of_batch))):
    """Run-time inputs of the hardware for one batch, as raw integers of their formats.

    The fields are ``roi``, and those of :data:`SETTINGS` that tools choose: pairs have x and y; ``cold`` and ``warm``
    are the iterations without and with a last v, ``ScheduleEntry`` or ``Round`` each.
    """

    #: Left column and top row of the ROI in px; None leaves it where the last batch's update put it.
    roi: tuple[int, int] | None

    @classmethod
    def from_config(cls, config, roi=None):
        """The settings that ``config``'s run-time fields ask for."""
        return cls(roi=roi, **{setting.name: setting.ask(config) for setting in SETTINGS if setting.of_batch})

    def with_lengths(self, other):
        """These settings with the :data:`LENGTHS` of ``other``."""
        return replace(self, **{name: getattr(other, name) for name in LENGTHS})


def settings_values(config, settings):
    """``{leaf: raw value}`` of the core's settings inputs, by the names of the Verilog ports behind ``settings_``."""
    values = (setting.values(config, settings) for setting in settings_of(config, "core"))
    return {leaf: value for found in values for leaf, value in found.items()}


def schedule_table(config, settings):
    """The table of schedules as :func:`settings_values` points at it, :data:`PLANS`: tuple of :func:`table_entry`."""
    return tuple(table_entry(config, entry) for name in PLANS for entry in getattr(settings, name))


def schedule_highest(config):
    """``{part: largest number}`` of an entry of the hardware's table of schedules: see :func:`table_entry`."""
    largest = config.formats.v.width - 2
    if config.ascent_rule.evaluations > 1:
        return {"level": config.max_level, "distance": len(DISTANCES) - 1, "limit": 2 * largest}
    return {"level": config.max_level, "shift": largest, "stride": len(STRIDES) - 1}


def table_entry(config, entry):
    """An entry of a schedule as numbers of the hardware's table.

    (level, shift, stride) of a ``ScheduleEntry``: v's raw units, log2 of the stride; (level, distance, limit) of a
    ``Round``: the distance's number, the limit's code.
    """
    if config.ascent_rule.evaluations > 1:
        return entry.level, DISTANCES.index(entry.distance), entry.code(config.formats.v)
    return entry.level, entry.log2_step + config.formats.v.f, entry.stride.bit_length() - 1


def clamp_roi(config, roi):
    """``roi`` limited to the sensor, and whether that changed it."""
    most = config.geometry.roi_x_max, config.geometry.roi_y_max
    clamped = tuple(int(saturate(at, 0, limit)) for at, limit in zip(roi, most, strict=True))
    return clamped, clamped != tuple(roi)
