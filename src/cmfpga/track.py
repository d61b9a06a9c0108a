"""``python -m cmfpga.track``: follow objects through a recording.

The module can be called: ``cmfpga.track(recording, …)`` is :func:`cmfpga.tracking.result.track`.
"""

import argparse
import contextlib
import csv
import inspect
import json
import math
import re
import statistics
import sys
import types
from dataclasses import dataclass, field

from tqdm import tqdm

from . import cli, report
from .engines import AXI, ENGINES, check_roi
from .errors import ConfigError
from .events import BatchCutter, generate, open_recording
from .imaging.gallery import Gallery
from .tracking import result as tracking
from .tracking.kept import Kept
from .tracking.loop import COLUMNS, track

EXAMPLES = (
    "python -m cmfpga.track        # a synthetic scene, with its true motion",
    "python -m cmfpga.track rec.h5 --roi 100,30 --batch-events 5000 --start-event 15000 --batches 20",
    "python -m cmfpga.track events.txt --roi 60,40 --batch-us 20000 --engine model --out track",
    "python -m cmfpga.track rec.h5 --roi 100,30 --set roi_width=48 --set eta=0.5",
    "python -m cmfpga.track rec.h5 --roi auto     # where something moves clearly, in batches that suit it",
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
    cli.files(made.add_argument("recording", nargs="?", metavar="RECORDING", help="a file of any known format"))
    made.add_argument(
        "--roi", type=_roi_option, action="append", metavar="[NAME=]X,Y",
        help="left column and top row of the ROI, px; or 'auto'. Repeatable: several objects, each with its own core "
        "and CSV",
    )  # fmt: skip
    cli.add_batch_options(made)
    made.add_argument("--batches", type=cli.positive, metavar="B", help="stop after B batches (default: at the end)")
    made.add_argument(
        "--engine",
        default="rtl",
        choices=(*ENGINES, AXI),
        help="rtl: the emitted Verilog, cycle by cycle; axi: the same behind its AXI ports, as on a board; "
        "model: the same in integers (needs torch); float: the article's equations (needs torch) (default: rtl)",
    )
    cli.add_recording_options(made)
    made.add_argument(
        "--out", default="cmfpga-track", metavar="DIR", help="folder for the files (default: %(default)s)"
    )
    made.add_argument("--no-picture", action="store_true", help="write track.csv only")
    made.add_argument(
        "--report", action="store_true", help="write report.html, and track.npz for python -m cmfpga.report"
    )
    made.add_argument(
        "--clock",
        type=report.clock,
        default=report.CLOCK_MHZ,
        metavar="MHZ",
        help=f"clock that you assume the hardware to reach, MHz (default: {report.CLOCK_MHZ:g})",
    )
    made.add_argument(
        "--wave",
        type=cli.natural,
        metavar="BATCH",
        help="write the waveforms of that batch: VCD, GTKWave and Surfer files",
    )
    made.add_argument("--json", action="store_true", help="print a summary as JSON")
    cli.add_config_options(made)
    return made


@dataclass(kw_only=True)
class _Object:
    """One object to follow: what was asked for, what follows from it, and what was found.

    Parameters
    ----------
    name : str
        Of its files: ``track-NAME.csv``; empty: ``track.csv``.
    roi : (int, int) or None
        Left column and top row, px; None until it is chosen (``auto``).
    proposal : Proposal or None
        What was chosen.
    """

    name: str
    roi: tuple | None
    proposal: object = None
    config: object = None
    cutter: object = None
    gallery: object = None
    kept: object = None  # for the report
    waves: object = None
    batches: int = 0
    flagged: int = 0
    seen: int = 0  # ROI events of all batches
    cycles: list = field(default_factory=list)
    speeds: list = field(default_factory=list)  # |v| of each batch that measured one, px per half batch
    truth: list = field(default_factory=list)  # times and velocity of each batch, where the true one is known
    roi_next: tuple | None = None
    files: list = field(default_factory=list)

    @property
    def stem(self):
        """Of its files' names."""
        return self.file("track")

    def file(self, what):
        """``what``, or ``what-NAME``."""
        return f"{what}-{self.name}" if self.name else what

    def add(self, batch, with_truth):
        """Take a tracked batch; its arrays are not kept."""
        result = batch.result
        self.batches += 1
        self.flagged += bool(result.flags)
        self.seen += result.roi_events + result.overflow + result.thinned
        self.roi_next = result.roi_next
        if result.cycles is not None:
            self.cycles.append(result.cycles)
        if batch.v_px_per_s is not None:
            self.speeds.append(math.hypot(*result.v))
        if with_truth:
            self.truth.append((batch.events.t[[0, -1]] if len(batch.events) else None, batch.v_px_per_s))
        for collector in (self.gallery, self.kept, self.waves):
            if collector:
                collector.add(batch)


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
        config = cli.make_config(options, **_sensor_fields(options, recording), **(DEMO_FIELDS if truth else {}))
        objects = _objects(options, truth, config)
        _choose(options, objects, recording, config)
        for one in objects:
            _prepare(options, one, config, recording)
        folder = cli.output_folder(options.out)
        _track(options, config, objects, recording, folder, truth)
    if not options.json and truth is not None:
        for one in objects:
            _print_truth(truth, one.truth)
    return 0


def _open(options):
    """The true motion (or None) and the recording."""
    if options.recording is not None:
        return None, open_recording(options.recording, time_unit=options.time_unit, sensor=options.sensor)
    for name, value in (("--sensor W,H", options.sensor), ("--time-unit", options.time_unit)):
        if value is not None:
            raise ConfigError(f"{name}: a RECORDING is needed; the synthetic scene has its own")
    scene = generate(**DEMO_SCENE)
    return scene, scene.recording("synthetic scene")


def _sensor_fields(options, recording):
    """The recording's sensor, unless ``--set`` says otherwise; with an ROI that fits it."""
    if recording.width is None:
        if "sensor_width" not in cli.config_changes(options):
            print(
                f"note: {recording.name} does not say how large its sensor is: taking "
                f"{cli.make_config(options).sensor_width}×{cli.make_config(options).sensor_height} px; "
                "say it with --sensor W,H",
                file=sys.stderr,
            )
        return {}
    return {"sensor_width": recording.width, "sensor_height": recording.height}


def _batch_events(options):
    """Events of a batch, or None where another limit is given."""
    if options.batch_us or options.batch_roi_events:
        return None
    return options.batch_events or (tracking.BATCH_EVENTS if options.recording else DEMO_BATCH_EVENTS)


def _check_batch(option, size, config):
    if size is not None and size > config.max_batch_events:
        raise ConfigError(f"{option} {size}: at most {config.max_batch_events} is allowed (max_batch_events)")


def _objects(options, truth, config):
    """The objects that ``--roi`` asks for; of several, those without a name have their number."""
    asked = options.roi
    if not asked:
        if truth is None:
            raise ConfigError("--roi X,Y: the ROI's left column and top row are needed with a recording; or --roi auto")
        asked = [(None, truth.roi_start(config.roi_width, config.roi_height))]
    objects = []
    for k, (name, roi) in enumerate(asked):
        if roi is not None:
            check_roi(config, roi)  # before a simulator is compiled in vain
        objects.append(_Object(name=name or ("" if len(asked) == 1 else str(k)), roi=roi))
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
    from .survey import Survey, propose, require, survey_all

    # Where the user or the other objects are; or else where something moves.
    start = options.start_event if options.start_event or len(wanted) < len(objects) else None
    survey = Survey(recording.width, recording.height)
    survey_all(recording, survey)
    proposals = propose(recording, survey, config, count=len(wanted), start_event=start)
    for one, found in zip(wanted, require(proposals, len(wanted), recording), strict=True):
        one.roi, one.proposal = found.roi, found
        print(f"note: {one.stem}: {found.text}", file=sys.stderr)
    options.start_event = proposals[0].start_event


def _prepare(options, one, config, recording):
    """An object's configuration and cutter."""
    events, changes = _batch_events(options), {}
    if one.proposal and not (options.batch_events or options.batch_us or options.batch_roi_events):
        events = one.proposal.batch_events
        given = cli.config_changes(options)
        changes = {name: value for name, value in one.proposal.fields.items() if name not in given}
    one.config = config.replace(**changes)
    _check_batch("--batch-events", events, one.config)
    _check_batch("--batch-roi-events", options.batch_roi_events, one.config)
    one.cutter = BatchCutter(
        recording,
        start_event=options.start_event,
        events=events,
        duration_us=options.batch_us,
        roi_events=options.batch_roi_events,
        max_events=one.config.max_batch_events,
    )


def _track(options, config, objects, recording, folder, truth):
    """Run all batches, those of several objects in turn; writes the files, prints the summary."""
    with contextlib.ExitStack() as stack:
        running = []
        for one in objects:
            engine = stack.enter_context(contextlib.closing(_engine(options, one.config)))
            if engine.note and not running:
                print(f"note: {engine.note}", file=sys.stderr)
            one.gallery = None if options.no_picture else _gallery(one.config, recording, truth)
            one.kept = _kept(options, one.config, recording, truth) if options.report else None
            one.waves = _waves(options, one.config) if options.wave is not None else None
            one.files.append(folder / f"{one.stem}.csv")
            file = stack.enter_context(one.files[0].open("w", newline=""))
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            running.append((one, writer, track(engine, one.cutter, roi=one.roi, batches=options.batches)))
        total = None
        if _shows_bar():
            totals = [_total(options, recording, one.cutter) for one in objects]
            total = None if None in totals else sum(totals)
        with tqdm(total=total, unit="batch", disable=None) as bar:
            while running:
                for step in [*running]:
                    one, writer, batches = step
                    batch = next(batches, None)
                    if batch is None:
                        running.remove(step)
                        continue
                    writer.writerow(batch.row())
                    one.add(batch, truth is not None)
                    bar.update()
    for one in objects:
        if not one.batches:
            raise ConfigError(
                f"{recording.name}: too few events for one batch after event {options.start_event} "
                f"({one.cutter.leftover} left)"
            )
        if not one.seen:
            raise ConfigError(
                f"ROI at {one.roi[0]},{one.roi[1]}: none of the events is in it, in {one.batches} batches; an ROI with "
                "an object is needed"
            )
    for one in objects:
        _write_more(options, one, folder)
    _summarise(options, config, engine.name, objects)


def _write_more(options, one, folder):
    """An object's files beside the CSV."""
    if one.gallery:
        one.files.append(folder / f"{one.stem}.png")
        one.gallery.save(one.files[-1])
    if one.kept:
        one.files += [folder / f"{one.stem}.npz", folder / f"{one.file('report')}.html"]
        one.kept.save(one.files[-2])
        _write_page(one.kept, one.files[-1], options)
    if one.waves:
        one.files += _write_waves(one.waves, folder, one.file(f"batch-{one.waves.wanted}"))


def _shows_bar():
    return sys.stderr.isatty()  # as tqdm decides


def _total(options, recording, cutter):
    """Number of batches that will come, as far as it can be known soon."""
    if cutter.mode == "roi_events" or (extent := recording.extent()) is None:
        return options.batches
    events, last = extent
    if cutter.mode == "events":
        whole = (events - options.start_event) // cutter.size
    else:
        first = next(recording.chunks(options.start_event, 1))
        whole = (last - int(first.t[0])) // cutter.size
    return min(whole, options.batches or whole)


def _engine(options, config):
    return tracking.open_engine(options.engine, config, option="--engine")


def _gallery(config, recording, truth):
    return Gallery(config, recording.name, truth.motion if truth else None)


def _kept(options, config, recording, truth):
    from .report.page import plotly_script

    plotly_script()  # if it is missing, that is told before the work
    return Kept(config, options.engine, recording.name, truth.motion if truth else None)


def _write_page(kept, path, options):
    from .report.page import write_page

    write_page(kept, path, clock_mhz=options.clock)


def _waves(options, config):
    from .tracking.wave import WaveTaker

    if options.batches and options.wave >= options.batches:
        raise ConfigError(
            f"--wave {options.wave}: 0 to {options.batches - 1} is needed with --batches {options.batches}"
        )
    return WaveTaker(config, options.engine, options.wave)


def _write_waves(waves, folder, stem):
    from .tracking.wave import write_waves

    return write_waves(waves.record(), folder, stem)


def _summarise(options, config, engine, objects):
    alone = len(objects) == 1
    cycles = [count for one in objects for count in one.cycles]
    if options.json:
        entries = [_entry(one) for one in objects]
        if alone:
            summary = {"engine": engine, **entries[0], "config": objects[0].config.to_dict()}
        else:
            summary = {"engine": engine, "objects": entries, "config": config.to_dict()}
        print(json.dumps(summary, indent=2))
        return
    for one in objects:
        who = "" if alone and not one.name else f"{one.name}: "
        print(
            f"{who}{one.batches} batches tracked ({engine} engine), {one.flagged} with flags, "
            f"{one.cutter.leftover} events left over"
        )
    if cycles:
        print(
            f"{sum(cycles) / len(cycles):,.0f} clock cycles a batch on average, "
            f"{sum(cycles) / len(cycles) / options.clock / 1e3:.3f} ms "
            f"at an assumed clock of {options.clock:g} MHz"
        )
    for one in objects:
        for path in one.files:
            print(f"wrote {path}")


def _entry(one):
    """An object's part of the summary."""
    entry = {
        "batches": one.batches,
        "events_left_over": one.cutter.leftover,
        "flagged_batches": one.flagged,
        "cycles": sum(one.cycles) if one.cycles else None,
        "roi_next": list(one.roi_next),
        "files": [str(path) for path in one.files],
    }
    if one.name:
        entry = {"name": one.name, "roi": list(one.roi), **entry}
    if one.proposal:
        entry["roi"] = list(one.roi)
        entry["batch_events"] = one.cutter.size if one.cutter.mode == "events" else None
        entry["start_event"] = one.proposal.start_event
        entry["fields"] = one.proposal.fields
        entry["median_px_per_half_batch"] = statistics.median(one.speeds) if one.speeds else None
    return entry


def _print_truth(truth, tracked):
    """The true motion beside the found one, batch by batch."""
    print("batch   true vx, vy [px/s]      found vx, vy [px/s]")
    for index, (times, speed) in enumerate(tracked):
        if speed is None:
            print(f"{index:5}   (degenerate)")
            continue
        true = truth.motion.mean_velocity(int(times[0]), int(times[1]))
        print(f"{index:5}   {true[0]:8.1f} {true[1]:8.1f}       {speed[0]:8.1f} {speed[1]:8.1f}")


class _Callable(types.ModuleType):
    """Makes ``cmfpga.track(…)`` the library's function, whether or not this module was imported before."""

    def __call__(self, recording, **options):
        return tracking.track(recording, **options)

    __call__.__doc__ = tracking.track.__doc__


sys.modules[__name__].__class__ = _Callable
__signature__ = inspect.signature(tracking.track)

if __name__ == "__main__":
    sys.exit(cli.run(main))
