"""The files of a release: ``python docs/release.py FOLDER``; ``make release`` calls it with build/release.

Wheel and sdist; of each preset all that ``cmfpga build`` writes; what the self-test finds on the simulated Verilog;
the ULX3S's bitstream with its report; the resources that were measured last, beside those of earlier releases;
SHA256SUMS, which ``sha256sum -c`` reads. Takes a quarter of an hour, most of it for the bitstream.
"""

import contextlib
import csv
import hashlib
import io
import shutil
import subprocess
import sys
from pathlib import Path

from declared import RESOURCES, table

from cmfpga import __version__
from cmfpga.cli import build as build_command
from cmfpga.cli import driver as driver_command
from cmfpga.cli.build import build
from cmfpga.config import PRESETS, preset
from cmfpga.errors import UserError, write_text
from cmfpga.fpga.place import require_tools

ROOT = Path(__file__).resolve().parents[1]
SUMS = "SHA256SUMS"
#: A row for each core and release. It is committed with the release that appends to it.
HISTORY = ROOT / "docs" / "releases.csv"
#: Columns of the estimates, and of what was placed and routed.
ESTIMATED = {"lut": "LUT", "ff": "FF", "bram36": "BRAM36", "uram": "URAM", "dsp": "DSP"}
PLACED = {"lut4": "LUT4", "ff": "FF", "dp16kd": "DP16KD", "mult18": "MULT18", "fmax_mhz": "MHz"}


def packages(folder):
    """Wheel and sdist of the checkout."""
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-d", folder], cwd=ROOT, check=True)


def verilog(folder, presets=PRESETS):
    """What ``cmfpga build`` writes of each preset, in a folder of its own under ``verilog``."""
    for name in presets:
        place = folder / "verilog" / name
        place.mkdir(parents=True)
        build(preset(name), place)


def command(main, *arguments, told=None):
    """Run a command; what it prints goes to the file ``told``."""
    with contextlib.redirect_stdout(told) if told else contextlib.nullcontext():
        if status := main([*map(str, arguments)]):
            sys.exit(f"error: {main.__module__} ended with status {status}; the release is not complete")


def bitstream(folder):
    """The ULX3S's bitstream, of the first seed that meets timing, with Verilog, registers and report."""
    command(build_command.main, "--top", "ulx3s", "--bitstream", "--out", folder / "ulx3s")


def self_test(folder):
    """What the self-test finds on the emitted Verilog of the AXI top, in a simulation."""
    with (folder / "self-test.json").open("w", encoding="utf-8") as file:
        command(driver_command.main, "--json", told=file)


def measured():
    """The baselines of the tests: ``{core: estimates}``, ``{core: placement}``."""
    cores = {name: row["total"] for name, row in RESOURCES["presets"].items()}
    return cores | RESOURCES["plain"] | RESOURCES["motions"] | RESOURCES["regions"], RESOURCES["placed"]


def history(path=HISTORY, version=__version__):
    """Rows of all releases; those of ``version`` are made anew, in the file too."""
    estimated, placed = measured()
    heads = ("version", "core", *ESTIMATED, "fmax_mhz")
    kept = []
    if path.exists():
        with path.open(encoding="utf-8", newline="") as file:
            kept = [tuple(row.values()) for row in csv.DictReader(file) if row["version"] != version]
    rows = kept + [
        (version, name, *(f"{row[kind]:g}" for kind in ESTIMATED), str(placed.get(name, {}).get("fmax_mhz", "")))
        for name, row in estimated.items()
    ]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows((heads, *rows))
    write_text(path, text.getvalue())
    return rows


def resources(rows):
    """The rows of :func:`history`, and what was placed, as a page of Markdown."""
    _, placed = measured()
    heads = ("version", "core", *ESTIMATED.values(), "MHz")
    devices = {f"{row['device']}, speed {row['speed']}" for row in placed.values()}
    listed = [(f"`{name}`", *(f"{row[kind]:,}" for kind in PLACED)) for name, row in placed.items()]
    return (
        f"# Resources of cmfpga {__version__}, and of earlier releases\n\n"
        "Estimates of Yosys for UltraScale+; never run in Vivado. MHz: of the same core placed as below.\n\n"
        f"{table(heads, rows, right=range(2, len(heads)))}\n"
        f"Placed and routed by nextpnr for {', '.join(sorted(devices))}; the median clock of the seeds:\n\n"
        f"{table(('core', *PLACED.values()), listed, right=range(1, 1 + len(PLACED)))}"
    )


def sums(folder):
    """Write the SHA-256 of all files in ``folder``."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != SUMS)
    sha256 = {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    write_text(folder / SUMS, "".join(f"{digest}  {name}\n" for name, digest in sha256.items()))


def main(folder):
    """Write all of it; the folder has its name once it is complete."""
    folder = Path(folder).absolute()
    if folder.exists():
        sys.exit(f"error: {folder}: an empty place is needed, for its hashes are of all that is there")
    require_tools()  # of the bitstream, which comes last
    unfinished = folder.with_name(f"{folder.name}.unfinished")
    shutil.rmtree(unfinished, ignore_errors=True)
    for part in (packages, verilog, self_test, bitstream):
        part(unfinished)
    write_text(unfinished / "resources.md", resources(history()))
    sums(unfinished)
    unfinished.rename(folder)
    print(f"wrote {folder}")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except UserError as error:
        sys.exit(f"error: {error}")
