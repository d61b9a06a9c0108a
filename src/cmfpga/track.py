"""``python -m cmfpga.track``: follow objects through a recording.

The module can be called: ``cmfpga.track(recording, …)`` is :func:`cmfpga.tracking.api.track`.
"""

import argparse
import contextlib
import inspect
import json
import re
import sys
import types

from tqdm import tqdm

from . import cli
from .cli.ingest import add_ingest_options, ingest_fields
from .cli.lines import Lines, Truth
from .config.defaults import BATCH_EVENTS
from .engines import AXI, ENGINES, SERIAL, check_roi, engine_name, open_engine
from .errors import ConfigError
from .events import LiveSource, generate, open_source
from .events.live import FORMATS as STREAM_FORMATS
from .imaging.gallery import check_suffix
from .tracking import api
from .tracking.fit import FittedCutter, batch_cutter
from .tracking.loop import in_turn, track
from .tracking.objects import TrackedObject
from .tracking.source import sensor_fields, unit_note, whole_sensor

EXAMPLES = (
    "python -m cmfpga.track        # a synthetic scene, with its true motion",
    "python -m cmfpga.track rec.h5 --roi 100,30 --batch-events 5000 --start-event 15000 --batches 20",
    "python -m cmfpga.track events.txt --roi 60,40 --batch-us 20000 --engine model --out track",
    "python -m cmfpga.track rec.h5 --roi 100,30 --set roi_width=48 --set thinning=2",
    "python -m cmfpga.track rec.h5 --preset rotation    # the camera's angular velocity, by the file's calibration",
    "python -m cmfpga.track rec.h5 --roi auto     # where something moves clearly, in batches that suit it",
    "python -m cmfpga.track rec.h5 --roi 100,30 --hot-pixels auto --background-us 5000    # drop noise first",
    "python -m cmfpga.track rec.h5 --roi star=100,30 --roi bar=20,90    # track-star.csv, track-bar.csv",
    "python -m cmfpga.track rec.h5 --roi 100,30 --batches 20 --report      # then open cmfpga-track/report.html",
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
DEMO_BATCH_EVENTS = 1640
DEMO_FIELDS = {"eta": 4.0}


def _parser():
    made = cli.parser("track", "Follow an object through a recording of events.", EXAMPLES)
    cli.files(made.add_argument(
        "recording", nargs="?", metavar="RECORDING",
        help="a file of any known format; or a stream: - (standard input), tcp://HOST:PORT, or a named pipe",
    ))  # fmt: skip
    made.add_argument(
        "--roi", type=_roi_option, action="append", metavar="[NAME=]X,Y",
        help="left column and top row of the ROI, px; or 'auto'. Repeatable: several objects, each with its own core "
        "and CSV",
    )  # fmt: skip
    cli.add_batch_options(
        made, f"as many events as suit the motion, chosen anew for each batch; --batch-events {BATCH_EVENTS} without "
        "confidence, as with --preset paper",
    )  # fmt: skip
    made.add_argument("--batches", type=cli.positive, metavar="B", help="stop after B batches (default: at the end)")
    made.add_argument(
        "--engine",
        default="rtl",
        type=cli.checked(engine_name),
        choices=cli.Proposals((*ENGINES, AXI)),
        metavar="{" + ",".join((*ENGINES, AXI, f"{SERIAL}:PORT")) + "}",
        help="rtl: the emitted Verilog, cycle by cycle; axi: the same behind its AXI ports, as on a board; "
        "model: the same in integers (needs torch); float: the article's equations (needs torch); "
        "serial:PORT: a board at a serial port, such as /dev/ttyUSB0 (default: rtl)",
    )
    add_ingest_options(made)
    cli.add_recording_options(made)
    cli.add_layout_options(made)
    made.add_argument("--format", choices=STREAM_FORMATS, help="of a stream without a header")
    made.add_argument(
        "--drop", action="store_true", help="of a stream: drop events that come too fast, do not hold the sender up"
    )
    made.add_argument(
        "--out", default="cmfpga-track", metavar="DIR", help="folder for the files (default: %(default)s)"
    )
    pictures = made.add_mutually_exclusive_group()
    pictures.add_argument("--no-picture", action="store_true", help="write track.csv only")
    cli.files(pictures.add_argument(
        "--picture", type=_picture, action="append", metavar="FILE",
        help="write the picture there, not to track.png: .png, .pdf, .svg; or .gif, which moves. Repeatable",
    ))  # fmt: skip
    made.add_argument(
        "--report", action="store_true", help="write report.html, and track.npz for python -m cmfpga.report"
    )
    cli.add_clock_option(made)
    made.add_argument(
        "--wave",
        type=cli.natural,
        metavar="BATCH",
        help="write the waveforms of that batch: VCD, GTKWave and Surfer files",
    )
    made.add_argument(
        "--json", action="store_true", help="print a summary as JSON; of a stream, a line per batch, and one at the end"
    )
    cli.add_config_options(made)
    return made


def _picture(text):
    try:
        path = check_suffix(text)
    except ConfigError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    if not path.parent.is_dir():  # before the work
        raise argparse.ArgumentTypeError(f"{text!r}: no such folder")
    return path


def _roi_option(text):
    """``(name or None, (x, y) or None)`` of ``[NAME=]X,Y`` or ``[NAME=]auto``."""
    name, equals, place = text.rpartition("=")
    if equals and not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,39}", name):
        raise argparse.ArgumentTypeError(
            f"{text[:60]!r}: a name of letters, digits, '-' and '_' is needed before the '='"
        )
    return name or None, None if place == "auto" else cli.pair("X,Y")(place)


