"""``python -m cmfpga.track``: follow an object through a recording.

The module can be called: ``cmfpga.track(recording, …)`` is :func:`cmfpga.tracking.track`.
"""

import contextlib
import csv
import inspect
import json
import sys
import types

from tqdm import tqdm

from . import cli, tracking
from .engines import ENGINES, check_roi
from .errors import ConfigError
from .events import BatchCutter, generate, open_recording
from .picture import Gallery
from .reference.tracker import COLUMNS, track

EXAMPLES = (
    "python -m cmfpga.track        # a synthetic scene, with its true motion",
    "python -m cmfpga.track rec.h5 --roi 100,30 --batch-events 5000 --start-event 15000 --batches 20",
    "python -m cmfpga.track events.txt --roi 60,40 --batch-us 20000 --engine model --out track",
    "python -m cmfpga.track rec.h5 --roi 100,30 --set roi_width=48 --set eta=0.5",
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
    made.add_argument("recording", nargs="?", metavar="RECORDING", help="HDF5, DAVIS text (.txt, .zip), .npz or .npy")
    made.add_argument("--roi", type=cli.pair("X,Y"), metavar="X,Y", help="left column and top row of the ROI, px")
    size = made.add_argument_group("batches (one of; default: --batch-events 5000)").add_mutually_exclusive_group()
    size.add_argument("--batch-events", type=cli.positive, metavar="N", help="events of the whole sensor")
    size.add_argument("--batch-us", type=cli.positive, metavar="D", help="duration, µs")
    size.add_argument("--batch-roi-events", type=cli.positive, metavar="M", help="events in the ROI")
    made.add_argument("--start-event", type=cli.natural, default=0, metavar="K", help="first event (default: 0)")
    made.add_argument("--batches", type=cli.positive, metavar="B", help="stop after B batches (default: at the end)")
    made.add_argument(
        "--engine",
        default="rtl",
        choices=ENGINES,
        help="rtl: the emitted Verilog, cycle by cycle; model: the same in integers (needs torch); "
        "float: the article's equations (needs torch) (default: rtl)",
    )
    made.add_argument("--sensor", type=cli.pair("W,H"), metavar="W,H", help="sensor size, px, if the file doesn't say")
    made.add_argument("--time-unit", choices=("s", "ms", "us", "ns"), help="unit of the time stamps, if ambiguous")
    made.add_argument("--out", default="cmfpga-track", metavar="DIR", help="folder for track.csv and track.png")
    made.add_argument("--no-picture", action="store_true", help="write track.csv only")
    made.add_argument("--json", action="store_true", help="print a summary as JSON")
    cli.add_config_options(made)
    return made


def main(arguments=None):
    """Run the command; returns the exit status."""
    options = _parser().parse_args(arguments)
    truth, recording = _open(options)
    with recording:
        config = cli.make_config(options, **_sensor_fields(options, recording), **(DEMO_FIELDS if truth else {}))
        roi = _roi(options, truth, config)
        events = _batch_events(options)
        _check_batch("--batch-events", events, config)
        _check_batch("--batch-roi-events", options.batch_roi_events, config)
        cutter = BatchCutter(
            recording,
            start_event=options.start_event,
            events=events,
            duration_us=options.batch_us,
            roi_events=options.batch_roi_events,
            max_events=config.max_batch_events,
        )
        folder = cli.output_folder(options.out)
        batches = _track(options, config, roi, cutter, recording, folder, truth)
    if not options.json and truth is not None:
        _print_truth(truth, batches)
    return 0


def _open(options):
    """The true motion (or None) and the recording."""
    if options.recording is not None:
        return None, open_recording(options.recording, time_unit=options.time_unit, sensor=options.sensor)
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


def _roi(options, truth, config):
    if options.roi is not None:
        check_roi(config, options.roi)  # before a simulator is compiled in vain
        return options.roi
    if truth is None:
        raise ConfigError("--roi X,Y: the ROI's left column and top row are needed with a recording")
    return truth.roi_start(config.roi_width, config.roi_height)


def _track(options, config, roi, cutter, recording, folder, truth):
    """Run all batches; writes the files, prints the summary, returns the tracked batches' essentials."""
    tracked = []
    with contextlib.closing(_engine(options, config)) as engine, (folder / "track.csv").open("w", newline="") as file:
        if engine.note:
            print(f"note: {engine.note}", file=sys.stderr)
        gallery = None if options.no_picture else _gallery(config, recording, truth)
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        steps = track(engine, cutter, roi=roi, batches=options.batches)
        bar = tqdm(steps, total=_total(options, recording, cutter), unit="batch", disable=None)
        for batch in bar:
            writer.writerow(batch.row())
            tracked.append((batch.events.t[[0, -1]] if len(batch.events) else None, batch.v_px_per_s, batch.result))
            if gallery:
                gallery.add(batch)
    if not tracked:
        raise ConfigError(
            f"{recording.name}: too few events for one batch after event {options.start_event} ({cutter.leftover} left)"
        )
    written = [folder / "track.csv"]
    if gallery:
        written.append(folder / "track.png")
        gallery.save(written[-1])
    _summarise(options, config, engine.name, tracked, cutter, written)
    return tracked


def _total(options, recording, cutter):
    """Number of batches that will come, as far as it can be known."""
    if cutter.mode != "events" or not recording.num_events:
        return options.batches
    whole = (recording.num_events - options.start_event) // cutter.size
    return min(whole, options.batches or whole)


def _engine(options, config):
    return tracking.open_engine(options.engine, config, option="--engine")


def _gallery(config, recording, truth):
    return Gallery(config, recording.name, truth.motion if truth else None)


def _summarise(options, config, engine, tracked, cutter, written):
    cycles = [result.cycles for _, _, result in tracked if result.cycles is not None]
    flagged = sum(bool(result.flags) for _, _, result in tracked)
    if options.json:
        summary = {
            "engine": engine,
            "batches": len(tracked),
            "events_left_over": cutter.leftover,
            "flagged_batches": flagged,
            "cycles": sum(cycles) if cycles else None,
            "roi_next": list(tracked[-1][2].roi_next),
            "files": [str(path) for path in written],
            "config": config.to_dict(),
        }
        print(json.dumps(summary, indent=2))
        return
    print(f"{len(tracked)} batches tracked ({engine} engine), {flagged} with flags, {cutter.leftover} events left over")
    if cycles:
        print(
            f"{sum(cycles) / len(cycles):,.0f} clock cycles a batch on average, "
            f"{sum(cycles) / len(cycles) / 210e6 * 1e3:.3f} ms at an assumed clock of 210 MHz"
        )
    for path in written:
        print(f"wrote {path}")


def _print_truth(truth, tracked):
    """The true motion beside the found one, batch by batch."""
    print("batch   true vx, vy [px/s]      found vx, vy [px/s]")
    for index, (times, speed, _) in enumerate(tracked):
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
