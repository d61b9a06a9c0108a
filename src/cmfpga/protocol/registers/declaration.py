"""The registers of the AXI top, declared once: hardware, documents and driver are made from :func:`register_map`.

The first 16 bytes are those of an AMD HLS block (``ap_ctrl_hs``; UG1399), with two differences that are said at the
fields: ``DONE`` and the bits of ``ISR`` are cleared by writing 1, and reading never changes anything.
Offsets are the same for every configuration; what a configuration has no use for is left out.

Imports neither Amaranth nor NumPy.
"""

from ... import __version__
from ...errors import ConfigError
from ..flags import Flag
from .layout import Field, Register, RegisterMap

#: Byte addresses of the AXI4-Lite port: 64 KiB, of which the map takes the first 4.
ADDRESS_BITS = 16

ID = 0x434D4158  # "CMAX"

#: Changes when a register moves or changes its meaning.
MAP_VERSION = 1

#: Values of ``INPUT.FORMAT``.
FORMATS = {"EVT21": 0, "EVT20": 1, "PACKED": 2}

#: 64-bit words of a result packet.
PACKET_BEATS = 14

#: The wrapper's own bits of a result's ``FLAGS``, above those of :class:`cmfpga.protocol.batch.Flag`.
WRAPPER_FLAGS = {"WIRE": 16, "CONFIG_RANGE": 17}

INTERRUPTS = {
    "DONE": "a result came",
    "READY": "a batch began: START may be set again, and the settings of the next batch written",
    "OVERFLOW": "ROI events of a batch were dropped: the buffer was full",
    "WIRE": "a word or event was dropped at the input: COUNT_FORMAT_ERRORS, COUNT_BEFORE_TIME, COUNT_OUT_OF_SENSOR",
    "TIME": "a time stamp stepped back, or beyond the span: COUNT_TIME_HIGH_BACK, COUNT_TIME_BACK, COUNT_TIME_SPAN",
    "CONFIG_RANGE": "a batch began with a setting that had to be limited",
}

COUNTERS = {  # name: unit, what is counted
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
    "EVENTS_TAKEN": (
        "events",
        "given to batches; = ROI_EVENTS + OUTSIDE + OVERFLOW + THINNED + TIME_BACK + TIME_SPAN + batches under way",
    ),
    "FORMAT_ERRORS": ("words", "dropped: unknown type, or TKEEP neither all ones nor all zeros"),
    "OTHER_WORDS": ("words", "of known types that hold no event of the sensor: triggers and the like"),
    "TIME_HIGH_BACK": ("words", "time words that stepped back (a wrap is not a step back)"),
    "EMPTY_ENDS": ("ends", "TLAST or END_BATCH without an event in the batch: no result"),
    "BATCHES": ("batches", "results"),
    "DEGENERATE": ("batches", "results with the flag DEGENERATE"),
    "CUT": ("batches", "results with the flag CUT"),
    "ROI_EVENTS": ("events", "stored, of all results"),
    "OUTSIDE": ("events", "outside the ROI, of all results"),
    "OVERFLOW": ("events", "dropped: the event buffer was full"),
    "THINNED": ("events", "left out by the thinning"),
    "TIME_BACK": ("events", "dropped: time stepped back within the batch"),
    "TIME_SPAN": ("events", "dropped: later than the batch's first event by 2^span_bits µs or more"),
    "RESULTS_HELD_BACK": ("batches", "results that the registers do not show, because of RESULT_HOLD"),
    "LONGEST_BATCH": ("cycles", "the longest batch, from its first event to its result"),
}

BASE = {
    "Control": 0x000, "Discovery": 0x010, "Operation": 0x040, "Settings": 0x080, "Result": 0x100, "Counters": 0x180,
    "Schedule": 0x400, "Scratch": 0xFFC,
}  # fmt: skip


def check(config):
    """Raise :exc:`ConfigError` unless the AXI top can be made with this configuration."""
    for name, limit, why in (
        ("time_bits", 32, "time stamps in the words and registers have 32 bits"),
        ("max_batch_events", (1 << 31) - 1, "counters have 32 bits"),
    ):
        if getattr(config, name) > limit:
            raise ConfigError(f"{name} = {getattr(config, name)}: at most {limit} is allowed for the AXI top ({why})")


