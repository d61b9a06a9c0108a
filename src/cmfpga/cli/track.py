"""``cmfpga track``: follow objects through a recording."""

import argparse
import contextlib
import re
import signal
import sys

from tqdm import tqdm

from .. import cli
from ..api.objects import TrackedObject
from ..config import DEFAULT_PRESET, SLIDING_PRESET
from ..config.presets import BATCH_EVENTS
from ..config.windows import needs_batches
from ..engines import AXI, ENGINES, SERIAL, check_roi, engine_name, open_engine, preload, usual_preset
from ..errors import ConfigError, RecordingError
from ..events import LiveSource, generate, is_live, open_source
from ..imaging.survey import survey_and_propose
from ..show.export import TRACK, checked_path
from ..show.gallery import picture_path
from ..tracking.fit import batch_cutter
from ..tracking.loop import follow
from ..tracking.source import binning_note, sensor_fields, unit_note, whole_sensor, with_rows
from ..waiting import waiting
from .ingest import add_ingest_options, drop_hot_pixels, ingest_fields
from .lines import Lines, Truth, print_remarks, print_summary
from .truth import accuracy_of, add_truth_options, check_times, open_truth, print_accuracy

EXAMPLES = (
    "cmfpga track        # a synthetic scene, with its true motion",
    "cmfpga track rec.h5 --roi 100,30 --batch-events 5000 --start-event 15000 --batches 20",
    "cmfpga track events.txt --roi 60,40 --batch-us 20000 --engine model --out track",
    "cmfpga track rec.h5 --roi 100,30 --set roi_width=48 --set thinning=2",
    "cmfpga track rec.h5 --preset rotation    # the camera's angular velocity, by the file's calibration",
    "cmfpga track rec.h5 --roi auto     # where something moves clearly, in batches that suit it",
    "cmfpga track rec.h5 --roi 100,30 --hot-pixels auto --background-us 5000    # drop noise first",
    "cmfpga track rec.h5 --roi star=100,30 --roi bar=20,90    # track-star.csv, track-bar.csv",
    "cmfpga track rec.h5 --roi auto --objects 3    # track-0.csv, track-1.csv, track-2.csv",
    "cmfpga track rec.h5 --roi 100,30 --every 4    # of the results, which overlap, every fourth",
    "cmfpga track rec.h5 --roi 100,30 --batches 20 --report      # then open cmfpga-track/report.html",
    "cmfpga track rec.h5 --roi auto --truth imu.txt    # and how right it is: cmfpga accuracy tells that alone",
    "cmfpga track camera: --roi 600,300    # a camera at this computer, until Ctrl-C",
)

#: The scene that is tracked without a recording (it turns a corner in the middle), and what suits it: batches in which
#: it moves by 1.5 px per half batch, and an η with which the article's ascent leaves v = 0.
DEMO_SCENE = {
    "seed": 1,
    "texture": "lines",
    "position": (70.0, 90.0),
    "velocity": ((250_000, 150.0, 100.0), (250_000, 120.0, -100.0)),
    "duration_us": 500_000,
    "noise": 0.05,
}
USUAL_PRESET = f"{SLIDING_PRESET}, or {DEFAULT_PRESET} where batches are asked for or needed"
DEMO_BATCH_EVENTS = 1640
DEMO_FIELDS = {"eta": 4.0}


def parser():
    """Parser of the arguments of ``cmfpga track``."""
    made = cli.parser("cmfpga track", "Follow an object through a recording of events.", EXAMPLES)
    add_tracking_options(made)
    text = "folder for the files (default: %(default)s)"
    made.add_argument("--out", default="cmfpga-track", metavar="DIR", help=text)
    pictures = made.add_mutually_exclusive_group()
    pictures.add_argument("--no-picture", action="store_true", help="write track.csv only")
    cli.files(pictures.add_argument(
        "--picture", type=cli.checked(picture_path), action="append", metavar="FILE",
        help="write the picture there, not to track.png: .png, .pdf, .svg; or .gif, which moves. Repeatable",
    ))  # fmt: skip
    cli.files(made.add_argument(
        "--export", type=cli.checked(lambda path: checked_path(path, TRACK)), action="append", default=[],
        metavar="FILE",
        help="write what was found for other tools, too: .mcap, .bag (ROS 1), a folder's name (ROS 2), .rrd (rerun). "
        "Repeatable",
    ))  # fmt: skip
    made.add_argument("--report", action="store_true", help="write report.html, and track.npz for cmfpga report")
    cli.add_clock_option(made)
    text = "write the waveforms of that batch: VCD, GTKWave and Surfer files"
    made.add_argument("--wave", type=cli.natural, metavar="BATCH", help=text)
    text = "print a summary as JSON; of a stream, a line per batch, and one at the end"
    made.add_argument("--json", action="store_true", help=text)
    add_truth_options(made)
    cli.add_config_options(made, None, USUAL_PRESET)
    return made


