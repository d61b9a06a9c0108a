"""Registers that follow from the tables of settings and results, and the counters.

Imports neither Amaranth nor NumPy.
"""

from ..results import COUNTS, RESULTS, counts_of
from ..settings import SETTINGS, with_background, with_hot_pixels, with_windows
from ..shapes import leaves
from ..tables import tables_of
from .layout import BASE, Field, Register, in_order, status

_OWN = {  # name: unit, what is counted
    "CYCLES": ("cycles", "clock cycles since the counters were cleared"),
    "BUSY_CYCLES": ("cycles", "of them with a batch under way"),
    "INPUT_STALLS": ("cycles", "a word was offered on s_axis and not taken"),
    "OUTPUT_STALLS": ("cycles", "a word was offered on m_axis and not taken"),
    "RESULT_STALLS": ("cycles", "a result waited for the packet ahead of it"),
    "BEATS_IN": ("words", "64-bit words taken from s_axis"),
    "BEATS_BYPASSED": ("words", "of them passed to m_axis in bypass mode"),
    "EVENTS_IN": ("events", "decoded; = BEFORE_TIME + OUT_OF_SENSOR + EVENTS_TAKEN + those on their way"),
    "BEFORE_TIME": ("events", "dropped: no time word came before them"),
    "OUT_OF_SENSOR": ("events", "dropped: column or row outside the sensor"),
    "EVENTS_TAKEN": ("events", f"given to batches; = {' + '.join(COUNTS).upper()} + batches under way"),
    "FORMAT_ERRORS": ("words", "dropped: unknown type, or TKEEP neither all ones nor all zeros"),
    "OTHER_WORDS": ("words", "of known types that hold no event of the sensor: triggers and the like"),
    "TIME_HIGH_BACK": ("words", "time words that stepped back (a wrap is not a step back)"),
    "EMPTY_ENDS": ("ends", "TLAST or END_BATCH without an event in the batch: no result"),
    "BATCHES": ("batches", "results"),
    "DEGENERATE": ("batches", "results with the flag DEGENERATE"),
    "CUT": ("batches", "results with the flag CUT"),
    "RESULTS_HELD_BACK": ("batches", "results that the registers do not show, because of RESULT_HOLD"),
    "LONGEST_BATCH": ("cycles", "the longest batch, from its first event to its result"),
    "DOUBTFUL": ("batches", "results with the flag DOUBTFUL"),
}


def _all_counters():
    """Those of a result's fields in between, each at its word."""
    found = list(_OWN.items())
    for f in sorted((f for f in RESULTS if f.total), key=lambda f: f.total.word):
        found.insert(f.total.word, (f.name.upper(), (f.unit, f.total.doc or f.doc)))
    return dict(found)


#: ``{name: (unit, what is counted)}``, in the order of the registers.
COUNTERS = _all_counters()


#: With a table of regions: results are those of regions, and each event is outside most of them.
_OF_REGIONS = {
    "EVENTS_TAKEN": "given to batches",
    "LONGEST_BATCH": "the longest region, from its hand-over to a unit to its outcome",
    "DOUBTFUL": "regions with the flag DOUBTFUL",
    "DEGENERATE": "regions with the flag DEGENERATE",
    "CUT": "batches with the flag CUT",
    "BATCHES": "batches whose last result came",
}
#: Where windows slide: a result is a hop's. What is left out by EVERY has a counter behind the others.
_OF_WINDOWS = {
    "EVENTS_TAKEN": "given to the core; = ROI_EVENTS, OUTSIDE, THINNED, TIME_BACK + hops that did not close",
    "ROI_EVENTS": "stored: RESULT_FRESH of all results",
    "LONGEST_BATCH": "the longest hop, from its end to its result",
}

#: Behind those of :data:`COUNTERS`, each in its place: ``{name: (when, unit, what is counted)}``.
MORE_COUNTERS = {
    "RESULTS_SKIPPED": (with_windows, "results", "results that were not sent, because of EVERY"),
    "HOT": (with_hot_pixels, "events", "dropped: of pixels marked as hot, of all results"),
    "NOISE": (
        with_background,
        "events",
        "dropped: no other pixel of the cell had an event shortly before, of all results",
    ),
}