def register_map(config):
    """The registers for a configuration: a :class:`~cmfpga.protocol.registers.layout.RegisterMap`.

    Only the hardware fields of ``config`` matter. Raises :exc:`ConfigError` where :func:`check` does.
    """
    check(config)
    return RegisterMap(
        (
            *_control(),
            *_in_order("Discovery", _discovery(config)),
            *_in_order("Operation", _operation()),
            *_settings(config),
            *_in_order("Result", _result(config)),
            *_in_order("Counters", _counters()),
            *_schedule(config),
            *_in_order(
                "Scratch", [("SCRATCH", "for bring-up; nothing else uses it", [_stored("VALUE", 0, 32, "any")])]
            ),
        )
    )


# ---------------------------------------------------------------- helpers


def _in_order(group, declared):
    """Registers of ``(name, doc, fields)``, one after the other."""
    return [
        Register(name=name, offset=BASE[group] + 4 * k, group=group, doc=doc, fields=tuple(fields))
        for k, (name, doc, fields) in enumerate(declared)
    ]


def _make(access):
    def make(name, lsb, width, doc, **more):
        return Field(name=name, lsb=lsb, width=width, access=access, doc=doc, **more)

    return make


_constant, _status, _stored, _flag, _sticky, _command = map(
    _make, ("constant", "status", "stored", "flag", "sticky", "command")
)


def _constants(*fields):
    """Fields of ``(name, width, value, doc)`` beside each other."""
    lsb, made = 0, []
    for name, width, value, doc in fields:
        made.append(_constant(name, lsb, width, doc, reset=value))
        lsb += width
    return made


# ---------------------------------------------------------------- groups


def _control():
    control = [
        _flag("START", 0, 1, "1: begin a batch with the next event; cleared when it begins, unless AUTO_RESTART"),
        _sticky("DONE", 1, 1, "a result came", link="done"),
        _status("IDLE", 2, 1, "no batch is under way, and none is asked for", link="idle"),
        _status("READY", 3, 1, "START is not waiting for a batch to begin", link="ready"),
        _stored("AUTO_RESTART", 7, 1, "with START: one batch after the other, until both are written 0"),
        _command(
            "SOFT_RESET", 8, 1,
            "forget events, batches under way, the followed ROI and v, and counters; settings and a packet that has "
            "begun stay", link="soft_reset",
        ),
        _command("END_BATCH", 9, 1, "end the batch with the events that have come so far", link="end_batch"),
        _command("CLEAR_COUNTERS", 10, 1, "set all counters to 0", link="clear_counters"),
    ]  # fmt: skip
    enables = [_stored(name, k, 1, f"interrupt when {doc}") for k, (name, doc) in enumerate(INTERRUPTS.items())]
    states = [_sticky(name, k, 1, doc, link=name.lower()) for k, (name, doc) in enumerate(INTERRUPTS.items())]
    return _in_order(
        "Control",
        [
            ("CTRL", "start, stop, reset; the first byte as in HLS", control),
            ("GIE", "global interrupt enable", [_stored("ENABLE", 0, 1, "0: irq stays low")]),
            ("IER", "interrupt enables", enables),
            ("ISR", "interrupt states, set whether enabled or not; irq is high while an enabled one is", states),
        ],
    )