def add_tracking_options(made):
    """What is tracked, and how: of ``track`` and ``accuracy``."""
    cli.files(made.add_argument(
        "recording", nargs="?", metavar="RECORDING",
        help="a file of any known format; or a stream: - (standard input), tcp://HOST:PORT, a named pipe, or a camera: "
        "camera:, camera:SERIAL",
    ))  # fmt: skip
    made.add_argument(
        "--roi", type=_roi_option, action="append", metavar="[NAME=]X,Y",
        help="left column and top row of the ROI, px; or 'auto'. Repeatable: several objects on one accelerator with a "
        "table of regions, which share their batches, each with its own CSV",
    )  # fmt: skip
    made.add_argument("--objects", type=cli.few, metavar="K", help="with --roi auto: find K objects (default: 1)")
    cli.add_batch_options(
        made, "windows that slide; with --preset fast batches of as many events as suit the motion, or of "
        f"{BATCH_EVENTS} where the confidence is not measured, as with --preset paper",
    )  # fmt: skip
    cli.add_window_options(made)
    text = "stop after B batches, or windows (default: at the end)"
    made.add_argument("--batches", type=cli.positive, metavar="B", help=text)
    made.add_argument(
        "--engine", default="rtl", type=cli.checked(engine_name), choices=cli.Proposals((*ENGINES, AXI)),
        metavar="{" + ",".join((*ENGINES, AXI, f"{SERIAL}:PORT")) + "}",
        help="rtl: the emitted Verilog, cycle by cycle; axi: the same behind its AXI ports, as on a board; "
        "model: the same in integers (needs torch); float: the article's equations (needs torch); "
        "serial:PORT: a board at a serial port, such as /dev/ttyUSB0 (default: rtl)",
    )  # fmt: skip
    add_ingest_options(made)
    cli.add_reading_options(made)
    text = "of a stream: drop events that come too fast, do not hold the sender up"
    made.add_argument("--drop", action="store_true", help=text)


def _roi_option(text):
    """``(name or None, (x, y) or None)`` of ``[NAME=]X,Y`` or ``[NAME=]auto``."""
    name, equals, place = text.rpartition("=")
    if equals and not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,39}", name):
        needed = "a name of letters, digits, '-' and '_' is needed before the '='"
        raise argparse.ArgumentTypeError(f"{text[:60]!r}: {needed}")
    return name or None, None if place == "auto" else cli.pair("X,Y")(place)


def main(arguments=None):
    """Run the command; returns the exit status."""
    return run(parser().parse_args(arguments))


