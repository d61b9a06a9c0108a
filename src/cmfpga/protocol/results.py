"""The result of a batch: each of its fields declared once, in :data:`RESULTS`.

The core's output, its Verilog ports, the result packet, registers and counters, :class:`BatchResult` and the tables of
the documentation follow from that table. How to add a field: docs/adding.md.
"""

import dataclasses
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ..fixed import Q
from .flags import OF_CONFIDENCE, Flag
from .settings import (
    in_batches,
    velocity_shape,
    with_background,
    with_confidence,
    with_hot_pixels,
    with_regions,
    with_windows,
)
from .shapes import Declared, Place, always, corner, leaves, pair, record, up_to, whole

CYCLE_BITS = 32


@dataclass(frozen=True, kw_only=True)
class ResultField(Declared):
    """One field of a batch's result.

    ``name`` is that of the member of :func:`cmfpga.rtl.payloads.result`, of the Verilog port behind ``result_``, of the
    link of its registers' fields, and of the attribute of :class:`BatchResult`. Word k of its places is also the k-th
    32-bit word of a result packet. Where the hardware has it not, outcomes have the default.
    """

    scope: str  # batch; region, of one region of interest; wrapper, of the AXI top alone (WireResult); packet
    counts: bool | Callable = False  # one of those that add up to events; counts(config)
    taken_in: bool = False  # known when the batch has been taken in, before its first iteration
    read: Callable | None = None  # read(*raw leaves): the attribute; by default real numbers, a tuple if several
    nothing: Any = 0  # the attribute of a batch without events
    total: Place | None = None  # the counter that adds it up over all results

    def value(self, config, values):
        """The attribute's value of ``{leaf: raw value}``."""
        formats = leaves(self.name, shape := self.shape(config))
        raw = [values[leaf] for leaf in formats]
        if self.read:
            return self.read(*raw)
        real = tuple(q.real(one) if q.f else one for q, one in zip(formats.values(), raw, strict=True))
        return real[0] if isinstance(shape, Q) else real


def thins(config):
    """Only where a full buffer thins out what it holds."""
    return config.when_full == "thin" and not config.slides