def main(arguments=None):
    """Run the command; returns the exit status."""
    options = _parser().parse_args(arguments)
    truth, recording = _open(options)
    with recording:
        reads = cli.make_config(options).ascent_rule.fields if truth else ()
        demo = {name: value for name, value in DEMO_FIELDS.items() if name in reads}
        fields = {**_sensor_fields(options, recording), **demo, **ingest_fields(options, recording)}
        config = cli.make_config(options, **fields)
        objects = _objects(options, truth, config, recording)
        _choose(options, objects, recording, config)
        found = []
        for one in objects:
            _prepare(options, one, config, recording)
            if truth and not options.json:
                found.append(Truth(truth.motion))
                one.consumers.append(found[-1])
            if isinstance(recording, LiveSource):
                one.consumers.append(Lines(options.json))
        with cli.locked(options.out) as folder:
            name = _track(options, objects, recording, folder, truth.motion if truth else None)
        _summarise(options, config, name, objects, recording.counts() if isinstance(recording, LiveSource) else None)
    for lines in found:
        print("\n".join(lines))
    return 0


def _open(options):
    """The true motion (or None) and the recording."""
    if options.recording is not None:
        told = {"form": options.format, "drop": options.drop, **cli.reading(options)}
        return None, cli.noted(open_source(options.recording, **told))
    for name in ("sensor", "time_unit", "columns", "dataset", "format", "drop"):
        if getattr(options, name):
            raise ConfigError(f"--{name.replace('_', '-')}: a RECORDING is needed; the synthetic scene has its own")
    scene = generate(**DEMO_SCENE)
    return scene, scene.recording("synthetic scene")


def _sensor_fields(options, recording):
    """The recording's sensor, unless ``--set`` says otherwise; with an ROI that fits it."""
    changes = cli.config_changes(options)
    fields, note = sensor_fields(recording, changes, lambda: cli.make_config(options), "--sensor W,H")
    for told in filter(None, (unit_note(recording, "--time-unit"), note)):
        print(f"note: {told}", file=sys.stderr)
    return fields


def _objects(options, truth, config, recording):
    """The objects that ``--roi`` asks for; of several, those without a name have their number."""
    asked = [(name, roi or whole_sensor(config)) for name, roi in options.roi or ()]
    if not asked:
        start = whole_sensor(config) or (truth and truth.roi_start(config.roi_width, config.roi_height))
        if start is None:
            raise ConfigError("--roi X,Y: the ROI's left column and top row are needed with a recording; or --roi auto")
        asked = [(None, start)]
    if len(asked) > 1 and not recording.seekable:
        raise ConfigError(f"{recording.name}: a stream comes only once; one --roi is needed")
    objects = []
    for k, (name, roi) in enumerate(asked):
        if roi is not None:
            check_roi(config, roi)  # before a simulator is compiled in vain
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
    from .survey import survey_and_propose

    # Where the user or the other objects are; or else where something moves.
    start = options.start_event if options.start_event or len(wanted) < len(objects) else None
    proposals = survey_and_propose(recording, config, count=len(wanted), start_event=start)
    for one, found in zip(wanted, proposals, strict=True):
        one.roi, one.proposal = found.roi, found
        print(f"note: {one.named('track')}: {found.text}", file=sys.stderr)
    options.start_event = proposals[0].start_event