def run(options, known=None):
    """Track as the options say; with ``known``, a true motion, print no more than how right it is."""
    alone = known is not None
    if options.preset is None:
        options.preset, note = usual_preset(
            cli.config_changes(options), batches=bool(cli.batch_size(options)) or options.wave is not None,
            engine=options.engine, objects=max(len(options.roi or ()), options.objects or 1),
        )  # fmt: skip
        cli.note(note)
    with contextlib.ExitStack() as stack:
        if options.recording is not None and is_live(options.recording):
            stack.enter_context(_handled(signal.default_int_handler, signal.SIGTERM))  # as Ctrl-C
            preload(options.engine)
        truth, recording = _open(options)
        stack.enter_context(recording)
        known = known or open_truth(options)
        if known:
            check_times(known, recording, options)
        reads = cli.make_config(options).ascent_rule.fields if truth else ()
        demo = {name: value for name, value in DEMO_FIELDS.items() if name in reads}
        changes = cli.config_changes(options)
        sensor, note = sensor_fields(recording, changes, lambda: cli.make_config(options), "--sensor W,H")
        cli.note(unit_note(recording, "--time-unit"), note)
        fields = {**sensor, **demo, **ingest_fields(options, recording), **cli.window_fields(options)}
        config = drop_hot_pixels(options, recording, cli.make_config(options, **fields), fields)
        cli.note(binning_note(config, changes))
        objects = _objects(options, truth, config)
        if len(objects) > 1:
            config = with_rows(config, len(objects), changes)
        _choose(options, objects, recording, config)
        config, cutter = _prepare(options, objects, config, recording)
        beside = []
        for one in objects:
            one.config, one.cutter = config, cutter
            one.accuracy = known and accuracy_of(options, known, config, recording)
            if truth and not options.json:
                beside.append(Truth(truth.motion))
                one.consumers.append(beside[-1])
            if isinstance(recording, LiveSource):
                one.consumers.append(Lines(options.json, one.name))
        with cli.locked(options.out) as folder:
            name, cycles, broken = _track(options, objects, recording, folder, truth.motion if truth else None)
        counts = None
        if isinstance(recording, LiveSource):
            counts = recording.counts()
            gone = counts["lost"] + counts["out_of_sensor"] + cutter.position
            counts["not_tracked"] = max(0, counts["received"] - gone)
        if alone:
            print_remarks(objects)
            files = [path for one in objects for path in one.files]
            print_accuracy({one.name: one.accuracy for one in objects}, files, options.json)
        else:
            print_summary(objects, engine=name, cycles=cycles, clock=options.clock, as_json=options.json, counts=counts)
        if broken:
            raise broken
    for lines in beside:
        print("\n".join(lines.shown(config)))
    return 0


@contextlib.contextmanager
def _handled(handler, *signals):
    """Meanwhile ``handler`` is called of these signals."""
    before = {number: signal.signal(number, handler) for number in signals}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _stopped(recording):
    """Ctrl-C or SIGTERM ends a stream after what was taken of it; a second one at once."""

    def stop(*_):
        for number in both:
            signal.signal(number, signal.default_int_handler)
        recording.stop()

    both = signal.SIGINT, signal.SIGTERM
    return _handled(stop, *both)


def _open(options):
    """The true motion (or None) and the recording."""
    if options.recording is not None:
        name = options.recording
        how = {"drop": options.drop, "quiet": lambda s: cli.note(f"{name}: nothing has come for {s} s")}
        return None, cli.noted(open_source(name, **how, **cli.reading(options)))
    cli.require_recording(options, "drop", "truth")
    scene = generate(**DEMO_SCENE)
    return scene, scene.recording("synthetic scene")


def _objects(options, truth, config):
    """The objects that ``--roi`` asks for; of several, those without a name have their number."""
    asked = [(name, roi or whole_sensor(config)) for name, roi in options.roi or ()]
    if not asked:
        start = whole_sensor(config) or (truth and truth.roi_start(*config.roi_px))
        if start is None:
            raise ConfigError("--roi X,Y: the ROI's left column and top row are needed with a recording; or --roi auto")
        asked = [(None, start)]
    if options.objects:
        if [roi for _, roi in asked].count(None) != 1:
            raise ConfigError("--objects: one --roi auto, of which it says how many are to be found, is needed")
        at = next(k for k, (_, roi) in enumerate(asked) if roi is None)
        name, more = asked[at][0], range(options.objects)
        asked[at : at + 1] = [(f"{name}-{k}" if name and len(more) > 1 else name, None) for k in more]
    objects = []
    for k, (name, roi) in enumerate(asked):
        if roi is not None:
            check_roi(config, roi, config.pixel)  # before a simulator is compiled in vain
        objects.append(TrackedObject(name=name or ("" if len(asked) == 1 else str(k)), roi=roi))
    names = [one.name for one in objects]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"--roi: the name {name!r} is given twice; each object needs a name of its own")
    return objects