def _discovery(config):
    major, minor, patch = (int(part) for part in __version__.split(".")[:3])
    formats = [(name, 1, 1, f"INPUT.FORMAT {name}") for name in FORMATS]
    return [
        ("ID", "what this is", _constants(("MAGIC", 32, ID, "the letters CMAX"))),
        (
            "VERSION",
            "version of the Python package that made it",
            _constants(("PATCH", 16, patch, "patch"), ("MINOR", 8, minor, "minor"), ("MAJOR", 8, major, "major")),
        ),
        (
            "BUILD",
            "which hardware configuration",
            _constants(("HASH", 32, int(config.hardware_hash[:8], 16), "first 8 digits of the configuration hash")),
        ),
        (
            "CAPS",
            "capabilities",
            _constants(
                ("LANES", 4, 1, "events a cycle"),
                ("ONE_PASS", 1, config.gradient == "one_pass", "gradient: 0 sweep, 1 one_pass"),
                ("SIGN", 1, config.ascent == "sign", "ascent: 0 constant, 1 sign"),
                ("BUFFERS", 2, config.buffers, "event buffers"),
                *formats,
                ("BYPASS", 1, 1, "INPUT.BYPASS"),
                ("RESERVED", 12, 0, "0"),
                ("MAP", 8, MAP_VERSION, "version of this register map"),
            ),
        ),
        (
            "SENSOR",
            "sensor size",
            _constants(("WIDTH", 16, config.sensor_width, "columns"), ("HEIGHT", 16, config.sensor_height, "rows")),
        ),
        (
            "ROI_SIZE",
            "size of the region of interest",
            _constants(("WIDTH", 16, config.roi_width, "columns"), ("HEIGHT", 16, config.roi_height, "rows")),
        ),
        ("BUFFER", "event buffer", _constants(("EVENTS", 32, config.buffer_events, "ROI events of a batch"))),
        ("BATCH_LIMIT", "batches", _constants(("EVENTS", 32, config.max_batch_events, "events of a batch"))),
        (
            "FORMATS",
            "fixed-point formats",
            _constants(
                ("V_FRAC", 8, config.v_frac, "fraction bits of V_X, V_Y, V_START_X, V_START_Y"),
                ("V_INT", 8, config.v_int, "integer bits of them"),
                ("ETA_FRAC", 8, config.eta_frac, "fraction bits of ETA"),
                ("ROI_GAIN_FRAC", 8, config.roi_gain_frac, "fraction bits of ROI_GAIN"),
            ),
        ),
        (
            "SUM_FORMATS",
            "formats of the sums, and of times",
            _constants(
                ("WEIGHT_FRAC", 8, config.weight_frac, "fraction bits of a vote"),
                ("DERIVATIVE_FRAC", 8, config.derivative_frac, "fraction bits of a vote's derivative"),
                ("TIME_BITS", 8, config.time_bits, "bits of time stamps, which wrap"),
                ("SPAN_BITS", 8, config.span_bits, "bits of times within a batch"),
            ),
        ),
        (
            "LIMITS",
            "limits of the ascent",
            _constants(
                ("ITERATIONS", 16, config.max_iterations, "largest number of iterations"),
                ("SCHEDULE_ENTRIES", 12, config.schedule_entries if config.ascent == "sign" else 0, "of the table"),
                ("MAX_LEVEL", 4, config.max_level if config.ascent == "sign" else 0, "coarsest level"),
            ),
        ),
        ("RESULT_SIZE", "results", _constants(("BEATS", 32, PACKET_BEATS, "64-bit words of a result packet"))),
    ]


def _operation():
    status = [
        ("TAKING_IN", "events of a batch are being taken in"),
        ("COMPUTING", "a batch was begun whose result has not come yet"),
        ("RESULT_WAITING", "a result packet has not been sent completely"),
        ("EVENTS_WAITING", "words or events wait inside for a batch to begin, or for the one under way"),
        ("TIME_KNOWN", "a time word came since the last reset or change of INPUT"),
        ("CONFIG_RANGE", "a setting was written that is out of range, and will be limited"),
        ("INPUT_PENDING", "a change of INPUT waits for the words of the one before"),
        ("SCHEDULE_PENDING", "a change of the table of schedules waits for the batches under way"),
        ("BYPASSING", "words go from s_axis to m_axis"),
    ]
    when = "takes effect when all words that came before have left: see STATUS.INPUT_PENDING"
    return [
        ("STATUS", "state", [_status(name, k, 1, doc, link=name.lower()) for k, (name, doc) in enumerate(status)]),
        (
            "INPUT",
            f"what comes on s_axis; {when}",
            [
                _stored("FORMAT", 0, 2, "words; 3 is as 2", values=FORMATS, link="format"),
                _stored("SWAP", 4, 1, "exchange the 32-bit halves of each word (EVT 2.1 of an IMX636)", link="swap"),
                _stored("BYPASS", 8, 1, "pass the words of s_axis to m_axis, unchanged; no batches", link="bypass"),
            ],
        ),
        (
            "OUTPUT",
            "what goes out on m_axis",
            [_stored("STREAM_RESULTS", 0, 1, "0: results in registers only, m_axis stays quiet", reset=1,
                     link="stream_results")],
        ),
        (
            "RESULT_HOLD",
            "keep the result registers while they are read",
            [_stored("HOLD", 0, 1, "1: they do not change; results that come are counted by COUNT_RESULTS_HELD_BACK",
                     link="hold")],
        ),
        (
            "SETTINGS_LOCK",
            "write several settings as one",
            [_stored("LOCK", 0, 1, "1: batches that begin use the settings as they were; 0: those written since",
                     link="lock")],
        ),
    ]  # fmt: skip


