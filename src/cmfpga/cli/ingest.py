"""The options of what is in front of the ROI, filters and undistortion, and the fields that they ask for."""

import re

from .. import cli
from ..config import preset
from ..errors import ConfigError, naming
from ..imaging.camera import camera_fields
from ..imaging.survey import hot_mask, usual_survey, without_hot_pixels
from ..tracking.source import rotation_fields


def add_ingest_options(made):
    """``--camera``, ``--hot-pixels`` and ``--background-us``, for :func:`ingest_fields`."""
    cli.files(made.add_argument(
        "--camera", metavar="FILE",
        help="undistort events as this calibration says, so that ROI and velocity are in the undistorted image: HDF5 "
        "with /camera_calibration (often the recording itself), a ROS camera_info YAML, or a text of fx fy cx cy k1 k2 "
        "p1 p2 k3; or these numbers (flow, and motion = rotation, take the recording's own by themselves)",
    ))  # fmt: skip
    group = made.add_argument_group("noise (dropped events are counted; what suits: cmfpga info RECORDING)")
    group.add_argument(
        "--hot-pixels", metavar="auto|none|X,Y;X,Y|FILE",
        help="drop the events of these pixels: those that a reading of the recording finds (the default of files; a "
        "stream has none), or these, or those of a file, X,Y in each line; none: of no pixel",
    )  # fmt: skip
    text = "drop events without one of another pixel of their cell (2^background_cell px wide) in the D µs before"
    group.add_argument("--background-us", type=cli.natural, metavar="D", help=text)


def ingest_fields(options, recording):
    """The fields that the options ask for; ``recording`` is read where they say ``auto``."""
    given = cli.config_changes(options)
    fields = camera_fields(options.camera, recording) if options.camera is not None else {}
    motion = given.get("motion", preset(options.preset).motion)
    fields |= rotation_fields(recording, motion, {**fields, **given}, "--camera FILE")
    if options.hot_pixels == "none":
        fields |= {"hot_pixels": 0}
    elif options.hot_pixels is not None:
        fields |= {"hot_pixels": 1, "hot_mask": _mask(options.hot_pixels, recording)}
    if options.background_us is not None:
        fields |= {"background": 1, "background_us": options.background_us}
    return fields


def drop_hot_pixels(options, recording, config, fields):
    """``config`` without the recording's hot pixels, unless ``fields`` or ``--set`` name some; a note says which."""
    survey = usual_survey(recording, options.engine, {**fields, **cli.config_changes(options)})
    config, note = without_hot_pixels(config, survey, "--hot-pixels none")
    cli.note(note)
    return config


def _mask(text, recording):
    if text == "auto":
        return hot_mask(recording)
    if re.fullmatch(r"[\d,;\s]*", text):
        return text
    try:
        with naming(text), open(text, encoding="utf-8") as file:
            lines = (line.partition("#")[0].strip() for line in file)
            return ";".join(filter(None, lines))
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise ConfigError(f"--hot-pixels {text}: auto, none, X,Y;X,Y, or a text file is needed ({why})") from None
