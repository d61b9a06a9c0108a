"""``--truth`` of the commands: what is compared with it, and what is printed of that."""

import argparse
import json

from .. import cli
from ..errors import ConfigError
from ..tracking.source import own_calibration
from ..truth import FIELD, REACH_S, WRONG_PX, Accuracy, read_known


def add_truth_options(made, usual=""):
    """``--truth``, and how it is read and compared; ``usual`` says what is taken without it."""
    group = made.add_argument_group("truth")
    cli.files(group.add_argument(
        "--truth", metavar="FILE",
        help="compare with this: a text of t vx vy (px/s), t wx wy wz (rad/s: a gyroscope), t ax ay az gx gy gz (an "
        "IMU), or t px py pz qx qy qz qw (poses), or with names and units in its first line; or a recording of cmfpga "
        "generate; or, of tiles of flow, a flow field: a folder of DSEC, .npz of MVSEC, HDF5" + usual,
    ))  # fmt: skip
    text = "unit of its times (default: what it says; else s, if one has a fraction, and µs if none has)"
    group.add_argument("--truth-unit", choices=("s", "ms", "us", "ns"), help=text)
    group.add_argument(
        "--delay", type=_delay, default="auto", metavar="S|auto",
        help="what happens at t of the recording stands at t + S of the truth, s; auto: fitted, within "
        f"±{REACH_S:g} s (default: auto)",
    )  # fmt: skip
    text = "of poses: distance of what is seen, m (default: unknown; only what is across the camera's way counts)"
    group.add_argument("--depth", type=_depth, metavar="M", help=text)


_seconds = cli.number(float, "auto, or a number of seconds, is", lambda value: abs(value) <= 1e9)


def _delay(text):
    return text if text == "auto" else _seconds(text)


def _depth(text):
    value = cli.number(float, "a number of metres is")(text)
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"{text!r}: a number of metres above 0 is needed")
    return value


def open_truth(options):
    """The :class:`~cmfpga.truth.Known` of ``--truth``, or None. Raises :exc:`RecordingError`, :exc:`ConfigError`."""
    if options.truth is not None:
        known = read_known(options.truth, options.truth_unit)
        if known.kind == FIELD and not getattr(options, "flow", False):
            raise ConfigError(
                f"{known.name}: a {FIELD}; cmfpga accuracy --flow is needed, which compares tiles with it"
            )
        return known
    if options.truth_unit or options.depth is not None:
        raise ConfigError(f"--{'truth-unit' if options.truth_unit else 'depth'}: --truth FILE is needed")
    return None


def check_times(known, recording, options):
    """Raise :exc:`RecordingError` where truth and recording have no time in common, before long work."""
    extent = recording.extent() if recording.seekable else None
    first = extent and next(iter(recording.chunks(options.start_event, 1)), None)
    if not first:
        return
    shift, slack = (0.0, REACH_S) if options.delay == "auto" else (options.delay, 0.0)
    begin, end = int(first.t[0]), extent[1]
    if known.signal.last < begin + 1e6 * (shift - slack) or known.signal.first > end + 1e6 * (shift + slack):
        raise known.apart(begin, end)


def accuracy_of(options, known, config, recording):
    """An :class:`~cmfpga.truth.Accuracy` of an object."""
    own = None if config.lens else own_calibration(getattr(recording, "path", None))
    delay = None if options.delay == "auto" else options.delay
    return Accuracy(known, config, camera=own and own.camera, delay=delay, depth=options.depth)


def print_accuracy(found, files, as_json, what="batch"):
    """Print of each object, ``{name: Accuracy}``, how right it is; and which files were written."""
    if as_json:
        entries = [{**({"name": name} if name else {}), **one.summary()} for name, one in found.items()]
        told = entries[0] if len(entries) == 1 else {"objects": entries}
        print(json.dumps({**told, "files": [*map(str, files)]}, indent=2))
        return
    for name, one in found.items():
        for line in accuracy_lines(one, what):
            print(f"{name}: {line}" if name else line)
    cli.wrote(files)


def accuracy_lines(accuracy, what="batch"):
    """What an :class:`~cmfpga.truth.Accuracy` tells, for people; ``what`` a window is."""
    summary = accuracy.summary()
    fitted = {True: "fitted", False: "given" if summary["delay_s"] else "none was fitted"}[summary["delay_fitted"]]
    many = "batches" if what == "batch" else "tiles"
    lines = [
        f"truth: {accuracy.known.text}",
        f"{summary['compared']} {many} compared, {summary['not_covered']} not within the truth's time, "
        f"{summary['degenerate']} without a motion; delay {1e3 * summary['delay_s']:.2f} ms ({fitted})",
    ]
    if summary["depth_unknown"]:
        lines.append("depth unknown: what counts is how far v is across the camera's way (ego-motion)")
    both = summary["trusted"], summary["all"]
    if summary["judged"]:
        count = both[0]["count"] if both[0] else 0
        lines.append(f"{count} of {summary['compared']} are trusted; {summary['wrong']} of these are wrong, "
                     f"by more than {WRONG_PX:g} px per half {what}")  # fmt: skip
    else:
        both = (summary["all"],)
        wrong = round(both[0]["above"][f"{WRONG_PX:g}"] * both[0]["count"])
        lines.append(f"{wrong} of them are wrong, by more than {WRONG_PX:g} px per half {what}")
    unit, px, one = summary["unit"], f"px/half {what}", summary["all"]
    rows = [
        ("AEE, average endpoint error", px, lambda n: n["aee_px"]),
        ("AEE", "px/s", lambda n: n["aee_px_per_s"]),
        ("median endpoint error", px, lambda n: n["median_px"]),
        *((f"endpoint error above {k} px", "%", lambda n, k=k: 100 * n["above"][k]) for k in one["above"]),
        *((f"RMS {k}", unit, lambda n, k=k: n["rms"][k]) for k in one["rms"]),
    ]
    if one["peak"]:
        rows += [(f"RMS {k}, of the truth's peak", "%", lambda n, k=k: n["rms_percent_of_peak"][k]) for k in one["rms"]]
        rows.append(("the truth's peak", unit, lambda n: n["peak"]))
        relative = [(k, lambda n, k=k: n["relative"] and 100 * n["relative"][k]) for k in one["relative"]]
        rows += [(f"|error|/|truth|, {k}", "%", value) for k, value in relative]
    rows.append(("FWL, flow warp loss", "times", lambda n: n["fwl"]))
    names = ("trusted", "all")[-len(both) :]
    lines.append(f"{'':46}{''.join(f'{name:>10}' for name in names)}")
    for name, unit, value in rows:
        found = (numbers and value(numbers) for numbers in both)
        told = ("-" if number is None else f"{number:.4g}" for number in found)
        lines.append(f"{name:<32}{unit:<14}{''.join(f'{text:>10}' for text in told)}")
    return lines
