"""The registers of the AXI top, declared once: hardware, documents and driver are made from :func:`register_map`.

The first 16 bytes are those of an AMD HLS block (``ap_ctrl_hs``; UG1399), with two differences that are said at the
fields: ``DONE`` and the bits of ``ISR`` are cleared by writing 1, and reading never changes anything.
Offsets are the same for every configuration; what a configuration has no use for is left out.
"""

from ... import __version__
from ...config.motion import MOTIONS
from ...errors import ConfigError
from ..results import packet_beats
from ..settings import schedule_highest
from ..tables import tables_of
from .contract import counters, results, settings, tables
from .layout import RegisterMap, command, constants, flag, in_order, status, sticky, stored

#: Byte addresses of the AXI4-Lite port: 64 KiB, of which the map takes the first 4.
ADDRESS_BITS = 16

ID = 0x434D4158  # "CMAX"

#: Changes when a register moves or changes its meaning.
MAP_VERSION = 3

#: Values of ``INPUT.FORMAT``; the last only of hardware with ``evt3``.
FORMATS = {"EVT21": 0, "EVT20": 1, "PACKED": 2, "EVT30": 3}

INTERRUPTS = {
    "DONE": "a result came",
    "READY": "a batch began: START may be set again, and the settings of the next batch written",
    "OVERFLOW": "ROI events of a batch were dropped: the buffer was full",
    "WIRE": "a word or event was dropped at the input: COUNT_FORMAT_ERRORS, COUNT_BEFORE_TIME, COUNT_OUT_OF_SENSOR",
    "TIME": "a time stamp stepped back, or beyond the span: COUNT_TIME_HIGH_BACK, COUNT_TIME_BACK, COUNT_TIME_SPAN",
    "CONFIG_RANGE": "a batch began with a setting that had to be limited",
}


def formats_of(config):
    """Those of :data:`FORMATS` that the hardware decodes."""
    return {name: value for name, value in FORMATS.items() if config.evt3 or name != "EVT30"}


def check(config):
    """Raise :exc:`ConfigError` unless the AXI top can be made with this configuration."""
    for name, limit, why in (
        ("time_bits", 32, "time stamps in the words and registers have 32 bits"),
        ("max_batch_events", (1 << 31) - 1, "counters have 32 bits"),
    ):
        if getattr(config, name) > limit:
            raise ConfigError(f"{name} = {getattr(config, name)}: at most {limit} is allowed for the AXI top ({why})")


def register_map(config):
    """The :class:`RegisterMap` of a configuration's hardware fields; :exc:`ConfigError` as of :func:`check`."""
    check(config)
    scratch = ("SCRATCH", "for bring-up; nothing else uses it", [stored("VALUE", 0, 32, "any")])
    return RegisterMap((
        *in_order("Control", _control()), *in_order("Discovery", _discovery(config)),
        *in_order("Operation", _operation(config)), *in_order("Regions", _regions(config)), *settings(config),
        *results(config), *counters(config), *tables(config), *_schedule(config), *in_order("Scratch", [scratch]),
    ))  # fmt: skip


def _control():
    control = [
        flag("START", 0, 1, "1: begin a batch with the next event; cleared when it begins, unless AUTO_RESTART"),
        sticky("DONE", 1, 1, "a result came", link="done"),
        status("IDLE", 2, 1, "no batch is under way, and none is asked for", link="idle"),
        status("READY", 3, 1, "START is not waiting for a batch to begin", link="ready"),
        stored("AUTO_RESTART", 7, 1, "with START: one batch after the other, until both are written 0"),
        command(
            "SOFT_RESET", 8, 1,
            "forget events, batches under way, the followed ROI and v, and counters; settings and a packet that has "
            "begun stay", link="soft_reset",
        ),
        command("END_BATCH", 9, 1, "end the batch with the events that have come so far", link="end_batch"),
        command("CLEAR_COUNTERS", 10, 1, "set all counters to 0", link="clear_counters"),
    ]  # fmt: skip
    enables = [stored(name, k, 1, f"interrupt when {doc}") for k, (name, doc) in enumerate(INTERRUPTS.items())]
    states = [sticky(name, k, 1, doc, link=name.lower()) for k, (name, doc) in enumerate(INTERRUPTS.items())]
    return [
        ("CTRL", "start, stop, reset; the first byte as in HLS", control),
        ("GIE", "global interrupt enable", [stored("ENABLE", 0, 1, "0: irq stays low")]),
        ("IER", "interrupt enables", enables),
        ("ISR", "interrupt states, set whether enabled or not; irq is high while an enabled one is", states),
    ]


