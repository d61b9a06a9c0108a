"""The options of the filters in front of the ROI, and the fields of the configuration that they ask for."""

import re

from ..errors import ConfigError, naming
from . import natural


def add_noise_options(made):
    """``--hot-pixels`` and ``--background-us``, for :func:`noise_fields`."""
    group = made.add_argument_group("noise (dropped events are counted; what suits: python -m cmfpga.info RECORDING)")
    group.add_argument(
        "--hot-pixels", metavar="auto|X,Y;X,Y|FILE",
        help="drop the events of these pixels: those that a reading of the recording finds, or these, or those of a "
        "file, X,Y in each line",
    )  # fmt: skip
    group.add_argument(
        "--background-us", type=natural, metavar="D",
        help="drop events without one of another pixel of their cell (2^background_cell px wide) in the D µs before",
    )  # fmt: skip


def noise_fields(options, recording):
    """The fields that the options ask for; ``recording`` is read where they say ``auto``."""
    fields = {}
    if options.hot_pixels is not None:
        fields |= {"hot_pixels": 1, "hot_mask": _mask(options.hot_pixels, recording)}
    if options.background_us is not None:
        fields |= {"background": 1, "background_us": options.background_us}
    return fields


def _mask(text, recording):
    if text == "auto":
        from ..survey import hot_mask

        return hot_mask(recording)
    if re.fullmatch(r"[\d,;\s]*", text):
        return text
    try:
        with naming(text), open(text, encoding="utf-8") as file:
            lines = (line.partition("#")[0].strip() for line in file)
            return ";".join(filter(None, lines))
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise ConfigError(f"--hot-pixels {text}: auto, X,Y;X,Y, or a text file is needed ({why})") from None
