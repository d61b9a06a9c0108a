"""The command ``cmfpga flow``."""

import contextlib
import json

import numpy as np
from tqdm import tqdm

from .. import cli
from ..api.flow import ARRAYS, CSV, ENGINE, FITS, PRESET, Flow, configure, fit_columns
from ..dense.fields import CAMERA, MODELS, check, demo_errors, scene
from ..dense.window import TABLE, Run
from ..engines import AXI, ENGINES, open_engine
from ..errors import naming, write_text
from ..events import open_recording
from ..show.export import ENDINGS, checked_path
from ..show.flow import SUFFIXES, Page, save
from ..show.gallery import picture_path
from ..tracking.columns import csv_writer
from ..waiting import waiting
from .ingest import add_ingest_options, drop_hot_pixels, ingest_fields
from .truth import accuracy_of, check_times, print_accuracy

EXAMPLES = (
    "cmfpga flow        # a synthetic scene: a camera turns, so the true flow is known",
    "cmfpga flow rec.h5 --out flow    # flow.csv, flow.npz, flow.png, flow.html",
    "cmfpga flow rec.h5 --fit rotation    # the camera's angular velocity, from the whole field",
    "cmfpga flow rec.h5 --window-us 20000 --fit affine --json",
    "cmfpga flow rec.h5 --window-us 20000 --slices 4    # a new window every 5 ms",
    "cmfpga flow rec.h5 --window-events 30000 --tile 24 --step 12 --windows 5",
    "cmfpga flow events.txt --sensor 346,260 --camera camera.yaml --set max_batch_events=65535",
)
PICTURE, PAGE = "flow.png", "flow.html"


def parser():
    """Parser of the arguments of ``cmfpga flow``."""
    made = cli.parser("cmfpga flow", "Dense optical flow of a recording, by the simulated hardware.", EXAMPLES)
    cli.files(made.add_argument("recording", nargs="?", metavar="RECORDING", help="a file of any known format"))
    cli.add_tile_options(made)
    text = "windows (one of; default: as many events as suit the motion, chosen anew for each window)"
    size = made.add_argument_group(text).add_mutually_exclusive_group()
    size.add_argument("--window-events", type=cli.positive, metavar="N", help="events of the whole sensor")
    size.add_argument("--window-us", type=cli.positive, metavar="D", help="duration, µs")
    text = "windows overlap: a new one with every S-th part of a window; with a length of windows (default: 1)"
    made.add_argument("--slices", type=cli.positive, metavar="S", help=text)
    made.add_argument("--start-event", type=cli.natural, default=0, metavar="K", help="first event (default: 0)")
    made.add_argument("--windows", type=cli.positive, metavar="W", help="stop after W windows (default: at the end)")
    text = "fit one motion to the field of each window, and write fit.csv; a rotation needs a calibration"
    made.add_argument("--fit", choices=MODELS, help=text)
    made.add_argument(
        "--engine", default=ENGINE, choices=(*ENGINES, AXI),
        help="rtl: the emitted Verilog, cycle by cycle; axi: the same behind its AXI ports, as a board has it; "
        "model: the same in integers (needs torch); float: the article's equations (needs torch) "
        f"(default: {ENGINE})",
    )  # fmt: skip
    add_ingest_options(made)
    cli.add_reading_options(made)
    made.add_argument("--out", default="cmfpga-flow", metavar="DIR", help="folder for the files (default: %(default)s)")
    pictures = made.add_mutually_exclusive_group()
    pictures.add_argument("--no-picture", action="store_true", help=f"write neither {PICTURE} nor {PAGE}")
    cli.files(pictures.add_argument(
        "--picture", type=cli.checked(lambda text: picture_path(text, SUFFIXES)), metavar="FILE",
        help=f"write the picture, of the window with most trusted tiles, there, not to {PICTURE}: .png, .pdf, .svg",
    ))  # fmt: skip
    cli.files(made.add_argument(
        "--export", type=cli.checked(lambda path: checked_path(path, ENDINGS)), action="append", default=[],
        metavar="FILE", help="write the flow as data sets have it, too: .npz (MVSEC), a folder (DSEC). Repeatable",
    ))  # fmt: skip
    made.add_argument("--every-picture", action="store_true", help="write flow-0.png, flow-1.png …, of each window")
    cli.add_clock_option(made)
    made.add_argument("--json", action="store_true", help="print a summary as JSON")
    cli.add_config_options(made, PRESET)
    return made


def main(arguments=None):
    """Run the command; returns the exit status."""
    return run(parser().parse_args(arguments))


def run(options, known=None):
    """Measure as the options say; with ``known``, a true motion, print no more than how right it is."""
    if options.recording is None:
        cli.require_recording(options, "camera")
        opened = scene().recording("synthetic scene")
    else:
        opened = cli.noted(open_recording(options.recording, **cli.reading(options)))
    with opened as recording:
        if known:
            check_times(known, recording, options)
        fields = {**ingest_fields(options, recording), **cli.config_changes(options)}
        if options.recording is None:
            fields = {"undistortion": "on", "camera": CAMERA.text, **fields}
        if options.slices:
            fields["slices"] = options.slices
        how = {"sensor": "--sensor W,H", "time_unit": "--time-unit"}.get
        config, tiles, notes = configure(recording, options.preset, fields, options.tile, options.step, how)
        cli.note(*notes)
        config = drop_hot_pixels(options, recording, config, fields)
        if options.fit:
            check(options.fit, config)
        accuracy = known and accuracy_of(options, known, config, recording)
        with cli.locked(options.out) as folder:
            found, files, errors = _measure(options, recording, config, tiles, folder, accuracy)
    if accuracy:
        print_accuracy({"": accuracy}, files, options.json, "window")
        return 0
    _summarise(options, found, files, errors)
    return 0


