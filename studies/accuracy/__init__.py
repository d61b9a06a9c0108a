"""How well the motion is found, on batches whose motion is known and on real ones: ``python -m studies.accuracy``.

Rules that look at events, never at results, choose the batches. docs/accuracy.md tells what they show.

- :mod:`~.synthetic` and :mod:`~.real` make batches, of which :mod:`~.yardstick` searches the best contrast;
- :mod:`~.table` measures an engine; :mod:`~.suites` and :mod:`~.studies` print the tables.
"""

import argparse
import json
import os
import sys
from pathlib import Path

from cmfpga import cli
from cmfpga.config import DEFAULT_PRESET
from cmfpga.config.windows import needs_batches
from cmfpga.engines import ENGINES
from cmfpga.errors import ConfigError, RecordingError, needs, write_text

from .dense import run_dense
from .motions import MOTIONS, run_motion
from .moving import run_moving
from .studies import STUDIES, run_study
from .suites import run_suites
from .synthetic import BATCHES, SEEDS
from .table import Report
from .yardstick import ROI

EXAMPLES = (
    "python -m studies.accuracy                                # 300 synthetic batches, by the integer model",
    "python -m studies.accuracy --data recordings --engine all # all suites, by Verilog, model and float",
    "python -m studies.accuracy --set weight_frac=3 --batches 100 --json scores.json",
    "python -m studies.accuracy --seeds 1-3                    # 900 synthetic batches",
    "python -m studies.accuracy --known --data recordings      # and recordings of known motion, in batches",
    "python -m studies.accuracy --known --preset sliding --data recordings    # those alone, in windows that slide",
    "python -m studies.accuracy --motion rotation --data recordings    # and a similarity's",
    "python -m studies.accuracy --flow --data recordings",
    "python -m studies.accuracy --moving --seeds 1-3 --data recordings",
    "python -m studies.accuracy --study widths --data recordings",
)


def _parser():
    made = cli.parser(
        "python -m studies.accuracy", "How well the motion is found: suites of batches, and studies.", EXAMPLES
    )
    made.add_argument(
        "--batches", type=cli.positive, default=BATCHES, metavar="N", help="synthetic batches of each seed (300)"
    )
    made.add_argument(
        "--seeds", type=_seeds, default=SEEDS, metavar="A-B", help="seeds of the synthetic batches, or one (1)"
    )
    made.add_argument(
        "--engine", default="model", choices=(*ENGINES, "all"),
        help="model: the hardware's arithmetic in integers; rtl: the emitted Verilog; float: nothing rounded "
        "(default: model)",
    )  # fmt: skip
    made.add_argument(
        "--data", default=os.environ.get("CMFPGA_DATA"), metavar="DIR",
        help="folder of the real recordings (default: $CMFPGA_DATA); without one those suites are left out",
    )  # fmt: skip
    made.add_argument(
        "--study", choices=STUDIES,
        help="instead of the suites: plain, the article's ascent; peaks, where the objective's own peak lies; "
        "edges, edges of other strengths; schedules; widths of words; confidence, whether it tells right from wrong; "
        "bias, of slow dense scenes; ambiguous, stripes, straight edges and two motions; large, flow on large "
        "sensors; slider, a grid of ROIs where vy = 0; auto, the ROI that track finds in each recording",
    )  # fmt: skip
    made.add_argument(
        "--motion", choices=MOTIONS,
        help="instead of the suites: that of a motion beyond translation, with the preset of this name; synthetic "
        "batches, and with --data real ones of a rotation",
    )  # fmt: skip
    made.add_argument(
        "--known", action="store_true",
        help="recordings whose motion is known as well, tracked without an option about batches: how many batches are "
        "trusted, and of these wrong; generated ones, and with --data real ones. With --preset sliding those alone, by "
        "windows that share no time",
    )  # fmt: skip
    made.add_argument(
        "--flow", action="store_true",
        help="instead of the suites: dense flow with preset flow, tile by tile, of a scene whose flow is known; with "
        "--data of real recordings, too",
    )  # fmt: skip
    made.add_argument(
        "--moving", nargs="?", const="built", choices=("built", "plans"),
        help="instead of the suites: scenes in which v changes, by windows that slide (preset quad) and by batches; "
        "plans: with other rounds, too",
    )  # fmt: skip
    made.add_argument("--eventcv", action="store_true", help="rows of the program eventcv, on the same batches")
    made.add_argument("--json", metavar="FILE", help="write all scores, and those of each batch")
    cli.add_config_options(made)
    return made


def _seeds(text):
    """``A-B`` or ``A``, for argparse."""
    first, dash, last = text.partition("-")
    if not (first.isdecimal() and (last.isdecimal() or not dash)) or int(last or first) < int(first):
        raise argparse.ArgumentTypeError(f"{text!r}: one seed, or the first and the last as in 1-3, is needed")
    return range(int(first), int(last or first) + 1)


def main(arguments=None):
    """Run the command; returns the exit status."""
    options = _parser().parse_args(arguments)
    if (options.motion or options.flow or options.moving) and options.preset == DEFAULT_PRESET:
        options.preset = options.motion or ("flow" if options.flow else "quad")
    config = cli.make_config(options)
    for name in ("motion", "flow", "moving"):
        if getattr(options, name) and (options.study or options.known or options.engine == "all"):
            raise ConfigError(f"--{name}: --study, --known and --engine all go without it")
    if sum(map(bool, (options.motion, options.flow, options.moving))) > 1:
        raise ConfigError("--motion, --flow, --moving: one of them at a time")
    if not (options.moving or options.known):
        needs_batches(config, "the suites but --known and --moving")
    if options.moving and config.ascent != "newton":
        raise ConfigError(f"--moving: ascent = {config.ascent}: rounds are needed, as of preset quad")
    if not options.motion and (config.roi_width, config.roi_height) != (ROI, ROI):
        raise ConfigError(f"ROI of {config.roi_width}×{config.roi_height} px: the suites are for {ROI}×{ROI} px")
    if options.data is not None and not Path(options.data).is_dir():
        raise RecordingError(f"--data {options.data}: no such folder")
    if options.json:
        Path(options.json).touch()  # say that it cannot be written before the work, not after it
    report = Report()
    if options.data is None:
        print("note: no folder of recordings (--data, $CMFPGA_DATA): synthetic batches only", file=sys.stderr)
    with needs("torch", "reference", "all but --engine rtl"):
        kinds = {"motion": run_motion, "flow": run_dense, "moving": run_moving, "study": run_study}
        next((run for name, run in kinds.items() if getattr(options, name)), run_suites)(options, config, report)
    if options.json:
        text = json.dumps({"config": config.to_dict(), "results": report.results}, indent=1)
        write_text(options.json, text + "\n")
        print(f"wrote {options.json}")
    return 0
