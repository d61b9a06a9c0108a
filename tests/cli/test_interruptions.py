"""A full disk, two commands at once, an interruption: one line each."""

import subprocess
import sys
from pathlib import Path

import pytest
from filelock import FileLock

from cmfpga.cli import track

OPTIONS = ["--roi", "8,9", "--engine", "model", "--batch-events", "90", "--batches", "2"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("name, options", [
    ("track.csv", ["--no-picture"]), ("track.png", []), ("track.npz", ["--report"]), ("report.html", ["--report"]),
])  # fmt: skip
def test_a_full_disk(command, dot, small, tmp_path, name, options):
    (tmp_path / name).symlink_to("/dev/full")
    done = command(track, dot, *OPTIONS, *small, *options, "--out", tmp_path)
    assert done.error == f"{tmp_path / name}: No space left on device"


def test_two_tracks_into_one_folder(command, dot, small, tmp_path):
    options = (track, dot, *OPTIONS, *small, "--no-picture", "--out", tmp_path)
    with FileLock(tmp_path / ".lock"):
        assert command(*options).error.startswith(f"--out {tmp_path}: another command is writing there")
    assert command(*options).status == 0 and [path.name for path in tmp_path.iterdir()] == ["track.csv"]


def test_interrupted_while_a_block_is_elaborated(tmp_path):
    """No warnings of Amaranth about blocks that were made and not used."""
    code = (
        "import sys; from cmfpga import cli; from cmfpga.cli import build\n"
        "from cmfpga.rtl.image.voter import BilinearVoter\n"
        "def interrupt(*_): raise KeyboardInterrupt\n"
        "BilinearVoter.elaborate = interrupt; sys.exit(cli.run(build.main, ['--out', sys.argv[1]]))"
    )
    done = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "interrupted\n")


def test_interrupted_in_a_destructor():
    """Python ignores what is raised there."""
    code = (
        "import signal, sys, time; from cmfpga import cli\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # in the background it is ignored
        "class Held:\n    def __del__(self): signal.raise_signal(signal.SIGINT)\n"
        "def main(_): Held(); time.sleep(60)\n"
        "sys.exit(cli.run(main))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "interrupted\n")