def _measure(options, recording, config, tiles, folder, accuracy=None):
    """Run all windows and write the files: (Flow, list of Path, errors of the demo's tiles)."""
    files, errors, best, page = [folder / CSV], [], None, Page()
    with contextlib.ExitStack() as stack:
        with waiting("Opening the engine"):
            engine = stack.enter_context(contextlib.closing(open_engine(options.engine, config, option="--engine")))
        cli.note(engine.note)
        names = ("window_events", "window_us", "start_event", "windows")
        run = Run(recording, engine, tiles, **{name: getattr(options, name) for name in names})
        found = Flow(config, tiles, recording.name, options.engine, options.fit)

        def opened(name):
            path = folder / name
            stack.enter_context(naming(path))
            return stack.enter_context(path.open("w", newline="", encoding="utf-8"))

        write = csv_writer(opened(CSV), TABLE, config.image)
        if options.fit:
            files.append(folder / FITS)
            write_fit = csv_writer(opened(FITS), fit_columns(options.fit))
        count = cli.expected(recording, run.cutter, options.start_event, options.windows, config.slices)
        for window in tqdm(run, total=count, unit="window", disable=None):
            found.add(window)
            if accuracy:
                accuracy.add_window(window)
            for row in window.rows():
                write(row)
            fitted = found.fitted(window.index) if options.fit else None
            if fitted:
                write_fit(fitted.values())
            if not options.no_picture:
                page.add(window, fitted)
            if options.every_picture:
                files.append(folder / f"flow-{window.index}.png")
                save(window, files[-1], _title(window, found))
            if best is None or window.trusted.sum() > best.trusted.sum():
                best = window
            if options.recording is None:
                errors.append(demo_errors(window))
    found.ended(run)
    if best is None:
        raise run.cutter.too_few()
    with waiting("Writing the files"):
        files.append(folder / ARRAYS)
        found.save(files[-1])
        if accuracy:
            accuracy.finish()
            files.append(folder / "accuracy.csv")
            accuracy.save(files[-1])
        for path in options.export:
            found.export(path)
            files.append(path)
        if not options.no_picture:
            files += [options.picture or folder / PICTURE, folder / PAGE]
            save(best, files[-2], _title(best, found))
            write_text(files[-1], page.render(found))
    return found, files, errors


def _title(window, found):
    shares = f"{int(window.trusted.sum())} of {len(window.tiles)} tiles to be trusted"
    when = "no events" if window.t_ref is None else f"{window.t_ref / 1e6:.3f} s"
    return f"{found.recording}: window {window.index}, {when}, {len(window.events):,} events; {shares}"


def _summarise(options, found, files, errors):
    told = found.summary()
    if found.limited:
        most, moved = found.config.max_batch_events, told["moved_px"]
        moves = "" if moved is None else f"; the image moves by {moved:.1f} px in half of a window, in the median"
        text = f"some windows would be longer, had the hardware room for more than {most} events"
        cli.note(f"{text}: --set max_batch_events=N{moves}")
    if errors:
        every = np.concatenate(errors)
        told["error_px"] = {"median": round(float(np.median(every)), 4), "within_0.5": float((every < 0.5).mean())}
    if options.json:
        print(json.dumps({**told, "config": found.config.to_dict(), "files": [*map(str, files)]}, indent=2))
        return
    print(
        f"{told['windows']} windows of {told['tiles']} tiles ({found.engine} engine): {told['events']:,} events, "
        f"{told['leftover']:,} left over, {told['outside']:,} off the image, {told['dropped']:,} dropped"
    )
    if found.passed_over:
        print(f"{found.passed_over} slices without events, passed over")
    print(f"{told['trusted']} of {told['measured']} tiles with enough events are to be trusted")
    if told["speed_px_per_s"]:
        print("flow {:.0f} px/s in the median, 95 % below {:.0f}".format(*told["speed_px_per_s"]))
    if errors:
        print(
            f"error to the true flow: {told['error_px']['median']:.2f} px per half window in the median; "
            f"{100 * told['error_px']['within_0.5']:.0f} % of the trusted tiles within 0.5 px"
        )
    if told["cycles"]:
        took = told["cycles"] / options.clock / 1e3
        print(
            f"{told['cycles']:,.0f} clock cycles a window on average, {took:.3f} ms at an assumed clock of "
            f"{options.clock:g} MHz"
        )
    for fitted in told.get("fits", ()):
        text = ", ".join(
            f"{name} " + ("-" if fitted[name] is None else f"{fitted[name]:.4g} ± {fitted[f'{name}_sd']:.2g}")
            for name in MODELS[options.fit]
        )
        print(f"window {fitted['window']}: {text} ({fitted['tiles']} tiles)")
    cli.wrote(files)