def _discovery(config):
    major, minor, patch = (int(part) for part in __version__.split(".")[:3])
    table = config.ascent_rule.has_table
    formats = [(name, 1, 1, f"INPUT.FORMAT {name}") for name in formats_of(config)]
    motion, more, evt3 = config.motion_model, [], formats[3:]
    if config.regions:
        more.append(("REGIONS", 1, 1, "a table of regions: REGIONS"))
    if config.slides:
        more.append(("SLIDING", 1, 1, "windows slide: a batch lasts until END_BATCH, and has a result of each hop"))
    if motion.basis:
        more.append(("MOTION", 2, [*MOTIONS].index(motion.name), "1 similarity, 2 rotation"))
        more.append(("LEVER", 4, motion.lever, "log2 of the lever arm of zoom and roll, px"))
    if config.binning:
        more.append(("BINNING", 2, config.binning, "ROI and v are in pixels 2^BINNING as wide as the sensor's"))
    return [
        ("ID", "what this is", constants(("MAGIC", 32, ID, "the letters CMAX"))),
        ("VERSION", "version of the Python package that made it", constants(
            ("PATCH", 16, patch, "patch"), ("MINOR", 8, minor, "minor"), ("MAJOR", 8, major, "major"))),
        ("BUILD", "which hardware configuration", constants(
            ("HASH", 32, int(config.hardware_hash[:8], 16), "first 8 digits of the configuration hash"))),
        ("CAPS", "capabilities", constants(
            ("LANES", 4, 1, "events a cycle"),
            ("ONE_PASS", 1, config.gradient == "one_pass", "gradient: 0 sweep, 1 one_pass"),
            ("SIGN", 1, table, "ascent: 0 constant, 1 sign"),
            ("BUFFERS", 2, config.buffers, "event buffers"),
            *formats[:3],
            ("BYPASS", 1, 1, "INPUT.BYPASS"),
            *more,
            ("RESERVED", 12 - sum(width for _, width, *_ in (*more, *evt3)), 0, "0"),
            *evt3,
            ("MAP", 8, MAP_VERSION, "version of this register map"))),
        ("SENSOR", "sensor size", constants(
            ("WIDTH", 16, config.sensor_width, "columns"), ("HEIGHT", 16, config.sensor_height, "rows"))),
        ("ROI_SIZE", "size of the region of interest", constants(
            ("WIDTH", 16, config.roi_width, "columns"), ("HEIGHT", 16, config.roi_height, "rows"))),
        ("BUFFER", "event buffer", constants(("EVENTS", 32, config.buffer_events, "ROI events of a batch"))),
        ("BATCH_LIMIT", "batches", constants(("EVENTS", 32, config.slice_events, "events of a batch"))),
        ("FORMATS", "fixed-point formats", constants(
            ("V_FRAC", 8, config.v_frac, "fraction bits of V_X, V_Y, V_START_X, V_START_Y"),
            ("V_INT", 8, config.v_int, "integer bits of them"),
            ("ETA_FRAC", 8, config.eta_frac, "fraction bits of ETA"),
            ("ROI_GAIN_FRAC", 8, config.roi_gain_frac, "fraction bits of ROI_GAIN"))),
        ("SUM_FORMATS", "formats of the sums, and of times", constants(
            ("WEIGHT_FRAC", 8, config.weight_frac, "fraction bits of a vote"),
            ("DERIVATIVE_FRAC", 8, config.derivative_frac, "fraction bits of a vote's derivative"),
            ("TIME_BITS", 8, config.time_bits, "bits of time stamps, which wrap"),
            ("SPAN_BITS", 8, config.span_bits, "bits of times within a batch"))),
        ("LIMITS", "limits of the ascent", constants(
            ("ITERATIONS", 16, config.max_iterations, "largest number of iterations"),
            ("SCHEDULE_ENTRIES", 12, config.schedule_entries if table else 0, "of the table"),
            ("MAX_LEVEL", 4, config.max_level if table else 0, "coarsest level"))),
        ("RESULT_SIZE", "results", constants(("BEATS", 32, packet_beats(config), "64-bit words of a result packet"))),
    ]  # fmt: skip