def _settings(config):
    """All of :class:`cmfpga.protocol.batch.BatchSettings`, and where batches end."""

    def number(name, offset, doc, link, *, high, low=0, reset=0, unit="", width=32):
        signed = low < 0
        f = _stored(
            "VALUE", 0, width, doc, unit=unit, reset=reset, signed=signed, low=low, high=high, link=link
        )  # fmt: skip
        return Register(name=name, offset=BASE["Settings"] + offset, group="Settings", doc=doc, fields=(f,))

    def several(name, offset, doc, *fields):
        return Register(name=name, offset=BASE["Settings"] + offset, group="Settings", doc=doc, fields=fields)

    v, eta, gain = config.formats.v, config.formats.eta, config.formats.roi_gain
    found = [
        number("BATCH_EVENTS", 0x00, "end a batch after so many events; 0: not by their number", "batch_events",
               high=config.max_batch_events, unit="events"),
        number("BATCH_ROI_EVENTS", 0x04, "end a batch after so many stored ROI events; 0: not by their number",
               "batch_roi_events", high=config.buffer_events, unit="events"),
        number("BATCH_DURATION", 0x08, "end a batch before the event that is so much later than its first; 0: not by "
               "time", "duration", high=(1 << config.span_bits) - 1, unit="µs"),
        several("BATCH_TLAST", 0x0C, "batches and TLAST",
                _stored("ENABLE", 0, 1, "end a batch with TLAST", reset=1, link="by_tlast")),
        several("ROI", 0x10, "position of the ROI, for ROI_LOAD; limited to the sensor, with the flag ROI_CLAMPED",
                _stored("X", 0, 16, "left column", unit="px", link="roi_x"),
                _stored("Y", 16, 16, "top row", unit="px", link="roi_y")),
        several("ROI_LOAD", 0x14, "where the next batch is cropped",
                _flag("LOAD", 0, 1, "1: at ROI, instead of where the last one moved it; cleared when used",
                      link="roi_load")),
        number("ROI_GAIN", 0x18, "displacement of the ROI per v, raw", "roi_gain", high=gain.max,
               reset=min(2 << gain.f, gain.max)),
        several("START_MODE", 0x1C, "start velocity of a batch",
                _stored("LAST", 0, 1, "1: the last batch's v; 0: V_START_X, V_START_Y", reset=1, link="start_last")),
        number("V_START_X", 0x20, "start velocity along x, raw", "v_start_x", low=v.min, high=v.max),
        number("V_START_Y", 0x24, "start velocity along y, raw", "v_start_y", low=v.min, high=v.max),
        number("MIN_ROI_EVENTS", 0x28, "fewer ROI events make a batch degenerate", "min_roi_events",
               high=config.buffer_events, reset=1, unit="events"),
        number("THINNING", 0x2C, "store one ROI event in so many", "thinning", low=1, high=255, reset=1),
        number("THIN_TARGET", 0x30, "choose the thinning so that about so many are stored; 0: off", "thin_target",
               high=config.buffer_events, unit="events"),
    ]  # fmt: skip
    if config.ascent == "constant":
        found += [
            number("ITERATIONS", 0x34, "iterations of a batch (T)", "iterations", high=config.max_iterations,
                   reset=min(100, config.max_iterations)),
            number("ETA", 0x38, "step of the gradient ascent, raw", "eta", high=eta.max,
                   reset=min(1 << eta.f, eta.max)),
        ]  # fmt: skip
    else:
        last = config.schedule_entries - 1
        found += [
            several(plan.upper(), 0x3C + 4 * k, f"schedule of a batch {doc} a last v: entries of SCHEDULE",
                    _stored("FIRST", 0, 16, "first entry", high=last, link=f"{plan}_first"),
                    _stored("COUNT", 16, 16, "number of entries; 0: a degenerate batch", high=last + 1,
                            link=f"{plan}_count"))
            for k, (plan, doc) in enumerate((("cold", "without"), ("warm", "with")))
        ]  # fmt: skip
    return found


