"""What the tests of sweeps share: a small hardware and recording, and ways to run the command."""

import contextlib
import functools
import os
import signal
import subprocess
import sys

import h5py

from cmfpga.cli import sweep
from cmfpga.events import generate, write_hdf5
from support.commands import Done, run
from support.designs import PAPER
from support.small_core import options

#: Eight configurations of one hardware.
VARY = ("iterations=4,15", "roi_gain=1,2", "eta=0.1,0.5")

FILES = ("results.csv", "results.parquet", "batches.csv", "batches.parquet")


def small(**changes):
    """Options for the small hardware, without the fields that are None."""
    return ["--batch-events", "60", *options(PAPER | changes)]


#: The options of the sweep of four recordings by eight configurations, but the recordings and where to write to.
OPTIONS = [*small(iterations=None, eta=None), "--vary", *VARY]


def run_here(*arguments):
    """``cmfpga.sweep`` in this process, without Dask unless the arguments ask for it."""
    if not {"--workers", "--scheduler", "--help"} & set(map(str, arguments)):
        arguments = (*arguments, "--workers", "0")
    return run(sweep, *arguments)


@contextlib.contextmanager
def started(*arguments):
    """``cmfpga sweep`` in a process of its own, killed at the end if it still runs.

    Warnings are errors, but for resources: interrupted between an ``open`` and its ``with``, Python closes the file.
    """
    command = [sys.executable, "-W", "error", "-W", "ignore::ResourceWarning", "-m", "cmfpga", "sweep"]
    command += map(str, arguments)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "env": os.environ | {"COLUMNS": "100"}}
    heed = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # in the background it is ignored
    with subprocess.Popen(command, preexec_fn=heed, **pipes) as process:
        try:
            yield process
        finally:
            process.kill()


def finish(process):
    out, err = process.communicate(timeout=120)
    return Done(process.returncode, out, err)


def make_recording(path, seed, velocity, *, truth=True):
    """A bright thing that moves over a sensor of 32×24 px for 12 ms, with its truth unless told otherwise."""
    made = generate(
        seed=seed, width=32, height=24, texture="dense", size=(6, 6), position=(14.0, 11.0), velocity=velocity,
        duration_us=12_000, contrast=2.0, noise=0.05,
    )  # fmt: skip
    write_hdf5(path, made.events, 32, 24)
    if truth:
        with h5py.File(path, "a") as file:
            group = file.create_group("ground_truth/motion")
            group["t"], group["velocity"] = made.motion.times, made.motion.velocities
            group["start"] = made.motion.position(0)
    return made
