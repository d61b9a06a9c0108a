"""Registers that follow from the tables of settings and results, and the counters."""

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
    "NOISE": (with_background, "events", "dropped: no other pixel of the cell had an event shortly before, of all "
              "results"),
}  # fmt: skip


def counters(config):
    """Registers of :data:`COUNTERS`, and of those of :data:`MORE_COUNTERS` that the hardware has."""
    docs = _OF_REGIONS if config.regions else _OF_WINDOWS if config.slides else {}
    if filtered := [name.upper() for name in counts_of(config) if name.upper() in MORE_COUNTERS]:
        usual = docs.get("EVENTS_TAKEN", COUNTERS["EVENTS_TAKEN"][1])
        docs = {**docs, "EVENTS_TAKEN": " + ".join([usual, *filtered])}
    more = {name: (unit, doc) for name, (_, unit, doc) in MORE_COUNTERS.items()}
    absent = {f"COUNT_{name}" for name, (when, *_) in MORE_COUNTERS.items() if not when(config)}
    made = in_order("Counters", [
        (f"COUNT_{name}", doc := docs.get(name, usual), [status("VALUE", 0, 32, doc, unit=unit, link=name.lower())])
        for name, (unit, usual) in (COUNTERS | more).items()
    ])  # fmt: skip
    return [register for register in made if register.name not in absent]


def settings(config):
    """Registers of the settings that a configuration has a use for."""
    return _registers(config, SETTINGS, "Settings", "stored")


def tables(config):
    """Registers through which the tables of a configuration are written."""
    rows = tables_of(config).values()
    return [register for row in rows for register in _registers(config, row, "Tables", "written")]


def results(config):
    """One batch's result, as the registers show it and as the packet carries it: word k is register k."""
    return _registers(config, RESULTS, "Result", "status", prefix="RESULT_")


def _registers(config, declared, group, access, prefix=""):
    words = {}
    for one in declared:
        if not (one.when(config) and one.shown(config)):
            continue
        formats = leaves(one.name, one.shape_of(config))
        doc, unit = one.doc_of(config)
        for place in one.places:
            leaf = one.name + place.part
            # Nor is there a register for a flag that this hardware never sets.
            if leaf not in formats or (place.part_lsb >= formats[leaf].width and place.field != "VALUE"):
                continue
            low, high = one.limits(config, leaf, place.part[1:])
            field = Field(
                name=place.field, lsb=place.lsb, width=place.width, access=place.access or access,
                doc=place.doc or doc, unit=unit if place.unit is None else place.unit, low=low, high=high,
                reset=one.reset_of(config, formats[leaf], high), link=leaf, link_lsb=place.part_lsb,
                signed=formats[leaf].signed if place.signed is None else place.signed,
            )  # fmt: skip
            own = field.doc if place.field == "VALUE" else doc
            first = place.register or f"{prefix}{one.name.upper()}", place.register_doc or own, []
            words.setdefault(place.word, first)[2].append(field)
    return [
        Register(name=name, offset=BASE[group] + 4 * word, group=group, doc=doc,
                 fields=tuple(sorted(parts, key=lambda f: f.lsb)))
        for word, (name, doc, parts) in sorted(words.items())
    ]  # fmt: skip