def _result(config):
    """One batch's result, as the registers show it and as the packet carries it: word k is register k."""

    def value(name, link, doc, *, unit="", signed=False):
        return (name, doc, [_status("VALUE", 0, 32, doc, unit=unit, signed=signed, link=link)])

    def corner(name, link, doc):
        fields = [
            _status(axis.upper(), 16 * k, 16, f"{what} of it", unit="px", link=f"{link}_{axis}")
            for k, (axis, what) in enumerate((("x", "left column"), ("y", "top row")))
        ]
        return (name, doc, fields)

    def long(name, link, doc, *, signed=True):
        return [
            (f"{name}_{part}", f"{doc}, {half} 32 bits",
             [_status("VALUE", 0, 32, doc, signed=signed and part == "HIGH", link=link, link_lsb=lsb)])
            for part, half, lsb in (("LOW", "low", 0), ("HIGH", "high", 32))
        ]  # fmt: skip

    flags = [
        _status(flag.name, flag.bit_length() - 1, 1, f"as the flag of that name: {flag.text}", link="flags",
                link_lsb=flag.bit_length() - 1)
        for flag in Flag
    ]  # fmt: skip
    flags += [
        _status("WIRE", WRAPPER_FLAGS["WIRE"], 1, "words or events were dropped at the input since the last result",
                link="wire"),
        _status("CONFIG_RANGE", WRAPPER_FLAGS["CONFIG_RANGE"], 1, "a setting of this batch was out of range, and "
                "limited", link="config_range"),
    ]  # fmt: skip
    return [
        value("RESULT_BATCH", "batch", "number of the batch, from 1 after a reset; 0: no result yet"),
        ("RESULT_FLAGS", "what was unusual", flags),
        value("RESULT_ITERATIONS", "iterations", "iterations done"),
        value("RESULT_CYCLES", "cycles", "from the first event's offer to the result", unit="cycles"),
        value("RESULT_V_X", "v_x", "velocity along x, raw: see FORMATS", unit="px/half batch", signed=True),
        value("RESULT_V_Y", "v_y", "velocity along y, raw", unit="px/half batch", signed=True),
        value("RESULT_T_FIRST", "t_first", "time stamp of the first event, t_1", unit="µs"),
        value("RESULT_SPAN", "span", "t_N − t_1", unit="µs"),
        value("RESULT_T_REF", "t_ref", "reference time, t_1 + (t_N − t_1)/2, rounded down", unit="µs"),
        value("RESULT_EVENTS", "events", "N; the sum of the six counts that follow", unit="events"),
        value("RESULT_ROI_EVENTS", "roi_events", "n: in the ROI, and stored", unit="events"),
        value("RESULT_OUTSIDE", "outside", "outside the ROI", unit="events"),
        value("RESULT_OVERFLOW", "overflow", "in the ROI, but the event buffer was full", unit="events"),
        value("RESULT_THINNED", "thinned", "in the ROI, but left out by the thinning", unit="events"),
        value("RESULT_TIME_BACK", "time_back", "dropped: time stepped back", unit="events"),
        value("RESULT_TIME_SPAN", "time_span", "dropped: too late for the span", unit="events"),
        corner("RESULT_ROI", "roi", "ROI that this batch was cropped with"),
        corner("RESULT_ROI_NEXT", "roi_next", "ROI that the next batch is cropped with, unless it loads another"),
        *long("RESULT_SUM_I", "sums_i", "ΣI of the last iteration, raw; 0 in a degenerate batch", signed=False),
        *long("RESULT_SUM_DX", "sums_dx", "ΣDx"),
        *long("RESULT_SUM_DY", "sums_dy", "ΣDy"),
        *long("RESULT_SX", "sums_sx", "Σ I·Dx"),
        *long("RESULT_SY", "sums_sy", "Σ I·Dy"),
    ]  # fmt: skip


def _counters():
    return [
        (f"COUNT_{name}", doc, [_status("VALUE", 0, 32, doc, unit=unit, link=name.lower())])
        for name, (unit, doc) in COUNTERS.items()
    ]


def _schedule(config):
    if config.ascent != "sign":
        return []
    fields = (
        _stored("LEVEL", 0, 8, "pixels are 2^LEVEL px wide", high=config.max_level, link="level"),
        _stored("SHIFT", 8, 8, "v moves by 2^SHIFT raw units", high=config.formats.v.width - 2, link="shift"),
    )
    return [
        Register(
            name="SCHEDULE",
            offset=BASE["Schedule"],
            group="Schedule",
            doc="the table of schedules: one entry an iteration; changes take effect between batches",
            fields=fields,
            count=config.schedule_entries,
        )
    ]
