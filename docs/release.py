"""The files of a release: ``python docs/release.py FOLDER``; ``make release`` calls it with build/release.

Wheel and sdist; of each preset all that ``cmfpga build`` writes; the resources that were measured last; SHA256SUMS,
which ``sha256sum -c`` reads.
"""

import hashlib
import json
import subprocess
import sys
from pathlib import Path

from declared import RESOURCES, table

from cmfpga import __version__
from cmfpga.cli.build import build
from cmfpga.config import PRESETS, preset
from cmfpga.errors import write_text

ROOT = Path(__file__).resolve().parents[1]
SUMS = "SHA256SUMS"
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


def resources():
    """The baselines of the tests as a page of Markdown."""
    stored = json.loads(RESOURCES.read_text(encoding="utf-8"))
    cores = {name: row["total"] for name, row in stored["presets"].items()}
    cores |= stored["plain"] | stored["motions"] | stored["regions"]

    def rows(kinds, found):
        listed = [(f"`{name}`", *(f"{row[kind]:,}" for kind in kinds)) for name, row in found.items()]
        return table(("core", *kinds.values()), listed, right=range(1, 1 + len(kinds)))

    devices = {f"{row['device']}, speed {row['speed']}" for row in stored["placed"].values()}
    return (
        f"# Resources of cmfpga {__version__}\n\n"
        "Estimates of Yosys for UltraScale+; never run in Vivado:\n\n"
        f"{rows(ESTIMATED, cores)}\n"
        f"Placed and routed by nextpnr for {', '.join(sorted(devices))}; the median clock of the seeds:\n\n"
        f"{rows(PLACED, stored['placed'])}"
    )


def sums(folder):
    """Write the SHA-256 of all files in ``folder``."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != SUMS)
    lines = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(folder).as_posix()}" for path in files
    ]
    write_text(folder / SUMS, "\n".join(lines) + "\n")


def main(folder):
    """Write all of it."""
    folder = Path(folder).absolute()
    if folder.exists():
        sys.exit(f"error: {folder}: an empty place is needed, for its hashes are of all that is there")
    packages(folder)
    verilog(folder)
    write_text(folder / "resources.md", resources())
    sums(folder)
    print(f"wrote {folder}")


if __name__ == "__main__":
    main(*sys.argv[1:])