def _choose(options, objects, recording, config):
    """Fill in the ROIs that ``auto`` asks for."""
    wanted = [one for one in objects if one.roi is None]
    if not wanted:
        return
    # Where the user or the other objects are; or else where something moves.
    start = options.start_event if options.start_event or len(wanted) < len(objects) else None
    proposals = survey_and_propose(recording, config, count=len(wanted), start_event=start)
    for one, found in zip(wanted, proposals, strict=True):
        one.roi, one.proposal = found.roi, found
        text = found.text if len(objects) == 1 else f"ROI {one.roi[0]},{one.roi[1]}: {found.reason}"
        cli.note(f"{one.named('track')}: {text}")
    options.start_event = proposals[0].start_event


def _prepare(options, objects, config, recording):
    """The configuration of all objects, and what cuts their batches."""
    size, first = cli.batch_size(options), None
    given = [name for name, value in (("--batch-…", size), ("--wave", options.wave is not None)) if value]
    if given:
        needs_batches(config, given[0])
    if options.every > 1 and not config.slides:
        raise ConfigError("--every: windows that slide are needed; batches do not overlap")
    if config.regions and "roi_events" in size:
        raise ConfigError("--batch-roi-events: regions share their batches; --batch-events or --batch-us is needed")
    if all(one.proposal for one in objects) and not size:
        fastest = min((one.proposal for one in objects), key=lambda proposal: proposal.batch_events)
        first, config = fastest.batch_events, fastest.suited(config, cli.config_changes(options))
        if len(objects) > 1:
            cli.note(f"{first} events in the first batch, from event {options.start_event} on")
    limit = config.max_batch_events
    for mode, option in (("events", "--batch-events"), ("roi_events", "--batch-roi-events")):
        if size.get(mode, 0) > limit:
            raise ConfigError(f"{option} {size[mode]}: at most {limit} is allowed (max_batch_events)")
    usual = BATCH_EVENTS if options.recording else DEMO_BATCH_EVENTS
    return config, batch_cutter(recording, config, start_event=options.start_event, first=first, usual=usual, **size)


def _track(options, objects, recording, folder, motion):
    """Run all batches and write the files; returns the engine's name, and clock cycles of each batch."""
    config, cutter, cycles, broken = objects[0].config, objects[0].cutter, [], None
    if options.wave is not None and config.regions:
        raise ConfigError("--wave: waveforms are those of a core of one ROI; one --roi, and no regions, are needed")
    if options.wave is not None and options.batches and options.wave >= options.batches:
        least = f"0 to {options.batches - 1} is needed with --batches {options.batches}"
        raise ConfigError(f"--wave {options.wave}: {least}")
    pictures = [] if options.no_picture else options.picture or [folder / "track.png"]
    with contextlib.ExitStack() as stack:
        with waiting("Opening the engine"):
            engine = stack.enter_context(contextlib.closing(open_engine(options.engine, config, option="--engine")))
        cli.note(engine.note)
        for one in objects:
            one.collect(
                stack, folder, recording=recording.name, motion=motion, engine=options.engine, wave=options.wave,
                pictures=pictures, exports=options.export, report_mhz=options.clock if options.report else None,
            )  # fmt: skip
        running = follow(
            engine, cutter, rois=[one.roi for one in objects], batches=options.batches,
            consumers=[(one, *one.consumers) for one in objects], every=options.every,
        )  # fmt: skip
        live = isinstance(recording, LiveSource)
        count = cli.expected(recording, cutter, options.start_event, options.batches)
        try:
            with _stopped(recording) if live else contextlib.nullcontext():
                for window in tqdm(running, total=count, unit=config.noun, disable=live or None):
                    if window and engine.cycles is not None:
                        cycles.append(engine.cycles)
        except KeyboardInterrupt:
            if not live:
                raise
            recording.stop()
        except RecordingError as error:
            if not live or not objects[0].batches:
                raise
            broken = error  # what came before is worth knowing
    if live:
        recording.close()  # what comes while files are written is not counted
        if recording.stopped:
            cli.note("interrupted; this is the end of the stream")
    _check(objects)
    with waiting("Writing the files"):
        for one in objects:
            one.finish()
    return engine.name, cycles, broken


def _check(objects):
    """Raise where there is nothing to tell of any object; of some of several, warn."""
    problems = {}
    for one in objects:
        try:
            one.check()
        except ConfigError as error:
            problems[one.name] = error
    if len(problems) == len(objects):
        raise problems[objects[0].name]
    for name, error in problems.items():
        print(f"warning: {name}: {error}", file=sys.stderr)