def _operation(config):
    computing = "a batch was begun whose result has not come yet"
    if config.slides:
        computing = "an event or a hop's result is on its way through the core, or END_BATCH waits"
    states = [
        ("TAKING_IN", "events of a batch are being taken in"),
        ("COMPUTING", computing),
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
        ("STATUS", "state", [status(name, k, 1, doc, link=name.lower()) for k, (name, doc) in enumerate(states)]),
        ("INPUT", f"what comes on s_axis; {when}", [
            stored("FORMAT", 0, 2, "words" if config.evt3 else "words; 3 is as 2", values=formats_of(config),
                   link="format"),
            stored("SWAP", 4, 1, "exchange the 32-bit halves of each word (EVT 2.1 of an IMX636)", link="swap"),
            stored("BYPASS", 8, 1, "pass the words of s_axis to m_axis, unchanged; no batches", link="bypass")]),
        ("OUTPUT", "what goes out on m_axis", [
            stored("STREAM_RESULTS", 0, 1, "0: results in registers only, m_axis stays quiet", reset=1,
                   link="stream_results")]),
        ("RESULT_HOLD", "keep the result registers while they are read", [
            stored("HOLD", 0, 1, "1: they do not change; results that come are counted by COUNT_RESULTS_HELD_BACK",
                   link="hold")]),
        ("SETTINGS_LOCK", "write several settings as one", [
            stored("LOCK", 0, 1, "1: batches that begin use the settings as they were; 0: those written since",
                   link="lock")]),
    ]  # fmt: skip


def _regions(config):
    """What there is beside a core, and the state of the tables."""
    made = []
    if tables_of(config):
        states = [
            status("PENDING", 0, 1, "a row waits for the batches under way; until then none begins", link="pending"),
            status("REFUSED", 16, 16, "writes refused since the counters were cleared, modulo 2^16: out of range, of "
                   "an unknown row, or while another row waits", link="refused"),
        ]  # fmt: skip
        if config.regions:
            doc = "no batch begins: ROWS says more than are known since the reset, or since fewer were in use"
            states.insert(1, status("ROWS_MISSING", 1, 1, doc, link="rows_missing"))
        made.append(("TABLES", "writes into the tables", states))
    if config.regions:
        sizes = (
            ("ROWS", 16, config.regions, "of the table of regions"),
            ("UNITS", 8, config.units, "that iterate over regions"),
            ("BIN_BITS", 8, config.bin_bits, "bins of the store are 2^BIN_BITS px wide"),
        )
        made.append(("REGIONS", "the table of regions", constants(*sizes)))
    return made


def _schedule(config):
    if not config.ascent_rule.has_table:
        return []
    docs = {
        "level": "pixels are 2^LEVEL px wide",
        "shift": "v moves by 2^SHIFT raw units",
        "stride": "one stored event in 2^STRIDE",
        "distance": "evaluated so far beside v: ¾, 1, 1½, 2 or 3 px, by its number from 0",
        "limit": "v moves by at most ((2 + c mod 2)·2^(c div 2))/2 raw units, c = LIMIT",
    }
    fields = [
        stored(name.upper(), 8 * k, 8, docs[name], high=high, link=name)
        for k, (name, high) in enumerate(schedule_highest(config).items())
    ]
    doc = "the table of schedules: one entry an iteration; changes take effect between batches"
    return in_order("Schedule", [("SCHEDULE", doc, fields)], count=config.schedule_entries)