def _prepare(options, one, config, recording):
    """An object's configuration and cutter."""
    size, one.config, first = cli.batch_size(options), config, None
    if one.proposal and not size:
        first, one.config = one.proposal.batch_events, one.proposal.suited(config, cli.config_changes(options))
    limit = one.config.max_batch_events
    for mode in ("events", "roi_events"):
        if size.get(mode, 0) > limit:
            option = f"--batch-{mode.replace('_', '-')}"
            raise ConfigError(f"{option} {size[mode]}: at most {limit} is allowed (max_batch_events)")
    usual = BATCH_EVENTS if options.recording else DEMO_BATCH_EVENTS
    one.cutter = batch_cutter(
        recording, one.config, start_event=options.start_event, first=first, usual=usual, **size
    )  # fmt: skip


def _track(options, objects, recording, folder, motion):
    """Run all batches, those of several objects in turn, and write the files; returns the engine's name."""
    if options.wave is not None and options.batches and options.wave >= options.batches:
        raise ConfigError(
            f"--wave {options.wave}: 0 to {options.batches - 1} is needed with --batches {options.batches}"
        )
    pictures = [] if options.no_picture else options.picture or [folder / "track.png"]
    with contextlib.ExitStack() as stack:
        running = []
        for one in objects:
            engine = stack.enter_context(contextlib.closing(open_engine(options.engine, one.config, option="--engine")))
            if engine.note and not running:
                print(f"note: {engine.note}", file=sys.stderr)
            one.collect(
                stack, folder, recording=recording.name, motion=motion, engine=options.engine, wave=options.wave,
                pictures=pictures, report_mhz=options.clock if options.report else None,
            )  # fmt: skip
            consumers = (one, *one.consumers)
            running.append(track(engine, one.cutter, roi=one.roi, batches=options.batches, consumers=consumers))
        total, live = None, isinstance(recording, LiveSource)
        if _shows_bar():
            totals = [_total(options, recording, one.cutter) for one in objects]
            total = None if None in totals else sum(totals)
        try:
            for _ in tqdm(in_turn(running), total=total, unit="batch", disable=live or None):
                pass
        except KeyboardInterrupt:
            if not live:
                raise
            print("note: interrupted; this is the end of the stream", file=sys.stderr)
    for one in objects:
        one.check()
    for one in objects:
        one.finish()
    return engine.name


def _shows_bar():
    return sys.stderr.isatty()  # as tqdm decides


def _total(options, recording, cutter):
    """Number of batches that will come, as far as it can be known soon."""
    if cutter.mode == "roi_events" or isinstance(cutter, FittedCutter) or (extent := recording.extent()) is None:
        return options.batches
    events, last = extent
    if cutter.mode == "events":
        whole = (events - options.start_event) // cutter.size
    else:
        first = next(recording.chunks(options.start_event, 1))
        whole = (last - int(first.t[0])) // cutter.size
    return min(whole, options.batches or whole)


def _summarise(options, config, engine, objects, counts):
    alone = len(objects) == 1
    cycles = [count for one in objects for count in one.cycles]
    for one in objects:
        for kind, sentence in one.remarks:
            print(f"{kind}: {one.name}{': ' if one.name else ''}{sentence}", file=sys.stderr)
    if options.json:
        entries = [one.summary() for one in objects]
        if alone:
            summary = {"engine": engine, **entries[0], "config": objects[0].config.to_dict()}
        else:
            summary = {"engine": engine, "objects": entries, "config": config.to_dict()}
        print(json.dumps(summary, indent=2) if counts is None else json.dumps({"summary": {**summary, **counts}}))
        return
    for one in objects:
        who = "" if alone and not one.name else f"{one.name}: "
        print(
            f"{who}{one.batches} batches tracked ({engine} engine), {one.warned} with warnings, "
            f"{one.cutter.leftover} events left over"
        )
        for sentence in (
            one.image_text,
            one.dropped_text,
            one.verdict.share,
            one.verdict.velocity,
            one.verdict.motion_text,
        ):
            if sentence:
                print(f"{who}{sentence}")
    if cycles:
        mean = sum(cycles) / len(cycles)
        print(
            f"{mean:,.0f} clock cycles a batch on average, {mean / options.clock / 1e3:.3f} ms at an assumed clock of "
            f"{options.clock:g} MHz"
        )
    if counts:
        print(
            f"{counts['received']} events came, {counts['lost']} were dropped; the sender was held up for "
            f"{counts['held_up_s']:g} s"
        )
    for one in objects:
        for path in one.files:
            print(f"wrote {path}")


class _Callable(types.ModuleType):
    """Makes ``cmfpga.track(…)`` the library's function, whether or not this module was imported before."""

    def __call__(self, recording, **options):
        return api.track(recording, **options)

    __call__.__doc__ = api.track.__doc__


sys.modules[__name__].__class__ = _Callable
__signature__ = inspect.signature(api.track)

if __name__ == "__main__":
    sys.exit(cli.run(main))