def _thinning_used(config):
    """It is doubled only while the events, thinned by half of it, exceed the buffer."""
    most = config.widths.thinning_max
    return up_to(max(most, 2 * (config.max_batch_events + most) // config.buffer_events))


def _corner(config):
    if config.regions:
        return pair(whole(config.geometry.x_bits), whole(config.geometry.y_bits))
    return pair(up_to(config.geometry.roi_x_max), up_to(config.geometry.roi_y_max))


def sums_shape(config):
    """Sums over the ROI: ΣI, ΣDx, ΣDy; and Σ I·D of each parameter of the motion."""
    w, i, d = config.widths, config.weight_frac, config.derivative_frac
    sum_d, s = Q(w.sum_d_bits - 1 - d, d), Q(w.s_bits - 1 - w.s_frac, w.s_frac)
    sums = {f"s{name}": s for name in config.motion_model.names}
    return {"i": Q(w.sum_i_bits - i, i, signed=False), "dx": sum_d, "dy": sum_d, **sums}


def squares_shape(config):
    """Σ I² over the ROI."""
    return Q(config.widths.squares_bits - 2 * config.weight_frac, 2 * config.weight_frac, signed=False)


def curvature_shape(config):
    """Falls of the gradient between the probes: along x, y, crosswise; beyond translation the least one."""
    fraction, names = config.widths.s_frac, ("least",) if config.motion_model.basis else ("xx", "yy", "cross")
    return dict.fromkeys(names, Q(config.widths.curvature_bits - 1 - fraction, fraction))


def trace_shape(config):
    """One iteration: the velocity that it used, and its sums."""
    return {"v": velocity_shape(config), "sums": sums_shape(config)}


def _long(word, name, part, doc, signed=None):
    """Two registers of one number."""
    return tuple(
        Place(word=word + k, register=f"{name}_{half}", part=part, part_lsb=32 * k, doc=doc,
              register_doc=f"{doc}, {half.lower()} 32 bits", signed=signed if k else False)
        for k, half in enumerate(("LOW", "HIGH"))
    )  # fmt: skip


_FLAGS = tuple(
    Place(word=1, field=flag.name, lsb=bit, width=1, part_lsb=bit, register_doc="what was unusual",
          doc=f"as the flag of that name: {flag.text}")
    for flag in Flag for bit in [flag.bit_length() - 1]
)  # fmt: skip
_JUDGED = {"scope": "region", "when": with_confidence, "default": None}
_EVENTS = {"shape": lambda c: up_to(c.max_batch_events), "taken_in": True, "unit": "events"}
_COUNT = {**_EVENTS, "scope": "region", "counts": True}
_FILTERED = {"scope": "batch", "default": 0}

#: In the order of the Verilog ports, behind which come those of the AXI top. Words never change.
RESULTS = (
    ResultField(name="v", shape=velocity_shape, scope="region", doc="velocity", unit="px/half batch",
                places=(Place(word=4, register="RESULT_V_X", part="_x", doc="velocity along x, raw: see FORMATS"),
                        Place(word=5, register="RESULT_V_Y", part="_y", doc="velocity along y, raw"),
                        Place(word=38, register="RESULT_V_ZOOM", part="_zoom", doc="zoom at the lever arm, raw"),
                        Place(word=39, register="RESULT_V_ROLL", part="_roll", doc="roll at the lever arm, raw"))),
    ResultField(name="t_first", shape=lambda c: whole(c.time_bits), scope="batch", taken_in=True, default=None,
                nothing=None, doc="time stamp of the first event, t_1", unit="µs", places=(Place(word=6),)),
    ResultField(name="span", shape=lambda c: whole(c.span_bits), scope="batch", taken_in=True, doc="t_N − t_1",
                unit="µs", places=(Place(word=7),)),
    ResultField(name="events", **_EVENTS, scope="batch", doc="N; the sum of all counts of events that follow",
                places=(Place(word=9),)),
    ResultField(name="roi_events", **_COUNT | {"shape": lambda c: up_to(c.buffer_events), "counts": in_batches},
                doc="n: in the ROI, and stored", places=(Place(word=10),),
                total=Place(word=18, doc="stored, of all results")),
    ResultField(name="outside", **_COUNT, doc="outside the ROI", places=(Place(word=11),),
                total=Place(word=19, doc="outside the ROI, of all results")),
    ResultField(name="overflow", **_COUNT, doc="in the ROI, but the event buffer was full", places=(Place(word=12),),
                total=Place(word=20, doc="dropped: the event buffer was full")),
    ResultField(name="thinned", **_COUNT, doc="in the ROI, but left out by the thinning", places=(Place(word=13),),
                total=Place(word=21, doc="left out by the thinning")),
    ResultField(name="time_back", **_COUNT | {"scope": "batch"}, doc="dropped: time stepped back",
                places=(Place(word=14),), total=Place(word=22, doc="dropped: time stepped back within the batch")),
    ResultField(name="time_span", **_COUNT | {"scope": "batch"}, doc="dropped: too late for the span",
                places=(Place(word=15),),
                total=Place(word=23, doc="dropped: later than the batch's first event by 2^span_bits µs or more")),
    ResultField(name="roi", shape=_corner, scope="region", taken_in=True, unit="px",
                doc="ROI that this batch was cropped with", places=corner(16)),
    ResultField(name="roi_next", shape=_corner, scope="region", taken_in=True, unit="px",
                doc="ROI that the next batch is cropped with, unless it loads another", places=corner(17)),
    ResultField(name="iterations", shape=lambda c: whole(c.widths.iteration_bits), scope="region",
                doc="iterations done", places=(Place(word=2),)),
    ResultField(name="sums", shape=sums_shape, scope="region", default=None, nothing=(0,) * 5,
                doc="sums of the last iteration; 0 in a degenerate batch", read=lambda *raw: raw,
                places=(*_long(18, "RESULT_SUM_I", "_i", "ΣI of the last iteration, raw; 0 in a degenerate batch"),
                        *_long(20, "RESULT_SUM_DX", "_dx", "ΣDx"), *_long(22, "RESULT_SUM_DY", "_dy", "ΣDy"),
                        *_long(24, "RESULT_SX", "_sx", "Σ I·Dx"), *_long(26, "RESULT_SY", "_sy", "Σ I·Dy"),
                        *_long(40, "RESULT_SZOOM", "_szoom", "Σ I·D of the zoom"),
                        *_long(42, "RESULT_SROLL", "_sroll", "Σ I·D of the roll"))),
    ResultField(name="cycles", shape=lambda c: whole(CYCLE_BITS), scope="region", default=None, nothing=None,
                doc="from the first event's offer to the result; of a hop from its end on", unit="cycles",
                places=(Place(word=3),)),
    ResultField(name="flags", shape=lambda c: whole(len(Flag) - len(OF_CONFIDENCE) * (not c.confidence)),
                scope="region", read=Flag, nothing=Flag.DEGENERATE, doc="what was unusual", places=_FLAGS),
    ResultField(name="thinning_used", shape=_thinning_used, scope="region", taken_in=True, when=thins, default=None,
                nothing=None, places=(Place(word=28),),
                doc="one ROI event in so many was stored: the thinning, doubled each time the buffer was full"),
    ResultField(name="confidence_limit", shape=lambda c: whole(c.widths.limit_bits), **_JUDGED, unit="1/px²",
                doc="the limit that v's confidence was compared with, as the setting of that name; 0: not compared",
                places=(Place(word=29),)),
    ResultField(name="sum_squares", shape=squares_shape, **_JUDGED, read=int, doc="Σ I² of the last iteration",
                places=_long(30, "RESULT_SQUARES", "", "Σ I² of the last iteration, raw")),
    ResultField(name="curvature", shape=curvature_shape, **_JUDGED, nothing=(0,) * 3, read=lambda *raw: raw,
                doc="how far the gradient falls between the probes; 0 if there were none",
                places=(*_long(32, "RESULT_CURVATURE_LEAST", "_least", "least fall of G along a parameter, raw"),
                        *_long(32, "RESULT_CURVATURE_XX", "_xx", "fall of G_x along x, raw; 0 if nothing was probed"),
                        *_long(34, "RESULT_CURVATURE_YY", "_yy", "fall of G_y along y"),
                        *_long(36, "RESULT_CURVATURE_CROSS", "_cross", "falls of G_y along x and of G_x along y"))),
    ResultField(name="restarted", shape=lambda c: whole(1), **_JUDGED, read=int, unit="batches",
                doc="1: began cold, because the batch before was doubtful",
                places=(Place(word=1, field="RESTARTED", register="RESULT_FLAGS", lsb=18, width=1),),
                total=Place(word=27, doc="began cold, because the batch before was doubtful")),
    ResultField(name="t_us", shape=lambda c: whole(c.time_bits), scope="batch", taken_in=True, when=with_windows,
                default=None, nothing=None, doc="when the hop ended", unit="µs", places=(Place(word=44),)),
    ResultField(name="fresh", **_COUNT | {"shape": lambda c: up_to(c.buffer_events), "default": None},
                when=with_windows, doc="of the window's events those that this hop brought", places=(Place(word=45),)),
    ResultField(name="late", **_COUNT | {"shape": lambda c: up_to(c.buffer_events), "counts": False, "default": None},
                when=with_windows, doc="later than the unit of time, and counted as at its end",
                places=(Place(word=46),)),
    ResultField(name="hot", **_COUNT | _FILTERED, when=with_hot_pixels, doc="dropped: of pixels marked as hot",
                places=(Place(word=47),)),
    ResultField(name="noise", **_COUNT | _FILTERED, when=with_background, places=(Place(word=48),),
                doc="dropped: no other pixel of the cell had an event shortly before"),
    ResultField(name="batch", shape=lambda c: whole(32), scope="wrapper", places=(Place(word=0),),
                doc="number of the batch, from 1 after a reset; 0: no result yet"),
    ResultField(name="t_ref", shape=lambda c: whole(32), scope="wrapper", nothing=None, places=(Place(word=8),),
                doc="reference time, t_1 + (t_N − t_1)/2, rounded down", unit="µs"),
    ResultField(name="wire", shape=lambda c: whole(1), scope="wrapper", default=False, nothing=False, read=bool,
                doc="words or events were dropped at the input since the last result",
                places=(Place(word=1, register="RESULT_FLAGS", field="WIRE", lsb=16, width=1),)),
    ResultField(name="config_range", shape=lambda c: whole(1), scope="wrapper", default=False, nothing=False, read=bool,
                doc="a setting of this batch was out of range, and limited",
                places=(Place(word=1, register="RESULT_FLAGS", field="CONFIG_RANGE", lsb=17, width=1),)),
    ResultField(name="last", shape=lambda c: whole(1), scope="packet", when=with_regions,
                doc="1: the last region's result of its batch",
                places=(Place(word=1, register="RESULT_FLAGS", field="LAST", lsb=19, width=1),)),
    ResultField(name="region", shape=lambda c: whole(c.store.number_bits), scope="packet", when=with_regions,
                doc="whose result it is: row of the table of regions",
                places=(Place(word=1, register="RESULT_FLAGS", field="REGION", lsb=20, width=12),)),
)  # fmt: skip


def packet_beats(config):
    """64-bit words of a result packet: it has room for all fields, and for the parts of them that there are.

    Where windows slide only for the fields that are there, and for theirs and those of filters only there.
    """
    return 1 + max(
        place.word // 2
        for f in RESULTS
        if f.when(config) or not (config.slides or f.when in (with_windows, with_hot_pixels, with_background))
        for place in f.places
        if not f.when(config) or f.name + place.part in leaves(f.name, f.shape(config))
    )


#: Fields that add up to ``events`` in hardware without filters of noise: every event is counted once.
COUNTS = tuple(f.name for f in RESULTS if f.counts and f.when is always)


def fields_of(*scopes, config=None):
    """The fields of some scopes, in order (the core's are batch and region); with ``config`` those it has."""
    return tuple(f for f in RESULTS if f.scope in scopes and (config is None or f.when(config)))


def counts_of(config):
    """:data:`COUNTS`, and those of the filters that the hardware has."""
    return tuple(f.name for f in RESULTS if f.when(config) and (f.counts(config) if callable(f.counts) else f.counts))


def not_judged(config):
    """Fields of a batch whose v was not probed, where the hardware has them."""
    fields = (f for f in fields_of("region", config=config) if f.when is with_confidence)
    return {f.name: f.value(config, defaultdict(int)) for f in fields}


def decode(config, values, *more):
    """``{name: value}`` of a result, of the raw ``values`` of its leaves.

    Those are of the Verilog ports behind ``result_``, or of a result packet, which has the scope ``wrapper``, too.
    """
    found = {f.name: f.value(config, values) for f in fields_of("batch", "region", *more, config=config)}
    if Flag.DEGENERATE in found["flags"]:
        if config.slides:
            found["t_first"] = None  # it may be longer ago than a span counts to
        found["sums"] = (0,) * len(found["sums"])  # the core's mean nothing then
        found |= not_judged(config)
    return found


@dataclass(frozen=True, kw_only=True)
class RegionOutcome(record("_RegionFields", __name__, fields_of("region"))):
    """What came of one region of interest in a batch: the fields of :data:`RESULTS` with the scope ``region``.

    ``trace``, a :class:`cmfpga.protocol.trace.Trace`, has the iterations; its last sums are ``sums`` unless given.
    """

    trace: Any = field(default=None, repr=False)

    def __post_init__(self):
        if self.sums is None and self.trace is not None:
            object.__setattr__(self, "sums", self.trace.last_sums)


@dataclass(frozen=True, kw_only=True, init=False)
class BatchResult(record("_BatchFields", __name__, fields_of("batch"))):
    """What came of one batch, wherever it was computed: the fields of :data:`RESULTS` with the scope ``batch``.

    ``events = roi_events + outside + overflow + thinned + time_back + time_span + hot + noise``, always: nothing is
    lost without being counted.

    While a batch has exactly one region, that region's fields are the outcome's too: ``outcome.v`` is
    ``outcome.regions[0].v``, ``BatchResult(events=…, v=…)`` makes the region, and ``dataclasses.replace`` replaces
    them. Of several regions, reading such a field raises :exc:`AttributeError`.
    """

    regions: tuple  # of RegionOutcome
    _more = ()  # scopes of a result packet beside those of the core

    def __init__(self, *, regions=None, **values):
        for own in dataclasses.fields(self):
            if own.name != "regions":
                if own.name not in values and own.default is dataclasses.MISSING:
                    raise TypeError(f"{own.name} is missing")
                object.__setattr__(self, own.name, values.pop(own.name, own.default))
        if regions is None:
            regions = (RegionOutcome(**values),)
        elif values:
            (only,) = regions
            regions = (dataclasses.replace(only, **values),)
        object.__setattr__(self, "regions", tuple(regions))

    def __getattr__(self, name):
        if name in RegionOutcome.__dataclass_fields__:
            if len(self.regions) == 1:
                return getattr(self.regions[0], name)
            raise AttributeError(f"{name}: the batch has {len(self.regions)} regions; it is each region's")
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    @classmethod
    def nothing(cls, *rows):
        """Of no events; each of ``rows`` is what is known of a region nevertheless."""
        regions = [RegionOutcome(**{f.name: f.nothing for f in fields_of("region")} | row) for row in rows]
        return cls(**{f.name: f.nothing for f in fields_of("batch", *cls._more)}, regions=regions)

    @classmethod
    def decoded(cls, config, rows, traces=None):
        """Of raw values, ``{leaf: value}`` of each region in the order of their numbers; ``traces`` are theirs."""
        found = [decode(config, row, *cls._more) for row in rows]
        own = [f.name for f in fields_of("region", config=config)]
        traces = traces or [None] * len(rows)
        regions = [
            RegionOutcome(**{name: values.pop(name) for name in own}, trace=trace)
            for values, trace in zip(found, traces, strict=True)
        ]
        told = {f.name for f in fields_of(*cls._more) if f.default is False}  # by any of the packet's records
        return cls(**found[0] | {name: any(values[name] for values in found) for name in told}, regions=regions)

    def split(self):
        """A result of each region."""
        return [dataclasses.replace(self, regions=(one,)) for one in self.regions]


@dataclass(frozen=True, kw_only=True, init=False)
class WireResult(BatchResult, record("_WrapperFields", __name__, fields_of("wrapper"))):
    """What a result packet carries: a :class:`BatchResult`, and the fields of :data:`RESULTS` of the AXI top alone.

    ``batch`` is 0 of a batch without events, which never reaches the hardware. Time stamps are modulo 2^32.
    """

    _more = ("wrapper",)
