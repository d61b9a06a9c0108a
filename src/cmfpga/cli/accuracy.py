"""``cmfpga accuracy``: how right what is found in a recording is, by a true motion that the user has."""

import argparse

from .. import cli
from ..errors import ConfigError
from ..events import is_live
from ..truth import of_pieces, read_truth
from . import flow, track
from .truth import add_truth_options, open_truth

EXAMPLES = (
    "cmfpga accuracy rec.h5 --truth velocity.txt --roi auto     # t vx vy: s, px/s",
    "cmfpga accuracy rec.h5 --truth imu.txt --preset rotation    # rad/s, by the file's calibration",
    "cmfpga accuracy rec.h5 --truth imu.txt --camera calib.txt --roi 100,60    # px/s in the undistorted image",
    "cmfpga accuracy rec.h5 --truth groundtruth.txt --camera calib.txt --roi 100,60 --delay 0 --json",
    "cmfpga accuracy rec.h5 --truth imu.txt --flow --window-us 20000    # the tiles of cmfpga flow",
    "cmfpga accuracy rec.h5 --truth flow/ --flow --window-us 100000    # a flow field: DSEC, MVSEC, HDF5",
    "cmfpga generate scene.h5 --velocity 120,-40 && cmfpga accuracy scene.h5 --roi auto",
)

#: Options of a track that tiles of flow do not have, beside those whose value is None, False or 1 unless given.
_TRACKS = ("roi", "objects", "batch_events", "batch_us", "batch_roi_events", "hop_events", "hop_us", "every", "drop")


def parser():
    """Parser of the arguments of ``cmfpga accuracy``."""
    made = cli.parser(
        "cmfpga accuracy",
        "How right what is found in a recording is, beside a true motion. Tracks as cmfpga track does, or as cmfpga "
        "flow, and tells errors, AEE (average endpoint error), RMS, FWL (flow warp loss), and how many are wrong.",
        EXAMPLES,
    )
    track.add_tracking_options(made)
    add_truth_options(made, "; by default the recording's own, or RECORDING.truth.csv beside it")
    group = made.add_argument_group("flow")
    text = "the tiles of cmfpga flow, not a track; --window-events or --window-us: its windows"
    group.add_argument("--flow", action="store_true", help=text)
    cli.add_tile_options(group)
    text = "folder for accuracy.csv, and for track.csv or flow.csv (default: %(default)s)"
    made.add_argument("--out", default="cmfpga-accuracy", metavar="DIR", help=text)
    made.add_argument("--json", action="store_true", help="print all of it as JSON")
    cli.add_config_options(made, None, f"{track.USUAL_PRESET}; with --flow flow")
    return made


def main(arguments=None):
    """Run the command; returns the exit status."""
    options = parser().parse_args(arguments)
    if options.recording is None:
        raise ConfigError("RECORDING: a recording is needed (--help lists the options)")
    known = open_truth(options) or _own(options)
    if options.flow:
        given = [name for name in _TRACKS if getattr(options, name) not in (None, False, 1)]
        given += ["window_events"] if options.window_events and options.window_us else []
        what = "none of a track's, and one length of windows, are allowed with --flow"
    else:
        given, what = [name for name in ("tile", "step") if getattr(options, name)], "--flow is needed"
    if given:
        raise ConfigError(f"--{given[0].replace('_', '-')}: {what}")
    command = flow if options.flow else track
    usual = vars(command.parser().parse_args([options.recording, "--no-picture"]))
    told = {name: value for name, value in vars(options).items() if name != "preset" or value is not None}
    return command.run(argparse.Namespace(**{**usual, "windows": options.batches, **told}), known)


def _own(options):
    """The true motion that the recording itself holds, or that lies beside it."""
    if options.recording == "-" or is_live(options.recording):
        raise ConfigError(f"{options.recording}: a stream; --truth FILE is needed")
    found = read_truth(options.recording)
    if found is None:
        raise ConfigError(f"{options.recording}: its true motion is not known; --truth FILE is needed")
    return of_pieces(found, options.recording)