def counters(config):
    """Registers of :data:`COUNTERS`, and of those of :data:`MORE_COUNTERS` that the hardware has."""
    docs = _OF_REGIONS if config.regions else _OF_WINDOWS if config.slides else {}
    if filtered := [name.upper() for name in counts_of(config) if name.upper() in MORE_COUNTERS]:
        usual = docs.get("EVENTS_TAKEN", COUNTERS["EVENTS_TAKEN"][1])
        docs = {**docs, "EVENTS_TAKEN": " + ".join([usual, *filtered])}
    more = {name: (unit, doc) for name, (_, unit, doc) in MORE_COUNTERS.items()}
    made = in_order("Counters", [
        (f"COUNT_{name}", docs.get(name, doc),
         [status("VALUE", 0, 32, docs.get(name, doc), unit=unit, link=name.lower())])
        for name, (unit, doc) in (COUNTERS | more).items()
    ])  # fmt: skip
    here = [when(config) for when, *_ in MORE_COUNTERS.values()]
    return made[: len(COUNTERS)] + [one for one, there in zip(made[len(COUNTERS) :], here, strict=True) if there]


def _registers(group, prefix, fields):
    """Registers of ``(place, name and doc of the setting or result, field)``."""
    words = {}
    for place, name, doc, field in fields:
        own = field.doc if place.field == "VALUE" else doc
        first = (place.register or f"{prefix}{name.upper()}", place.register_doc or own, [])
        words.setdefault(place.word, first)[2].append(field)
    return [
        Register(
            name=name,
            offset=BASE[group] + 4 * word,
            group=group,
            doc=doc,
            fields=tuple(sorted(parts, key=lambda f: f.lsb)),
        )
        for word, (name, doc, parts) in sorted(words.items())
    ]


def settings(config):
    """Registers of the settings that a configuration has a use for."""
    return _declared(config, SETTINGS, "Settings", "stored")


def tables(config):
    """Registers through which the tables of a configuration are written."""
    return [
        register
        for declared in tables_of(config).values()
        for register in _declared(config, declared, "Tables", "written")
    ]


def _declared(config, declared, group, access):
    found = []
    for setting in declared:
        if not (setting.when(config) and setting.shown(config)):
            continue
        formats = leaves(setting.name, setting.shape_of(config))
        doc, unit = setting.doc_of(config)
        for place in setting.places:
            if (leaf := setting.name + place.part) not in formats:
                continue
            low, high = setting.limits(config, leaf, place.part[1:])
            field = Field(
                name=place.field, lsb=place.lsb, width=place.width, access=place.access or access,
                doc=place.doc or doc, unit=unit if place.unit is None else place.unit, low=low, high=high,
                reset=setting.reset_of(config, formats[leaf], high), signed=formats[leaf].signed, link=leaf,
            )  # fmt: skip
            found.append((place, setting.name, doc, field))
    return _registers(group, "", found)


def results(config):
    """One batch's result, as the registers show it and as the packet carries it: word k is register k."""
    found = []
    for f in RESULTS:
        if not f.when(config):
            continue
        formats = leaves(f.name, f.shape(config))
        for place in f.places:
            leaf = f.name + place.part
            if leaf not in formats:
                continue
            if place.part_lsb >= formats[leaf].width and place.field != "VALUE":  # a flag that this hardware never sets
                continue
            field = Field(
                name=place.field, lsb=place.lsb, width=place.width, access="status", doc=place.doc or f.doc,
                unit=f.unit if place.unit is None else place.unit, link=leaf, link_lsb=place.part_lsb,
                signed=formats[leaf].signed if place.signed is None else place.signed,
            )  # fmt: skip
            found.append((place, f.name, f.doc, field))
    return _registers("Result", "RESULT_", found)
