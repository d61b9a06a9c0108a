"""``cmfpga report``: a track as one HTML page that needs no network."""

from pathlib import Path

from .. import cli
from ..errors import ConfigError
from ..waiting import waiting

EXAMPLES = (
    "cmfpga track rec.h5 --roi 100,30 --report --out star",
    "cmfpga report star                      # the same page again, from what track kept",
    "cmfpga report star --clock 150 --out slow.html",
)

PAGE = "report.html"


def parser():
    """Parser of the arguments of ``cmfpga report``."""
    made = cli.parser("cmfpga report", "Write the report of a track: one HTML page that needs no network.", EXAMPLES)
    made.add_argument("folder", metavar="DIR", help="the folder into which track wrote a report; its track.npz is read")
    cli.add_clock_option(made)
    made.add_argument("--out", metavar="FILE", help=f"the page (default: {PAGE} in DIR)")
    return made


def main(arguments=None):
    """Run the command; returns the exit status."""
    from ..show.report import write_page
    from ..tracking.kept import FILE, Kept

    options = parser().parse_args(arguments)
    folder = Path(options.folder)
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; the one that track --report wrote is needed")
    files = sorted(folder.glob(f"{Path(FILE).stem}*.npz"))  # one for each object that was tracked
    if not files:
        raise ConfigError(f"{folder}: has no {FILE}; track again with --report")
    if options.out and len(files) > 1:
        raise ConfigError(f"--out: {folder} has {len(files)} tracks; their pages can only be written there")
    for file in files:
        page = Path(options.out or folder / f"{file.stem.replace('track', 'report', 1)}.html")
        with waiting("Writing the page"):
            write_page(Kept.load(file), page, clock_mhz=options.clock)
        print(f"wrote {page}")
    return 0
